"""How certain scene labels are: the temperature of logits, and for which views it is higher."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import log_softmax, softmax

from slam_bof.core import one_native_thread
from slam_bof.scenes.height_profile import FLOOR_SEEN, N_PROFILE_VALUES, SURFACE_SHARE
from slam_bof.scenes.mlp_ensemble import TEMPERATURES
from slam_bof.types import Array

__all__ = ["NO_WARMING", "Warming", "fit_certainty"]

N_DIGITS = 4
"""Significant digits of what is fitted. Further ones are an optimiser's, and would differ with the
number of threads and the version of a library."""
MAX_FLOOR_WARMING, MAX_EMPTY_WARMING = 4.0, 50.0
"""Largest ``Warming.assumed_floor`` and ``Warming.empty_view``."""


@dataclass(frozen=True, slots=True)
class Warming:
    """Factors of the temperature for views that say less: their labels are then less certain.

    ``assumed_floor`` counts where the floor is not seen, so that heights above it are assumed. Of
    ``empty_view`` the power counts that is the share of pixels without a surface.
    """

    assumed_floor: float = 1.0
    empty_view: float = 1.0

    def factors(self, profiles: NDArray[np.floating[Any]]) -> Array:
        """Return the factor (N,) for views with these height profiles (N, N_PROFILE_VALUES).

        Comparisons leave the profile out; the factor is then 1.
        """
        if profiles.shape[1] != N_PROFILE_VALUES:
            return np.ones(len(profiles))
        unseen, missing = 1.0 - profiles[:, [FLOOR_SEEN, SURFACE_SHARE]].T.astype(np.float64)
        return np.asarray(self.assumed_floor**unseen * self.empty_view**missing)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the factors as a model file holds them; those of 1 are absent, as in old files."""
        factors = {f"{name}_warming": getattr(self, name) for name in self.__slots__}
        return {name: np.array(factor) for name, factor in factors.items() if factor != 1.0}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Warming:
        """Restore the factors; ``ValueError`` if one is out of range."""
        found = {}
        limits = {"assumed_floor": MAX_FLOOR_WARMING, "empty_view": MAX_EMPTY_WARMING}
        for name, most in limits.items():
            factor = arrays.get(f"{name}_warming", np.array(1.0))
            if factor.shape != () or not 1.0 <= factor <= most:
                raise ValueError(f"{name}_warming must be a number, 1 to {most:g}")
            found[name] = float(factor)
        return cls(**found)


NO_WARMING = Warming()


@one_native_thread()
def fit_certainty(
    logits: NDArray[np.float32],
    index: NDArray[np.intp],
    profiles: NDArray[np.floating[Any]],
    weight: Array,
) -> tuple[float, Warming]:
    """Return the temperature, and its factors for views that say less.

    The factors minimise the cross entropy with the true classes, and with equal probabilities for
    all classes where a frame shows none of them. With these factors, the temperature is that at
    which labels of frames that show a class are right as often as they are probable in the mean.

    Parameters
    ----------
    logits
        (N, C) of frames held out from training.
    index
        (M,) true classes of the first M of them; the others show no class.
    profiles, weight
        (N, D) height profiles, and (N,) weight of each frame.
    """
    targets = np.full(logits.shape, 1.0 / logits.shape[1])
    targets[: len(index)] = np.eye(logits.shape[1])[index]

    def cross_entropy(parameters: Array) -> float:
        temperature, floor, empty = np.exp(parameters)
        scales = temperature * Warming(floor, empty).factors(profiles)
        logs = log_softmax(logits.astype(np.float64) / scales[:, None], axis=1)
        return -float(weight @ (targets * logs).sum(axis=1)) / float(weight.sum())

    def overconfidence(log_temperature: float) -> float:
        n = len(index)
        scales = np.exp(log_temperature) * Warming(floor, empty).factors(profiles[:n])
        p = softmax(logits[:n].astype(np.float64) / scales[:, None], axis=1)
        return float(weight[:n] @ (p.max(axis=1) - (p.argmax(axis=1) == index)) / weight[:n].sum())

    most = (TEMPERATURES, (1.0, MAX_FLOOR_WARMING), (1.0, MAX_EMPTY_WARMING))
    bounds = [tuple(np.log(limits)) for limits in most]
    start = np.array([0.3, 0.1, 0.1])
    best = minimize(cross_entropy, start, bounds=bounds, method="L-BFGS-B").x
    floor, empty = (_rounded(value) for value in np.exp(best[1:]).tolist())
    known = minimize_scalar(lambda t: overconfidence(t) ** 2, bounds=bounds[0], method="bounded")
    return _rounded(np.exp(known.x)), Warming(floor, empty)


def _rounded(value: float) -> float:
    return float(f"{value:.{N_DIGITS}g}")
