import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from slam_bof.bof import BofParams, describe, pack, unpack
from slam_bof.types import Contours


@given(arrays(np.float32, (3, 40), elements=st.floats(0, 1, width=32)))
def test_any_radii_survive_as_far_as_the_harmonics_go(radii):
    packed = pack(radii, n_harmonics=8)
    assert len(packed) == 3 * 16
    spectrum = np.fft.rfft(radii, axis=1)
    spectrum[:, 8:] = 0
    smooth = np.fft.irfft(spectrum, n=40, axis=1)
    # 15 parts of at most half a step each; all but the mean count twice.
    np.testing.assert_allclose(
        unpack(packed, n_values=40, n_harmonics=8), smooth, atol=29 * 0.25 / 127 + 1e-5
    )


def test_real_shapes_are_told_to_a_hundredth():
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    shapes = []
    for seed in range(20):
        a, b, c = np.random.default_rng(seed).uniform(0, 0.25, 3)
        radius = 100 * (1 + a * np.cos(2 * angle) + b * np.sin(3 * angle) + c * np.cos(5 * angle))
        shapes.append(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1).round())
    contours = Contours(tuple(s.astype(np.int32) for s in shapes), np.zeros(20, np.int32))
    descriptors = describe(contours, BofParams())
    assert np.abs(unpack(pack(descriptors)) - descriptors).mean() < 0.01


def test_no_descriptors_are_no_bytes():
    assert pack(np.empty((0, 180), np.float32)) == b""
    assert unpack(b"").shape == (0, 180)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="at least 32 values, got 20"):
        pack(np.zeros((1, 20), np.float32))
    with pytest.raises(ValueError, match="32 bytes a descriptor, got 33"):
        unpack(bytes(33))
