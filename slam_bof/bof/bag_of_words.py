"""From a depth frame to its bag of words: the method of the paper's section 3."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.contours import ContourParams, layer_contours
from slam_bof.bof.descriptor import BofParams, describe
from slam_bof.bof.layers import LayerParams
from slam_bof.bof.vocabulary import TfIdf, Vocabulary
from slam_bof.geometry import PointParams, points_camera_f32
from slam_bof.types import Array, Bag, Contours, DepthFrame, Params

__all__ = ["PlaceDescriber", "PlaceParams", "descriptors", "layer_rows"]


class PlaceParams(Params):
    """The parameters of each step. A model holds them, since its words depend on them."""

    points: PointParams = PointParams()
    layers: LayerParams = LayerParams()
    contours: ContourParams = ContourParams()
    bof: BofParams = BofParams()


def descriptors(
    frame: DepthFrame, params: PlaceParams, *, gravity_camera: Array | None = None
) -> NDArray[np.float32]:
    """Return the BOF descriptors of a frame, (C, n_values); C = 0 where it has no contour.

    ``gravity_camera`` (3,) is the direction of gravity in the camera frame, needed for layers along
    gravity only.
    """
    return describe(_contours(frame, params, gravity_camera), params.bof)


def layer_rows(
    frame: DepthFrame, params: PlaceParams, *, gravity_camera: Array | None = None
) -> NDArray[np.float32]:
    """Return the BOF of each layer's largest contour, concatenated, (1, n_images * n_values).

    It is zero where a layer has no contour. The paper proposes such rows as the input of a neural
    network (section 5). To make rows comparable, ``bof.sampling`` should be ``angle``.
    """
    contours = _contours(frame, params, gravity_camera)
    values = describe(contours, params.bof)
    rows = np.zeros((params.layers.n_images, params.bof.n_values), np.float32)
    areas = np.array([cv2.contourArea(points) for points in contours.points_px])
    for i in np.argsort(areas, kind="stable").tolist():
        rows[contours.layer[i]] = values[i]
    return rows.reshape(1, -1)


def _contours(frame: DepthFrame, params: PlaceParams, gravity_camera: Array | None) -> Contours:
    points = points_camera_f32(frame, params.points)
    return layer_contours(points, params.layers, params.contours, gravity_camera=gravity_camera)


class PlaceDescriber:
    """Describes depth frames by a trained vocabulary."""

    def __init__(self, params: PlaceParams, vocabulary: Vocabulary, tf_idf: TfIdf) -> None:
        self.params = params
        self.vocabulary = vocabulary
        self.tf_idf = tf_idf

    def describe(self, frame: DepthFrame, *, gravity_camera: Array | None = None) -> Bag:
        """Return the frame's bag of words, empty where the frame has no contour."""
        return self.tf_idf.bag(self.words(frame, gravity_camera=gravity_camera))

    def words(self, frame: DepthFrame, *, gravity_camera: Array | None = None) -> NDArray[np.int32]:
        """Return the visual words of the frame's contours, (C,)."""
        return self.vocabulary.lookup(
            descriptors(frame, self.params, gravity_camera=gravity_camera)
        )
