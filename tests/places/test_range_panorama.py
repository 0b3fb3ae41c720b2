import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam_bof.places.range_panorama import (
    FREQUENCIES,
    N_AZIMUTHS,
    N_ELEVATIONS,
    RANGE_PERIOD,
    Panorama,
)


@pytest.fixture(scope="module")
def panorama():
    return Panorama()


def points(seed=0, n=3000):
    rng = np.random.default_rng(seed)
    directions = rng.uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.1], (n, 3))
    blobs = rng.uniform(1.0, 4.0, 8)[rng.integers(8, size=n)]
    return (directions * blobs[:, None]).astype(np.float32)


def turned(points_level, yaw_rad):
    """The points, from a camera that turned by so much to the right: they move to the left."""
    return (points_level @ Rotation.from_euler("y", yaw_rad).as_matrix()).astype(np.float32)


def compare(panorama, spectra, query):
    packed, steps = zip(*(panorama.pack(spectrum) for spectrum in spectra), strict=True)
    return panorama.compare(np.stack(packed), np.array(steps), query)


def test_a_view_is_most_like_itself(panorama):
    spectra = np.stack([panorama.spectrum(points(seed)) for seed in range(5)])
    for k, spectrum in enumerate(spectra):
        scores = compare(panorama, spectra, spectrum)
        assert scores.argmax() == k
        assert scores[k] == pytest.approx(1.0, abs=2e-3)
        assert (scores < 1.0 + 2e-3).all()


@pytest.mark.parametrize("cells", [-15, -4, 1, 12])
def test_a_turned_camera_sees_the_same(panorama, cells):
    here = turned(points(), np.radians(3.0) * cells)
    assert compare(panorama, panorama.spectrum(points())[None], panorama.spectrum(here))[0] > 0.99


def test_a_step_ahead_shifts_ranges(panorama):
    there = points()
    same, nearer, other = (
        compare(panorama, panorama.spectrum(there)[None], panorama.spectrum(p))[0]
        for p in (there, there * np.float32(12 ** (-1 / 40)), points(1))
    )
    assert nearer == pytest.approx(same - 0.04, abs=0.02)  # what a shift of one cell costs
    assert other < 0.8 * nearer


def test_the_correlation_is_that_of_whole_spectra(panorama):
    """Shift by shift, from the full FFT of blurred grids, cut to the frequencies kept."""
    one, other = panorama.spectrum(points(2)), panorama.spectrum(points(3))
    high_a, high_e, high_r = FREQUENCIES
    k_a, k_e = np.arange(-high_a, high_a + 1), np.arange(-high_e, high_e + 1)
    k_r = np.arange(1, high_r + 1)
    best = -np.inf
    for a in range(-20, 21):
        for e in range(-2, 3):
            for r in (-1, 0, 1):
                phase = (
                    np.multiply.outer(k_a * a / N_AZIMUTHS, np.ones((len(k_e), len(k_r))))
                    + (k_e * e / N_ELEVATIONS)[:, None]
                    + k_r * r / RANGE_PERIOD
                )
                shifted = other * np.exp(2j * np.pi * phase)
                best = max(best, float((one.conj() * shifted).sum().real) - 0.04 * abs(r))
    assert compare(panorama, one[None], other)[0] == pytest.approx(best, abs=2e-3)


def test_many_views_are_compared_as_one_by_one(panorama):
    spectra = np.stack([panorama.spectrum(points(seed, 200)) for seed in range(300)])
    scores = compare(panorama, spectra, spectra[7])
    for k in (0, 7, 127, 128, 299):
        (score,) = compare(panorama, spectra[k : k + 1], spectra[7])
        assert scores[k] == pytest.approx(score, abs=1e-6)


def test_nothing_in_range_is_like_nothing(panorama):
    empty = panorama.spectrum(np.empty((0, 3), np.float32))
    far = panorama.spectrum(np.array([[0.0, 0.0, 50.0]], np.float32))
    assert not empty.any()
    assert not far.any()
    assert compare(panorama, empty[None], panorama.spectrum(points()))[0] == 0.0
