import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import LevelledClassifier, levelled_features
from slam_bof.scenes.mlp_ensemble import MlpEnsemble


def frames(seed, n=24):
    rng = np.random.default_rng(seed)
    for i in range(n):
        table_m = (0.45, 0.9)[i % 2] + rng.uniform(-0.04, 0.04)
        yield (
            table_frame(
                table_m=table_m, ahead_m=rng.uniform(1.8, 2.3), eye_m=rng.uniform(1.4, 1.6)
            ),
            ("bench", "counter")[i % 2],
        )


@pytest.fixture(scope="module")
def scenes():
    seen = list(frames(0))
    network = MlpEnsemble(n_hidden=16, n_networks=1, n_steps=200, n_folds=2)
    views, labels = [levelled_features(frame) for frame, _ in seen], [label for _, label in seen]
    return LevelledClassifier.fit(views, labels, n_words=30, network=network)


def test_unseen_views_are_labelled(scenes):
    labelled = [(scenes.label(frame), label) for frame, label in frames(1, n=10)]
    assert all(scene.label == label for scene, label in labelled)
    scene = labelled[0][0]
    assert scene.classes == ("bench", "counter")
    assert scene.probability == scene.probabilities.max()
    assert scene.probabilities.sum() == pytest.approx(1.0)


def test_nothing_seen_is_labelled_too(scenes):
    assert np.isfinite(scenes.label(empty_frame()).probabilities).all()


def test_a_classifier_is_restored_from_its_description_and_arrays(scenes):
    again = LevelledClassifier.from_arrays(scenes.manifest(), scenes.arrays())
    frame, _ = next(frames(2))
    np.testing.assert_array_equal(
        again.label(frame).probabilities, scenes.label(frame).probabilities
    )
    assert again.manifest() == scenes.manifest()


@pytest.mark.parametrize("name", ["words", "temperature", "mean", "hidden", "out_bias"])
def test_arrays_that_do_not_fit_are_refused(scenes, name):
    arrays = scenes.arrays()
    with pytest.raises(ValueError, match="levels/"):
        LevelledClassifier.from_arrays(scenes.manifest(), arrays | {name: np.zeros((3, 3, 3))})
    del arrays[name]
    with pytest.raises(KeyError):
        LevelledClassifier.from_arrays(scenes.manifest(), arrays)
