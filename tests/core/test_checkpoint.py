"""Objects return to an earlier state, by reference and without copies of their arrays."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from slam_bof.core import Checkpoint, GrowingArray


class Holder:
    def __init__(self):
        self.rows = GrowingArray((2,), np.float64)
        self.lists = [[1], [2]]
        self.by_name = {"a": {1}, "b": {2}}
        self.last = deque([1, 2], maxlen=2)
        self.counts = Counts()
        self.me = self


@dataclass(slots=True)
class Counts:
    n: int = 0
    ids: list[int] = field(default_factory=list)


def test_all_that_an_object_holds_is_restored():
    holder = Holder()
    holder.rows.extend(np.arange(6.0).reshape(3, 2))
    held, block = dict(vars(holder)), holder.rows.rows
    before = Checkpoint()
    before.save(holder)
    for _ in range(2):
        holder.rows.truncate(1)
        holder.rows.append([9.0, 9.0])
        holder.lists[0].append(7)
        holder.lists.pop()
        holder.by_name["a"].clear()
        del holder.by_name["b"]
        holder.last.append(3)
        holder.counts.n += 1
        holder.counts.ids.append(1)
        holder.new, holder.me = 1, None
        before.restore()
        assert vars(holder) == held
        assert holder.lists == [[1], [2]]
        assert holder.by_name == {"a": {1}, "b": {2}}
        assert list(holder.last) == [1, 2]
        assert holder.counts == Counts()
        np.testing.assert_array_equal(holder.rows.rows, np.arange(6.0).reshape(3, 2))
        assert np.shares_memory(holder.rows.rows, block)


def test_rows_after_a_checkpoint_stay_in_their_block_where_none_is_overwritten():
    array = GrowingArray((), np.int64)
    array.extend(np.arange(20))
    block = array.rows
    array.checkpoint()
    array.append(20)
    array.truncate(20)
    array.append(21)
    assert np.shares_memory(array.rows, block)
    assert array.rows.tolist() == [*range(20), 21]
    array.truncate(19)
    array.append(22)
    assert not np.shares_memory(array.rows, block)
    assert array.rows.tolist() == [*range(19), 22]
    assert block.tolist() == list(range(20))
