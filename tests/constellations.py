"""Constellations of random contours."""

import numpy as np

from slam_bof.bof.constellation import N_HARMONICS, PlacedBofs, encode

ANGLE = np.arange(180) * (2 * np.pi / 180)


def view(seed, n=30):
    """Contours of random shapes, sizes and places."""
    random = np.random.default_rng(seed)
    a2, a3 = random.uniform(0.1, 0.4, (2, n, 1))
    p2, p3 = random.uniform(0, 2 * np.pi, (2, n, 1))
    radii = 1 + a2 * np.cos(2 * ANGLE + p2) + a3 * np.cos(3 * ANGLE + p3)
    radii /= radii.max(axis=1, keepdims=True)
    largest = random.uniform(0.2, 1.5, n)
    return PlacedBofs(
        random.integers(5, 25, n).astype(np.int8),
        (random.uniform(-1.5, 1.5, n) + 1j * random.uniform(1, 4, n)).astype(np.complex64),
        np.log(largest).astype(np.float32),
        radii.mean(axis=1).astype(np.float32),
        (7 * largest).astype(np.float32),
        encode(radii.astype(np.float32)),
    )


def seen_again(bofs, yaw, shift, seed=0, share=0.6):
    """Some contours of a view, seen from elsewhere, their places a little off, and others."""
    random = np.random.default_rng(seed)
    half, k = N_HARMONICS, np.arange(N_HARMONICS)
    spectrum = (bofs.codes[:, :half] + 1j * bofs.codes[:, half:]) * np.exp(-1j * k * yaw)
    off = random.normal(0, 0.03, (2, len(bofs.slices)))
    centroids = bofs.centroids_m * np.exp(1j * yaw) + shift + off[0] + 1j * off[1]
    moved = bofs._replace(
        centroids_m=centroids.astype(np.complex64),
        codes=np.concatenate([spectrum.real, spectrum.imag], axis=1).astype(np.float32),
    )
    kept = random.random(len(bofs.slices)) < share
    return PlacedBofs(
        *(np.concatenate([a[kept], b[~kept]]) for a, b in zip(moved, view(seed + 999), strict=True))
    )
