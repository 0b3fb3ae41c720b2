import numpy as np

from slam_bof.bof import (
    ConstellationIndex,
    PlaceParams,
    bit_images,
    compile_bof,
    constellation_consensus,
    constellation_correspondences,
    describe_constellation,
    descriptors,
    layers,
    levelled_slices,
    motion_votes,
)
from slam_bof.types import DepthFrame, Intrinsics

LOOPS = [
    bit_images.close,
    bit_images.dilate,
    bit_images.outer_contours,
    constellation_consensus._find_motions,
    constellation_correspondences._near_pairs,
    constellation_correspondences._peaks,
    layers._cut,
    layers._draw,
    layers._extents,
    levelled_slices._draw_slabs,
    motion_votes._agreeing,
    motion_votes._cells,
]


def test_frames_meet_nothing_that_is_not_compiled():
    compile_bof()
    before = [loop.signatures for loop in LOOPS]
    assert all(before)
    camera = Intrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)
    rng = np.random.default_rng(0)
    index = ConstellationIndex()
    for depth_mm in rng.integers(500, 4000, (3, 6, 8)).repeat(20, 1).repeat(20, 2):
        frame = DepthFrame(0.0, depth_mm.astype(np.uint16), camera)
        assert len(descriptors(frame, PlaceParams())) > 0
        view = describe_constellation(frame, (0.0, 0.9, 0.1)).bofs
        index.add(view)
        assert index.find(view, 1).view_ids == [len(index) - 1]
    assert [loop.signatures for loop in LOOPS] == before
