"""Labellers: from one depth frame to its scene label with probabilities."""

from __future__ import annotations

from typing import Protocol

from slam_bof.bof import PlaceDescriber
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.types import Array, Bag, DepthFrame, Scene

__all__ = ["BagLabeller", "Labeller"]


class Labeller(Protocol):
    """Labels the scene that a depth frame shows."""

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene with the probability of every class.

        Parameters
        ----------
        frame
            The depth image.
        gravity_camera
            (3,) direction of gravity in the camera frame, if known.
        bag
            The frame's bag of words, if it is already computed.
        """
        ...


class BagLabeller:
    """Labels frames by their bags of words alone, as in the paper."""

    def __init__(self, describer: PlaceDescriber, classifier: SceneClassifier) -> None:
        self._describer = describer
        self._classifier = classifier

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene of the frame's bag; see ``Labeller.label``."""
        if bag is None:
            bag = self._describer.describe(frame, gravity_camera=gravity_camera)
        return self._classifier.predict_bag(bag)
