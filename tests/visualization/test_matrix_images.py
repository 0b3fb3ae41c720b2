import cv2
import numpy as np
import pytest

from slam_bof.visualization import draw_loop_matrix, write_png
from slam_bof.visualization.matrix_images import MARGIN_PX, SIDE_PX

SCORES = np.zeros((4, 4))
SCORES[3, 0] = 0.9
NOWHERE = np.zeros((4, 4), bool)


def cell(image, row, column):
    """The middle of a pair's cell."""
    y, x = (MARGIN_PX + int((k + 0.5) * SIDE_PX / 4) for k in (row, column))
    return image[y, x].tolist()


def test_similar_frames_are_dark_and_same_places_are_tinted():
    same = NOWHERE.copy()
    same[2, 1] = True
    image = draw_loop_matrix(SCORES, same, {}, title="room")
    assert cell(image, 0, 0) == [255, 255, 255]
    assert max(cell(image, 3, 0)) < 128
    blue, green, red = cell(image, 2, 1)
    assert blue > green > red


def test_loops_are_marked_at_query_and_match():
    loops = {"right": ("good", [(3, 1)]), "wrong": ("bad", np.array([[2, 0]]))}
    image = draw_loop_matrix(SCORES, NOWHERE, loops, title="room")
    assert np.argmax(cell(image, 3, 1)) == 1  # green
    assert np.argmax(cell(image, 2, 0)) == 2  # red
    assert cell(image, 1, 3) == [255, 255, 255]


def test_dissimilar_and_many_frames_can_be_drawn():
    n = SIDE_PX + 100
    image = draw_loop_matrix(
        np.zeros((n, n)), np.zeros((n, n), bool), {"none": ("good", [])}, title=""
    )
    assert image[MARGIN_PX : MARGIN_PX + SIDE_PX, MARGIN_PX : MARGIN_PX + SIDE_PX].min() == 255


def test_a_picture_is_written_as_it_is(tmp_path):
    image = draw_loop_matrix(SCORES, NOWHERE, {}, title="room")
    write_png(tmp_path / "a.png", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png")), image)


def test_matrices_of_two_sizes_are_refused():
    with pytest.raises(ValueError, match=r"\(4, 4\) and \(3, 3\)"):
        draw_loop_matrix(SCORES, np.zeros((3, 3), bool), {}, title="room")
