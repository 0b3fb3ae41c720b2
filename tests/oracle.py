"""The paper's method (section 2 and 3), slow and to the letter: what the fast code must equal.

Arithmetic is in the type of the input, operation by operation as the equations have it, so
that rounding to pixels and layers can be compared exactly.
"""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np


def back_project(depth_m, intrinsics, stride=1):
    points = []
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            z = float(depth_m[row, column])
            if z > 0:
                u, v = column * stride, row * stride
                x = (u - intrinsics.cx) / intrinsics.fx * z
                y = (v - intrinsics.cy) / intrinsics.fy * z
                points.append((x, y, z))
    return np.array(points).reshape(-1, 3)


def layer_index(points, n_layers, rounding):
    """Along the optical axis."""
    heights = [point[2] for point in points]
    if not heights:
        return []
    lowest, highest = min(heights), max(heights)
    delta = (highest - lowest) / type(lowest)(n_layers)
    if delta == 0:
        return [0] * len(heights)
    if rounding == "nearest":
        return [math.floor((h - lowest) / delta + type(h)(0.5)) for h in heights]
    return [min(math.floor((h - lowest) / delta), n_layers - 1) for h in heights]


def layer_images(points, n_layers, rounding, size):
    n_images = n_layers + 1 if rounding == "nearest" else n_layers
    images = np.zeros((n_images, size, size), np.uint8)
    index = np.array(layer_index(points, n_layers, rounding), int)
    for layer in range(n_images):
        of_layer = points[index == layer] if len(points) else points
        for x, y, _ in of_layer:
            column = pixel(x, of_layer[:, 0], size)
            row = pixel(y, of_layer[:, 1], size)
            images[layer, row, column] = 1
    return images


def pixel(value, values, size):
    delta = (values.max() - values.min()) / values.dtype.type(size - 1)
    if delta == 0:
        return 0
    return math.floor((value - values.min()) / delta + values.dtype.type(0.5))


def close(image, closing_px):
    """Closing in the unbounded plane: dilate, then erode."""
    r = closing_px // 2
    wide = np.pad(image, 2 * r)
    dilated = np.zeros_like(wide)
    for row, column in zip(*np.nonzero(wide), strict=True):
        dilated[row - r : row + r + 1, column - r : column + r + 1] = 1
    closed = np.zeros_like(image)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            window = dilated[row + r : row + 3 * r + 1, column + r : column + 3 * r + 1]
            closed[row, column] = window.all()
    return closed


def find_contours(images, closing_px, min_area_share):
    """Return [(layer, points (M, 2))]: OpenCV's border following, one layer at a time."""
    found = []
    for layer, image in enumerate(images):
        closed = close(image, closing_px)
        contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            if cv2.contourArea(contour) >= min_area_share * image.size:
                found.append((layer, contour[:, 0]))
    return found


def bof(contour, n, sampling="arc"):
    """Centroid, n points, distances counter-clockwise over the largest."""
    points = [tuple(map(float, point)) for point in contour]
    moments = cv2.moments(np.asarray(contour, np.int32).reshape(-1, 1, 2))
    area = shoelace(points)
    if area == 0:
        centre = middle_of_line(points)
    else:
        centre = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
    if sampling == "angle":
        radii = [ray(points, centre, 2 * math.pi * k / n) for k in range(n)]
        largest = max(radii)
        return [radius / largest if largest > 0 else 0.0 for radius in radii]
    if area > 0:  # y points down: positive is clockwise as seen
        points = points[:1] + points[:0:-1]
    closed = [*points, points[0]]
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(closed))
    radii = [math.dist(along(closed, k * length / n), centre) for k in range(n)]
    largest = max(radii)
    return [radius / largest if largest > 0 else 0.0 for radius in radii]


def middle_of_line(points):
    edges = list(zip(points, points[1:] + points[:1], strict=True))
    length = sum(math.dist(a, b) for a, b in edges)
    if length == 0:
        return points[0]
    return tuple(
        sum(math.dist(a, b) * (a[i] + b[i]) / 2 for a, b in edges) / length for i in range(2)
    )


def shoelace(points):
    following = points[1:] + points[:1]
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(points, following, strict=True)) / 2


def ray(points, centre, angle):
    """Return the distance to the farthest point of a polygon on a ray, 0 if there is none."""
    c, s = math.cos(angle), math.sin(angle)
    turned = [
        ((x - centre[0]) * c - (y - centre[1]) * s, (x - centre[0]) * s + (y - centre[1]) * c)
        for x, y in points
    ]
    farthest = 0.0
    for a, b in zip(turned, turned[1:] + turned[:1], strict=True):
        if (a[1] < 0) != (b[1] < 0):
            farthest = max(farthest, a[0] + (b[0] - a[0]) * a[1] / (a[1] - b[1]))
    return farthest


def along(closed, distance):
    """Return the point at a distance along a polygon."""
    for a, b in itertools.pairwise(closed):
        step = math.dist(a, b)
        if step > 0 and distance <= step:
            share = distance / step
            return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
        distance -= step
    return closed[-1]


def bag(descriptors, words, idf):
    """TF-IDF weights of a frame over all words, L1-normalised (equation 4)."""
    counts = [0] * len(words)
    for descriptor in descriptors:
        counts[int(np.argmin([np.linalg.norm(descriptor - word) for word in words]))] += 1
    weights = np.array([n / max(len(descriptors), 1) * w for n, w in zip(counts, idf, strict=True)])
    return weights / weights.sum() if weights.sum() > 0 else weights


def score(a, b):
    """L1 score of two dense bags (section 3.4)."""
    return 1 - 0.5 * np.abs(a / a.sum() - b / b.sum()).sum()
