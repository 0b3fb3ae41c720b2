"""Which images of a bag have usable times, and in which order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bags import FORMATS, INFO, TOPIC, time_ns, writing
from datasets import check_dataset, ramp
from hypothesis import given, strategies as st

from slam_bof.core import registry
from slam_bof_plugins.bag_times import order_by_stamp

N = 60
STAMPED = np.arange(N) * 33_333_333 + 1_700_000_000_000_000_000
RECEIVED = STAMPED + 5_000_000


def kept(stamped: list[int], received: list[int]) -> list[int] | None:
    order = order_by_stamp(np.array(stamped), np.array(received))
    return None if order is None else order.tolist()


def without(*numbers: int) -> list[int]:
    return [k for k in range(N) if k not in numbers]


@given(
    st.integers(0, N - 1),
    st.sampled_from(["zero", "future", "rolled over", "repeated", "an hour ago"]),
)
def test_one_broken_stamp_costs_one_image(at: int, kind: str) -> None:
    stamped = STAMPED.copy()
    stamped[at] = {
        "zero": 0,
        "future": STAMPED[at] + 4 * 10**17,
        "rolled over": 2**63 - 1,
        "repeated": STAMPED[at - 1 if at else 1],
        "an hour ago": STAMPED[at] - 3_600 * 10**9,
    }[kind]
    order = kept(stamped, RECEIVED)
    assert order is not None
    assert len(order) == N - 1
    assert (np.diff(stamped[order]) > 0).all()
    repeats = {at, at - 1 if at else 1} if kind == "repeated" else {at}
    assert set(range(N)) - set(order) <= repeats


@given(st.sets(st.integers(0, N - 1), max_size=5), st.sampled_from([0, 2**63 - 1]))
def test_the_order_of_headers_wins_over_a_broken_log(broken: set[int], time: int) -> None:
    """A recorder's broken clock moves images to the bag's start or end; none is lost."""
    received = RECEIVED.copy()
    received[list(broken)] = time
    log_order = np.argsort(received, kind="stable")
    order = kept(STAMPED[log_order], received[log_order])
    assert order is not None
    assert log_order[order].tolist() == list(range(N))


def test_late_messages_are_put_in_order() -> None:
    received = RECEIVED.copy()
    received[30] += 400_000_000
    log_order = np.argsort(received, kind="stable")
    order = kept(STAMPED[log_order], received[log_order])
    assert log_order[order].tolist() == list(range(N))


def test_a_recorder_with_another_clock_does_not_matter() -> None:
    stamped = STAMPED.copy()
    stamped[20] += 4 * 10**17
    assert kept(stamped, np.arange(N) * 10**9) == without(20)
    assert kept(STAMPED, np.zeros(N, np.int64)) == without()


def test_stamps_that_are_mostly_broken_are_given_up() -> None:
    assert kept(np.zeros(N, np.int64), RECEIVED) is None
    assert kept(STAMPED[::-1].copy(), RECEIVED) is None


@pytest.mark.parametrize("form", FORMATS)
def test_images_are_read_in_the_order_of_their_stamps(
    tmp_path: Path, form: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The third arrives last, and the second has the first one's stamp."""
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        for number in range(8):
            stamp_ns = time_ns(0) if number == 1 else None
            late_ns = time_ns(12) if number == 2 else None
            bag.image(
                TOPIC, time_ns(number), ramp(number), "16UC1",
                stamp_ns=stamp_ns, received_ns=late_ns,
            )  # fmt: skip
    dataset = registry.open_dataset(path)
    check_dataset(dataset)
    assert len(dataset) == 7
    for index, number in enumerate((0, 2, 3, 4, 5, 6, 7)):
        np.testing.assert_array_equal(dataset.frame(index).depth, ramp(number))
        assert dataset.frame(index).stamp_s == pytest.approx(time_ns(number) * 1e-9, abs=1e-6)
    assert "1 of 8 images have a broken or repeated time and are left out" in caplog.text
