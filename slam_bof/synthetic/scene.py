"""Views of a mesh through a pinhole camera: depth, colour and incidence by ray casting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import import_open3d
from slam_bof.geometry import ray_slopes
from slam_bof.synthetic.meshes import Mesh
from slam_bof.types import Intrinsics, Pose

__all__ = ["KINECT", "Scene3D", "View", "ray_casting_scene"]

KINECT = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
"""The depth camera of 7-Scenes."""

_BRIGHT = 0.35
"""Albedo above which a surface returns enough light for a depth camera."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The view of an ideal camera.

    ``depth_m`` (H, W) float32 is z, 0 where a ray leaves the scene; ``cosine`` (H, W) float32
    that of the angle between ray and surface normal; ``returned`` (H, W) float32 the share of
    light that comes back, the cosine and less on dark surfaces; ``triangle`` (H, W) the index of
    the triangle hit, -1 where none.
    """

    depth_m: NDArray[np.float32]
    cosine: NDArray[np.float32]
    returned: NDArray[np.float32]
    triangle: NDArray[np.int64]


class Scene3D:
    """A mesh seen by one camera.

    Parameters
    ----------
    mesh
        The mesh in the world frame.
    intrinsics
        Intrinsics of the camera.
    """

    def __init__(self, mesh: Mesh, intrinsics: Intrinsics = KINECT) -> None:
        self._scene, self._tensor = ray_casting_scene(mesh)
        self._albedo = (255 * mesh.albedo).astype(np.float32)
        self._bright = np.minimum(mesh.albedo.mean(axis=1) / _BRIGHT, 1.0).astype(np.float32)
        self.intrinsics = intrinsics
        x, y = np.meshgrid(*ray_slopes(intrinsics))
        # With z = 1 in every direction, the distance along the ray is the depth z itself.
        self._rays = np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)
        self._length = np.linalg.norm(self._rays, axis=-1)

    def view(self, T_world_camera: Pose) -> View:
        """Cast one ray through each pixel centre."""
        R, t = T_world_camera[:3, :3].astype(np.float32), T_world_camera[:3, 3]
        rays = np.empty((*self._length.shape, 6), np.float32)
        rays[..., :3] = t
        directions = self._rays @ R.T
        rays[..., 3:] = directions
        hits = self._scene.cast_rays(self._tensor.from_numpy(rays))
        depth = hits["t_hit"].numpy()
        missed = np.isinf(depth)
        depth[missed] = 0.0
        cosine = np.abs(np.einsum("hwi,hwi->hw", hits["primitive_normals"].numpy(), directions))
        triangle = hits["primitive_ids"].numpy().astype(np.int64)
        triangle[missed] = -1
        cosine /= self._length
        return View(depth, cosine, cosine * self._bright[triangle], triangle)

    def color(self, view: View) -> NDArray[np.uint8]:
        """Shade a view (H, W, 3) RGB: albedo in the light of a lamp beside the camera."""
        shade = (0.35 + 0.65 * view.cosine) / (1.0 + 0.02 * np.square(view.depth_m))
        shaded = self._albedo[view.triangle] * shade[..., None]
        shaded[view.triangle < 0] = 0.0
        return shaded.astype(np.uint8)


def ray_casting_scene(mesh: Mesh) -> tuple[Any, Any]:
    """Return a mesh as Open3D's scene for ray casting, and the class of its tensors."""
    o3d = import_open3d()
    tensor, scene = o3d.core.Tensor, o3d.t.geometry.RaycastingScene()
    corners = mesh.triangles.reshape(-1, 3).astype(np.float32)
    index = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(tensor(corners), tensor(index))
    return scene, tensor
