"""Scene labels from levelled views: metric profile and shape words, judged by a small network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.bof import Vocabulary
from slam_bof.scenes.height_profile import N_PROFILE, measure_profile
from slam_bof.scenes.levelled_view import level_view
from slam_bof.scenes.mlp_ensemble import SceneNetwork
from slam_bof.scenes.shape_words import N_SHAPE, describe_shapes
from slam_bof.types import Array, Bag, DepthFrame, Scene

__all__ = ["LevelScenes", "LevelledView", "look"]

N_WORDS = 400
NETWORK_ARRAYS = ("mean", "scale", "hidden", "hidden_bias", "out", "out_bias")


@dataclass(frozen=True, slots=True, eq=False)
class LevelledView:
    """Numbers of one view: its ``profile`` (P,), and its ``shapes`` (C, N_SHAPE)."""

    profile: NDArray[np.float32]
    shapes: NDArray[np.float32]


def look(frame: DepthFrame, *, gravity_camera: Array | None = None) -> LevelledView:
    """Return the numbers of a frame; down is found by its surfaces, near what is given."""
    view = level_view(frame, gravity_camera=gravity_camera)
    return LevelledView(measure_profile(view), describe_shapes(view))


@dataclass(frozen=True, eq=False)
class LevelScenes:
    """What labels frames: a vocabulary of shapes, and a network on profile and words.

    It is a ``labelling.Labeller``, which needs no bag.
    """

    vocabulary: Vocabulary
    network: SceneNetwork

    @classmethod
    def learn(
        cls,
        views: Sequence[LevelledView],
        labels: Sequence[str],
        groups: ArrayLike | None = None,
        *,
        n_moments: int | None = None,
        n_words: int = N_WORDS,
        network: SceneNetwork | None = None,
        seed: int = 0,
    ) -> Self:
        """Learn of views and their labels; ``groups``, ``n_moments`` are ``SceneNetwork.fit``'s.

        ``network`` is the one to fit, by default the usual one with ``seed``.
        Where there are fewer shapes than words, there are as many words as shapes.
        """
        shapes = np.concatenate([view.shapes for view in views])
        if len(shapes) == 0:
            shapes = np.zeros((1, views[0].shapes.shape[1]), np.float32)
        vocabulary = Vocabulary(n_words=min(n_words, len(shapes)), seed=seed).fit(shapes)
        scenes = cls(vocabulary, network or SceneNetwork(seed=seed))
        numbers = np.array([scenes.numbers(view) for view in views])
        scenes.network.fit(numbers, np.asarray(labels), groups, n_moments=n_moments)
        return scenes

    def description(self) -> dict[str, Any]:
        """Return the parameters, which with ``arrays`` tell all."""
        vocabulary = self.vocabulary.get_params()
        del vocabulary["n_words"]  # known from the words
        classes = [str(label) for label in self.network.classes_]
        return {"vocabulary": vocabulary, "network": self.network.get_params(), "classes": classes}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that were learnt, by name."""
        learnt = {name: getattr(self.network, f"{name}_") for name in NETWORK_ARRAYS}
        temperature = np.array(self.network.temperature_)
        return {"words": self.vocabulary.words_, "temperature": temperature, **learnt}

    @classmethod
    def from_arrays(cls, description: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Self:
        """Return what ``description`` and ``arrays`` were taken of.

        Raises
        ------
        KeyError, TypeError, ValueError
            If something is missing, not known, or of another shape than the rest expects.
        """
        words, classes = arrays["words"], np.array(description["classes"])
        network = SceneNetwork(**description["network"])
        n_numbers, n_neurons = N_PROFILE + len(words), network.n_networks * network.n_hidden
        shapes = {
            "words": (len(words), N_SHAPE),
            "temperature": (),
            "mean": (n_numbers,),
            "scale": (n_numbers,),
            "hidden": (n_numbers, n_neurons),
            "hidden_bias": (n_neurons,),
            "out": (n_neurons, len(classes)),
            "out_bias": (len(classes),),
        }
        for name, shape in shapes.items():
            if arrays[name].shape != shape:
                raise ValueError(f"levels/{name} must be {shape}, got {arrays[name].shape}")
        for name in NETWORK_ARRAYS:
            setattr(network, f"{name}_", arrays[name])
        network.classes_, network.n_features_in_ = classes, n_numbers
        network.temperature_ = float(arrays["temperature"])
        return cls(Vocabulary.from_words(words, **description["vocabulary"]), network)

    def numbers(self, view: LevelledView) -> NDArray[np.float32]:
        """Return what the network sees of a view: profile, square roots of shares of words."""
        words = self.vocabulary.lookup(view.shapes)
        counts = np.bincount(words, minlength=self.vocabulary.n_words)
        return np.concatenate(
            [view.profile, np.sqrt(counts / max(len(words), 1))], dtype=np.float32
        )

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene that a frame shows; the bag is not looked at."""
        return self.label_view(look(frame, gravity_camera=gravity_camera))

    def label_view(self, view: LevelledView) -> Scene:
        """Return the scene that a view shows."""
        probabilities = self.network.probabilities(self.numbers(view)[None])[0]
        best = int(probabilities.argmax())
        classes = tuple(str(label) for label in self.network.classes_)
        return Scene(classes[best], float(probabilities[best]), classes, probabilities)
