"""The map's point cloud, read back with Open3D."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slam_bof.core import import_open3d
from slam_bof.maps.point_cloud import write_keyframe_cloud
from slam_bof.types import DepthFrame, Intrinsics

open3d = import_open3d()

CAMERA = Intrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)


def look(depth_mm: int) -> DepthFrame:
    depth = np.full((CAMERA.height, CAMERA.width), depth_mm, np.uint16)
    return DepthFrame(0.0, depth, CAMERA)


def test_a_cloud_is_what_open3d_reads(tmp_path: Path) -> None:
    T = np.stack([np.eye(4), np.eye(4)])
    n = write_keyframe_cloud(tmp_path / "map.ply", [look(1500), look(2500)], T, voxel_size_m=0.05)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "map.ply"))
    points, colors = np.asarray(cloud.points), np.asarray(cloud.colors)
    assert len(points) == len(colors) == n > 1000
    np.testing.assert_allclose(np.unique(points[:, 2]), [1.5, 2.5])
    assert np.ptp(colors, axis=0).min() > 0.5
    open3d.io.write_point_cloud(str(tmp_path / "own.ply"), cloud)
    ours, own = ((tmp_path / name).read_bytes() for name in ("map.ply", "own.ply"))
    assert ours.split(b"end_header\n", 1)[1] == own.split(b"end_header\n", 1)[1]


def test_nothing_seen_is_a_cloud_of_no_points(tmp_path: Path) -> None:
    assert write_keyframe_cloud(tmp_path / "map.ply", [look(0)], np.eye(4)[None]) == 0
    assert b"element vertex 0\n" in (tmp_path / "map.ply").read_bytes()


FULL = """
import sys, signal
from pathlib import Path
import numpy as np
from test_point_cloud import look
from slam_bof.maps.point_cloud import write_keyframe_cloud
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
write_keyframe_cloud(Path(sys.argv[1]), [look(1500)], np.eye(4)[None])
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit of files here")
def test_a_cloud_that_has_no_room_is_one_error(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "map.ply")],
        cwd=Path(__file__).parent,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )
    assert done.stderr.splitlines()[-1].startswith("OSError: [Errno 27] File too large")
    assert "RPly" not in done.stderr
