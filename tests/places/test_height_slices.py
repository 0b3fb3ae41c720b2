import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.places.height_slices import Slices

STILL = np.zeros(1)


@pytest.fixture(scope="module")
def slices():
    return Slices()


def points(seed=0, n=3000):
    """Upright things of a room before the camera, in the levelled frame."""
    rng = np.random.default_rng(seed)
    things = rng.uniform([-1.2, 1.0], [1.2, 3.2], (12, 2))[rng.integers(12, size=n)]
    x, z = (things + rng.normal(0, 0.05, (n, 2))).T
    return np.stack([x, rng.uniform(-1, 1.3, n), z], axis=1).astype(np.float32)


def seen_from(points_match, T_match_query):
    return se3.transform(se3.inverse(T_match_query), points_match).astype(np.float32)


def test_a_view_is_most_like_itself(slices):
    spectra = np.concatenate([slices.spectra(points(seed), STILL) for seed in range(5)])
    for k in range(5):
        scores, T = slices.compare(spectra, slices.spectra(points(k)))
        assert scores.argmax() == k
        assert scores[k] == pytest.approx(1.0, abs=1e-5)
        np.testing.assert_allclose(T[k], np.eye(4), atol=1e-12)


@pytest.mark.parametrize(
    ("yaw_deg", "x_m", "z_m"), [(0, 0.4, -0.6), (20, 0.0, 0.2), (-40, 0.6, 0.4), (60, -1.0, 0.8)]
)
def test_the_motion_between_two_views_is_found(slices, yaw_deg, x_m, z_m):
    T_match_query = se3.exp(np.array([0, np.radians(yaw_deg), 0, 0, 0, 0]))
    T_match_query[:3, 3] = [x_m, 0, z_m]
    here = seen_from(points(), T_match_query)
    scores, T = slices.compare(slices.spectra(points(), STILL), slices.spectra(here))
    assert scores[0] > 0.7
    off = se3.inverse(T_match_query) @ T[0]
    assert np.degrees(se3.rotation_angle(off)) < 1e-3  # these turns are among those tried
    assert np.linalg.norm(off[:3, 3]) < 0.15  # shifts are tried at 0.2 m


def test_half_the_spectrum_tells_what_all_of_it_does(slices):
    """Spectra are of length 1, and correlate as the blurred plans themselves would."""
    one, other = (slices.spectra(points(seed), STILL)[0] for seed in (1, 2))
    assert np.linalg.norm(one) == pytest.approx(1.0)
    score, _ = slices.compare(one[None], np.repeat(other[None], 7, axis=0))
    k_x = np.arange(one.shape[0])[:, None, None]
    k_z = np.arange(-6, 7)[None, :, None]
    correlations = [
        (one.conj() * other * np.exp(2j * np.pi * (k_x * x + k_z * z) / 64)).sum().real
        for x in range(-16, 17, 2)
        for z in range(-16, 17, 2)
    ]
    assert score[0] == pytest.approx(max(correlations), abs=1e-5)


def test_nothing_in_the_plan_is_like_nothing(slices):
    far = slices.spectra(np.array([[0.0, 0.0, 9.0]], np.float32))
    assert not far.any()
    scores, _ = slices.compare(slices.spectra(points(), STILL), far)
    assert scores.tolist() == [0.0]
