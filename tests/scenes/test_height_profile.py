import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes.height_profile import (
    LEVEL_STEP_M,
    N_HEIGHTS,
    N_LEVELS,
    N_PROFILE_VALUES,
    N_TILTS,
    measure_profile,
)
from slam_bof.scenes.levelled_cloud import levelled_cloud

LEVELS = slice(N_HEIGHTS * (N_TILTS + 1), N_HEIGHTS * (N_TILTS + 1) + N_LEVELS)


def level_areas(**kwargs):
    """Return the square metres of level surface by height."""
    return measure_profile(levelled_cloud(table_frame(**kwargs)))[LEVELS] ** 2


@pytest.mark.parametrize("table_m", [0.46, 0.74, 0.9])
def test_a_table_top_shows_at_its_height(table_m):
    areas = level_areas(table_m=table_m)
    above_floor = areas[3:]
    near = int(above_floor.argmax()) + 3
    assert abs((near + 0.5) * LEVEL_STEP_M - table_m) < LEVEL_STEP_M
    assert above_floor.sum() == pytest.approx(1.2 * 0.6, rel=0.3)


def test_area_hardly_depends_on_distance():
    near, far = (
        level_areas(ahead_m=ahead_m, pitch=0.4, eye_m=1.6)[3:].sum() for ahead_m in (1.9, 2.8)
    )
    assert far == pytest.approx(near, rel=0.15)


def test_an_empty_view_has_an_empty_profile():
    profile = measure_profile(levelled_cloud(empty_frame()))
    assert profile.shape == (N_PROFILE_VALUES,)
    assert profile.dtype == np.float32
    assert np.flatnonzero(profile).tolist() == [N_PROFILE_VALUES - 3]  # the height that is guessed
