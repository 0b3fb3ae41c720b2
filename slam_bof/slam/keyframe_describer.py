"""The description of a keyframe: its bag of words, its scene label, and the label so far."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_bof.scenes import Model, SceneFilter, SceneFilterParams
from slam_bof.types import Array, Bag, DepthFrame, Keyframe, Pose, Scene

__all__ = ["KeyframeDescriber", "KeyframeDescription"]


class KeyframeDescription(NamedTuple):
    """What a model says of a frame; the labels are None without a labeller or surfaces."""

    bag: Bag
    scene: Scene | None
    """The label of the frame by itself."""
    smoothed: Scene | None
    """The label by this frame and all before it."""


class KeyframeDescriber:
    """Describes and labels the keyframes of a session with a model.

    Parameters
    ----------
    model
        The vocabulary and the classifiers.
    params
        Parameters of scene labels.
    gravity_odom
        (3,) rough direction of gravity in the odometry frame.
    """

    def __init__(self, model: Model, params: SceneFilterParams, gravity_odom: Array) -> None:
        self._params, self._gravity_odom = params, gravity_odom
        self._describer = model.describer()
        self._labeller = model.labeller(params.by)
        self._scene_filter = SceneFilter(params)

    def describe(
        self, frame: DepthFrame, T_odom_camera: Pose, *, segment: int
    ) -> KeyframeDescription:
        """Describe and label a frame of a segment of the odometry, and filter the label."""
        gravity_camera = T_odom_camera[:3, :3].T @ self._gravity_odom
        bag = self._describer.describe(frame, gravity_camera=gravity_camera)
        scene = None
        if self._labeller is not None:
            scene = self._labeller.label(frame, gravity_camera=gravity_camera, bag=bag)
            if not np.isfinite(scene.probabilities).all():
                scene = None  # a view without surfaces that can be measured has no label
        smoothed = self._filter(scene, frame.stamp_s, T_odom_camera, segment)
        return KeyframeDescription(bag, scene, smoothed)

    def replay(self, keyframe: Keyframe) -> None:
        """Filter the label that a saved keyframe was given."""
        self._filter(keyframe.scene, keyframe.stamp_s, keyframe.T_odom_camera, keyframe.segment)

    def begin_session(self) -> None:
        """Start the filter of labels again: the camera may have been carried elsewhere."""
        self._scene_filter = SceneFilter(self._params)

    def _filter(
        self, scene: Scene | None, stamp_s: float, T_odom_camera: Pose, segment: int
    ) -> Scene | None:
        if scene is None:
            return None
        position_m, axis = T_odom_camera[:3, 3], T_odom_camera[:3, 2]
        return self._scene_filter.update(scene, stamp_s, position_m, axis=axis, segment=segment)
