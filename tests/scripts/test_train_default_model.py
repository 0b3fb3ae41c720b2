"""The script that trains the included models, on two rooms of each kind and one flat."""

from argparse import Namespace

import numpy as np

from slam_bof.synthetic import FIRST_KINDS, Scene3D

SMALL = {"rooms": 2, "views": 1, "flats": 1, "flat_views": 6, "words": 16, "cost": 0.1, "seed": 0}


def test_rendered_views_are_used_again_and_train_the_same_model(load_script, tmp_path, monkeypatch):
    script = load_script("train_default_model")
    args = Namespace(rendered=tmp_path, **SMALL)
    model = script["train"](args)
    assert tuple(model.levelled_classifier.network.classes_) == tuple(sorted(FIRST_KINDS))
    assert model.levelled_classifier.vocabulary is None
    assert model.vocabulary.words_.shape == (16, 180)
    with monkeypatch.context() as patch:
        patch.setattr(Scene3D, "view", None)  # nothing is rendered again
        assert script["train"](args).content_hash == model.content_hash


def test_views_of_a_flat_have_the_kind_of_the_room_that_they_are_taken_in(load_script):
    rendered = load_script("train_default_model")["RenderedViews"]()
    views = list(rendered.tour(1000, 6))
    assert [kind for _, kind in views] == [kind for _, kind in rendered.tour(1000, 6)]
    assert {"corridor", "living_room"} <= {kind for _, kind in views} <= set(FIRST_KINDS)
    assert all(np.count_nonzero(frame.depth) > 0.5 * frame.depth.size for frame, _ in views)
