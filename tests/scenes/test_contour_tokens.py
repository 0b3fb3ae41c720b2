import numpy as np
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import bof_tokens


def test_a_table_top_has_a_token_at_its_height():
    tokens = bof_tokens(table_frame(table_m=0.75, eye_m=1.5))
    nearest = np.abs(tokens[:, 0] - 0.75).argmin()
    assert abs(tokens[nearest, 0] - 0.75) < 0.1
    assert len({len(token) for token in tokens}) == 1
    assert (np.diff(tokens[:, 3]) <= 0).all()  # the longest contour first


def test_nothing_seen_has_no_tokens():
    assert bof_tokens(empty_frame()).shape == (0, 16)
