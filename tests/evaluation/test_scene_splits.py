from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slam_bof.datasets import LabelledFrame
from slam_bof.datasets.depth_images import DepthImages
from slam_bof.errors import DatasetError
from slam_bof.evaluation import Split, split_at_random, split_by_time


@pytest.fixture
def sequence(tmp_path: Path):
    """Make a data set of so many images, 30 a second."""

    def make(n: int) -> DepthImages:
        first = tmp_path / "0.png"
        cv2.imwrite(str(first), np.full((4, 5), 1000, np.uint16))
        files = [tmp_path / f"{k:06d}.png" for k in range(n)]
        for file in files:
            if not file.exists():
                file.symlink_to(first)
        return DepthImages(files)

    return make


def frames(dataset: DepthImages, label: str) -> list[LabelledFrame]:
    return [LabelledFrame(dataset, k, label) for k in range(len(dataset))]


def test_holdout_takes_a_quarter_of_each_sequence(sequence) -> None:
    hall, bath = frames(sequence(40), "hall"), frames(sequence(20), "bath")
    split = split_at_random(hall + bath, seed=1)
    assert sum(f.label == "hall" for f in split.test) == 10
    assert sum(f.label == "bath" for f in split.test) == 5
    assert len(split.train) == 45
    assert not {(id(f.dataset), f.index) for f in split.train} & {
        (id(f.dataset), f.index) for f in split.test
    }
    again = [f.index for f in split_at_random(hall + bath, seed=1).test]
    assert again == [f.index for f in split.test]
    assert again != [f.index for f in split_at_random(hall + bath, seed=2).test]


def test_time_split_leaves_two_seconds_out(sequence) -> None:
    split = split_by_time(frames(sequence(600), "hall"))
    assert [f.index for f in split.train] == list(range(360))
    assert [f.index for f in split.test] == list(range(359 + 60, 600))


def test_of_a_short_sequence_a_twentieth(sequence) -> None:
    split = split_by_time(frames(sequence(100), "hall"))
    assert [f.index for f in split.train] == list(range(60))
    assert split.test[0].index == 64  # 4.95 frames after frame 59
    assert split.test[-1].index == 99


def test_what_cannot_be_trained_or_tested_is_refused(sequence) -> None:
    hall, bath = frames(sequence(4), "hall"), frames(sequence(4), "bath")
    Split(hall + bath, hall).check()
    with pytest.raises(DatasetError, match="found classes to train with: hall; expected at least"):
        Split(hall, hall).check()
    with pytest.raises(DatasetError, match="found one frame of bath"):
        Split(hall + bath[:1], hall).check()
    with pytest.raises(DatasetError, match="found no frames to test with"):
        Split(hall + bath, []).check()
