import numpy as np
import pytest

from slam_bof.bof.polygons import Polygons

SQUARE = np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j])
RAYS = np.exp(2j * np.pi * np.arange(180) / 180)


def polygons(*corners: np.ndarray) -> Polygons:
    return Polygons(np.concatenate(corners), np.array([len(c) for c in corners]))


def test_each_polygon_has_its_own_centroid_and_length():
    triangle = np.array([0, 3, 3j]) + 10
    found = polygons(SQUARE + 5j, triangle, SQUARE[::-1] * 2)
    np.testing.assert_allclose(found.centroids, [5j, 11 + 1j, 0], atol=1e-12)
    np.testing.assert_allclose(found.lengths, [8, 6 + 3 * np.sqrt(2), 16])
    np.testing.assert_allclose(found.largest_radii()[[0, 2]], np.sqrt([2, 8]))


def test_what_encloses_nothing_has_the_mean_of_its_corners():
    found = polygons(np.array([0, 2 + 0j, 4]), np.array([1j]))
    np.testing.assert_allclose(found.centroids, [2, 1j])
    assert found.radii(np.array([1]), 8).max() == 0.0


@pytest.mark.parametrize("direction", [1, -1])
def test_radii_of_a_square_are_exact_either_way_round(direction):
    found = polygons(SQUARE + 100, SQUARE[::direction] * 3 + 7)
    radii = found.radii(np.array([1]), 180)[0]
    expected = 3 / np.maximum(np.abs(RAYS.real), np.abs(RAYS.imag))
    np.testing.assert_allclose(radii, expected, rtol=1e-9)


def test_the_farthest_crossing_counts():
    """A U seen from its centroid, which lies outside: each arm is crossed twice."""
    u = np.array([0, 6, 6 + 6j, 4 + 6j, 4 + 2j, 2 + 2j, 2 + 6j, 6j])
    found = polygons(u)
    (centre,) = found.centroids
    radii = found.radii(np.array([0]), 360)[0]
    assert radii[0] == pytest.approx(6 - centre.real)
    assert radii[180] == pytest.approx(centre.real)
    assert radii[90] == 0.0 if centre.imag > 2 else radii[90] == pytest.approx(2 - centre.imag)


def test_turning_a_polygon_shifts_its_radii():
    random = np.random.default_rng(3)
    star = random.uniform(1, 2, 40) * np.exp(2j * np.pi * np.arange(40) / 40)
    one, other = (
        polygons(turned).radii(np.array([0]), 180)[0] for turned in (star, star * RAYS[7])
    )
    np.testing.assert_allclose(other, np.roll(one, 7), rtol=1e-6)


def test_no_polygons_are_none():
    none = Polygons(np.empty(0, np.complex128), np.empty(0, np.intp))
    assert len(none) == 0
    assert none.largest_radii().shape == none.lengths.shape == (0,)
    assert none.radii(np.empty(0, np.intp), 180).shape == (0, 180)
