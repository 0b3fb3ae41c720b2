import base64
import re

import cv2
import numpy as np
import pytest

from slam_bof.core import open_dataset
from slam_bof.visualization import MissedQueries, find_missed_queries, write_missed_queries
from slam_bof.visualization.misses_page import MAX_SHOWN, MissedQuery


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, write_turn):
    folder = tmp_path_factory.mktemp("misses") / "room" / "seq-01"
    write_turn(folder, [0.0, 1.0, 2.0, 3.0])
    return open_dataset(folder)


def test_misses_are_those_whose_best_answer_is_wrong():
    allowed = np.tri(4, k=-1, dtype=bool)
    truth = np.zeros((4, 4), bool)
    truth[1, 0] = truth[2, 0] = truth[3, 0] = truth[3, 2] = True
    scores = np.array([[9, 9, 9, 9], [1, 9, 9, 9], [2, 3, 9, 9], [3, 5, 4, 9]], float)
    assert find_missed_queries(scores, truth, allowed) == (
        3,
        [MissedQuery(2, 1, 0, 2), MissedQuery(3, 1, 2, 2)],
    )
    assert find_missed_queries(scores, ~allowed, allowed) == (0, [])


def test_the_page_shows_query_answer_and_what_was_right(dataset, tmp_path):
    file = tmp_path / "pages" / "misses.html"
    write_missed_queries(
        file, [MissedQueries("ferns", dataset, [0, 1, 3], 2, [MissedQuery(2, 1, 0, 7)])]
    )
    text = file.read_text("utf-8")
    assert "ferns on room/seq-01" in text
    assert "1 of 2 queries got a wrong answer." in text
    assert re.findall("<figcaption>(.*?)</figcaption>", text) == [
        "query: frame 3",
        "answered: frame 1",
        "right, at rank 7: frame 0",
    ]
    first, *_ = re.findall('src="data:image/jpeg;base64,(.*?)"', text)
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(first), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (240, 320, 3)
    depth_m = dataset.frame(3).depth_m(2)
    known = depth_m > 0
    green = picture[..., 1][known].astype(float)
    assert np.corrcoef(green, depth_m[known])[0, 1] > 0.9  # brighter where it is farther


def test_of_many_misses_some_are_shown(dataset, tmp_path):
    misses = [MissedQuery(2, 1, 0, rank) for rank in range(2, 102)]
    write_missed_queries(
        tmp_path / "many.html", [MissedQueries("bof", dataset, [0, 1, 3], 120, misses)]
    )
    text = (tmp_path / "many.html").read_text("utf-8")
    assert f"100 of 120 queries got a wrong answer; {MAX_SHOWN} of these are shown." in text
    assert text.count("<figcaption>query") == MAX_SHOWN
    assert "right, at rank 2:" in text
    assert "right, at rank 101:" in text
