"""From one depth frame to its scene label: what a trained model says, whatever it looks at."""

from __future__ import annotations

from typing import Protocol

from slam_bof.bof import PlaceDescriber
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.types import Array, Bag, DepthFrame, Scene

__all__ = ["BagLabeller", "Labeller"]


class Labeller(Protocol):
    """Says which scene a depth frame shows."""

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene with the probability of every class.

        Parameters
        ----------
        frame
            The depth image.
        gravity_camera
            (3,) direction down in the camera frame, where it is known.
        bag
            The frame's bag of words, where it is computed already.
        """
        ...


class BagLabeller:
    """Labels frames by their bags of words alone, as the paper does."""

    def __init__(self, describer: PlaceDescriber, scenes: SceneClassifier) -> None:
        self._describer = describer
        self._scenes = scenes

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene of the frame's bag, as ``Labeller`` has it."""
        if bag is None:
            bag = self._describer.describe(frame, gravity_camera=gravity_camera)
        return self._scenes.predict_bag(bag)
