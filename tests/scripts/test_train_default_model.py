"""The script that trains the included models, on two rooms of each kind and one flat."""

from argparse import Namespace

import numpy as np
import pytest

from slam_bof.synthetic import FIRST_KINDS, PIECES, ROOM_KINDS, Scene3D, make_flat, make_tour

SMALL = {
    "rooms": 2, "views": 1, "flats": 1, "flat_views": 6, "words": 16, "cost": 0.1, "seed": 0,
    "new_furniture": False,
}  # fmt: skip


def test_rendered_views_are_used_again_and_train_the_same_model(load_script, tmp_path, monkeypatch):
    script = load_script("train_default_model")
    args = Namespace(rendered=tmp_path, new_words=True, **SMALL)
    model = script["train"](args)
    assert tuple(model.levelled_classifier.network.classes_) == tuple(sorted(FIRST_KINDS))
    assert model.levelled_classifier.vocabulary is None
    assert model.vocabulary.words_.shape == (16, 180)
    with monkeypatch.context() as patch:
        patch.setattr(Scene3D, "view", None)  # nothing is rendered again
        args.new_words = False
        again = script["train"](args)
    words = script["models"].resolve("synthetic").vocabulary.words_
    np.testing.assert_array_equal(again.vocabulary.words_, words)
    for name, array in model.levelled_classifier.arrays().items():
        np.testing.assert_array_equal(again.levelled_classifier.arrays()[name], array)


def test_furniture_is_learnt_to_the_same_weights(load_script):
    pytest.importorskip("torch")
    script = load_script("train_default_model")
    args = Namespace(
        new_furniture=True, furniture_rooms=1, furniture_views=1, furniture_epochs=2, seed=0
    )
    first, again = (script["furniture"](args).arrays() for _ in range(2))
    assert len(first["piece"]) == len(PIECES)
    assert len(first["room"]) == len(ROOM_KINDS)
    for name, weights in first.items():
        np.testing.assert_array_equal(weights, again[name])


def test_views_of_a_flat_have_the_kind_of_the_room_that_they_show(load_script):
    views = list(load_script("train_default_model")["RenderedViews"]().tour(1000, 6))
    flat, tour = make_flat(1000), make_tour(make_flat(1000), seed=1000)
    poses = tour[np.linspace(0, len(tour) - 1, 6).round().astype(int)]
    stands = [flat.kind_at(*T_world_camera[:2, 3]) for T_world_camera in poses]
    # The first frame is taken in the hallway, before the open door of the room.
    assert (stands[0], views[0][1]) == ("corridor", flat.rooms[0].kind)
    assert np.mean([kind == room for (_, kind), room in zip(views, stands, strict=True)]) > 0.5
    assert all(np.count_nonzero(frame.depth) > 0.5 * frame.depth.size for frame, _ in views)
