import numpy as np
import pytest

from slam_bof.core import GrowingArray


def test_rows_stay_as_the_stack_grows():
    rows = np.random.default_rng(0).integers(0, 100, (50, 2, 3))
    stack = GrowingArray((2, 3), np.int16)
    for row in rows:
        stack.append(row)
    assert len(stack) == 50
    assert stack.rows.dtype == np.int16
    np.testing.assert_array_equal(stack.rows, rows)
    assert stack.rows.nbytes <= stack.nbytes <= 1.2 * stack.rows.nbytes + 48


def test_scalars_and_none_at_all():
    stack = GrowingArray((), np.float32)
    assert stack.rows.shape == (0,)
    stack.append(2.5)
    assert stack.rows.tolist() == [2.5]


def test_truncated_rows_make_room_for_others():
    stack = GrowingArray((), np.int16)
    for row in range(6):
        stack.append(row)
    stack.truncate(2)
    assert stack.rows.tolist() == [0, 1]
    stack.truncate(5)  # no more than there are
    stack.append(9)
    assert stack.rows.tolist() == [0, 1, 9]


def test_a_row_of_another_shape_is_refused():
    with pytest.raises(ValueError, match="broadcast"):
        GrowingArray((2,), np.float32).append([1.0, 2.0, 3.0])


def test_rows_that_are_kept_move_up():
    stack = GrowingArray((), np.int64)
    stack.extend(np.arange(6))
    stack.keep(np.array([True, False, True, False, False, True]))
    restore = stack.checkpoint()
    stack.append(9)
    stack.put([0, 1], 7)
    assert stack.rows.tolist() == [7, 7, 5, 9]
    stack.keep(np.array([False, True, True, False]))
    assert stack.rows.tolist() == [7, 5]
    restore()
    assert stack.rows.tolist() == [0, 2, 5]
