import numpy as np
import pytest

from slam_bof.core import open_dataset
from slam_bof.datasets import Excerpt
from slam_bof.errors import ConfigError


@pytest.fixture
def dataset(tmp_path, write_turn):
    write_turn(tmp_path / "room" / "seq-01", [0.1 * k for k in range(6)])
    return open_dataset(tmp_path / "room" / "seq-01", "7scenes")


@pytest.mark.parametrize(
    ("text", "indices"), [("2:5", [2, 3, 4]), (":2", [0, 1]), ("4:", [4, 5]), ("3:99", [3, 4, 5])]
)
def test_a_stretch_is_a_sequence_of_its_own(dataset, text, indices):
    excerpt = Excerpt.parse(dataset, text)
    assert len(excerpt) == len(indices)
    assert (excerpt.name, excerpt.intrinsics) == ("7scenes", dataset.intrinsics)
    assert excerpt.sequence == f"room/seq-01[{indices[0]}:{indices[-1] + 1}]"
    for index, own in enumerate(indices):
        assert excerpt.frame(index).stamp_s == dataset.frame(own).stamp_s
        np.testing.assert_array_equal(excerpt.frame(index).depth, dataset.frame(own).depth)
    np.testing.assert_array_equal(excerpt.groundtruth().poses, dataset.groundtruth().poses[indices])
    with pytest.raises(IndexError):
        excerpt.frame(len(indices))


@pytest.mark.parametrize("text", ["400", "a:b", "-3:2", "6:9", "4:2", ""])
def test_a_stretch_that_is_none_is_named(dataset, text):
    with pytest.raises(ConfigError, match=r"--frames: found .* expected"):
        Excerpt.parse(dataset, text)
