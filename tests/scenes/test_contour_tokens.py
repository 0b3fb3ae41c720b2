import numpy as np
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import bof_tokens, turned_tokens
from slam_bof.scenes.contour_tokens import N_TOKEN_VALUES


def test_a_table_top_has_a_token_at_its_height():
    tokens = bof_tokens(table_frame(table_m=0.75, eye_m=1.5))
    nearest = np.abs(tokens[:, 0] - 0.75).argmin()
    assert abs(tokens[nearest, 0] - 0.75) < 0.1
    assert 1.0 < tokens[nearest, 2] < 3.5  # ahead
    assert (np.diff(tokens[:, 4]) <= 0).all()  # the longest contour first


def test_nothing_seen_has_no_tokens():
    assert bof_tokens(empty_frame()).shape == (0, N_TOKEN_VALUES)
    assert turned_tokens(bof_tokens(empty_frame())).shape == (0, 16)


def test_turned_tokens_do_not_change_when_the_camera_turns():
    tokens = bof_tokens(table_frame(table_m=0.75, eye_m=1.5))
    turned, angle = tokens.copy(), 0.7
    place = (tokens[:, 1] + 1j * tokens[:, 2]) * np.exp(1j * angle)
    turned[:, 1], turned[:, 2] = place.real, place.imag
    real, imaginary = np.split(tokens[:, 6:], 2, axis=1)
    spectrum = (real + 1j * imaginary) * np.exp(1j * angle * np.arange(real.shape[1]))
    turned[:, 6:] = np.concatenate([spectrum.real, spectrum.imag], axis=1)
    np.testing.assert_allclose(turned_tokens(turned), turned_tokens(tokens), atol=1e-5)
