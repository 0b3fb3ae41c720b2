"""The contract of descriptor plug-ins, as a test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slam_bof.ports import Descriptor
from slam_bof.testing.scenery import blind, example_frames, expect

__all__ = ["check_descriptor"]

LOCAL = ("bag", "hamming")
COMPARISONS = (*LOCAL, "cosine", "l1", "equal")


def check_descriptor(make: Callable[[], Descriptor]) -> None:
    """Check that a descriptor obeys its port.

    The same frame gives the same rows; one that shows nothing gives none (``bag`` and ``hamming``)
    or one finite row; a grey image is asked for where it is needed.

    Parameters
    ----------
    make
        Makes a new one: its class, if it needs no arguments.

    Raises
    ------
    AssertionError
        In words.
    """
    (frame,), _ = example_frames(1)
    gray = np.random.default_rng(0).integers(0, 256, frame.depth.shape).astype(np.uint8)
    descriptor = make()
    expect(isinstance(descriptor, Descriptor), "it must have all of slam_bof.ports.Descriptor")
    expect(descriptor.comparison in COMPARISONS, f"comparison must be one of {COMPARISONS}")
    found = descriptor.describe(frame, gray)
    expect(found.ndim == 2 and len(found) > 0, f"rows (M, D) are expected, got {found.shape}")
    is_local = descriptor.comparison in LOCAL
    expect(is_local or len(found) == 1, f"one row describes the frame, unless {LOCAL}")
    expect(found.dtype == np.uint8 or not descriptor.is_binary, "bits are packed in uint8")
    expect(np.array_equal(found, descriptor.describe(frame, gray)), "twice must give the same")
    nothing = descriptor.describe(blind(frame)[0], np.zeros_like(gray))
    expect(
        nothing.shape == (0 if is_local else 1, found.shape[1]),
        f"a blind frame must give {0 if is_local else 1} rows like the others, got {nothing.shape}",
    )
    expect(bool(np.isfinite(nothing).all()), "a blind frame must give finite values")
    try:
        without = descriptor.describe(frame, None)
    except ValueError:
        expect(descriptor.needs_gray, "without a grey image it fails, though it needs none")
    else:
        expect(not descriptor.needs_gray, "without a grey image it must raise ValueError")
        expect(len(without) > 0, "depth alone must give rows where no grey image is needed")
