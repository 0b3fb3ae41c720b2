import numpy as np
import pytest

from slam_bof.core import open_dataset
from slam_bof.datasets import SequenceSlice
from slam_bof.errors import ConfigError


@pytest.fixture
def dataset(tmp_path, write_turn):
    write_turn(tmp_path / "room" / "seq-01", [0.1 * k for k in range(6)])
    return open_dataset(tmp_path / "room" / "seq-01", "7scenes")


@pytest.mark.parametrize(
    ("text", "indices"), [("2:5", [2, 3, 4]), (":2", [0, 1]), ("4:", [4, 5]), ("3:99", [3, 4, 5])]
)
def test_a_slice_is_a_sequence_of_its_own(dataset, text, indices):
    part = SequenceSlice.parse(dataset, text)
    assert len(part) == len(indices)
    assert (part.name, part.intrinsics) == ("7scenes", dataset.intrinsics)
    assert part.sequence == f"room/seq-01[{indices[0]}:{indices[-1] + 1}]"
    for index, own in enumerate(indices):
        assert part.frame(index).stamp_s == dataset.frame(own).stamp_s
        np.testing.assert_array_equal(part.frame(index).depth, dataset.frame(own).depth)
    np.testing.assert_array_equal(part.groundtruth().poses, dataset.groundtruth().poses[indices])
    with pytest.raises(IndexError):
        part.frame(len(indices))


@pytest.mark.parametrize("text", ["400", "a:b", "-3:2", "6:9", "4:2", ""])
def test_an_empty_or_malformed_slice_is_refused(dataset, text):
    with pytest.raises(ConfigError, match=r"--frames: found .* expected"):
        SequenceSlice.parse(dataset, text)
