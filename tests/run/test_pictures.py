"""The depth images of pairs of keyframes for the report."""

import numpy as np
from saved_maps import make_candidate, make_keyframe, make_subsampled, save

from slam_bof.run.pictures import MAX_PAIRS, picture_pairs
from slam_bof.store import MapStore


def test_pairs_have_the_images_that_the_map_has_of_them(tmp_path):
    with MapStore.create(tmp_path / "map.db") as store:
        for k in range(12):
            save(store, make_keyframe(k, session=int(k >= 2)))
        # Of the second session, whose first keyframe is number 2 of the map.
        accepted = [make_candidate(k, 0) for k in range(1, 10)]
        rejected = make_candidate(9, 4, decision="rejected")
        others = [
            make_candidate(8, 7, kind="covisibility"),
            make_candidate(8, 0, decision="held"),
        ]
        pairs = picture_pairs(store, [*accepted, rejected, *others], 1)
    found = [(pair.candidate.query_id, pair.candidate.match_id) for pair in pairs]
    assert found == [(1, 0), (3, 0), (4, 0), (6, 0), (7, 0), (9, 0), (9, 4)]
    assert len(found) == MAX_PAIRS + 1
    for pair in pairs:
        ids = (pair.candidate.query_id + 2, pair.candidate.match_id + 2)
        depth_mm = np.hstack([make_subsampled(k).depth for k in ids])
        np.testing.assert_allclose(pair.depth_m, depth_mm / 1000, atol=1e-6)
