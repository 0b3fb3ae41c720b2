"""Messages of errors that a user can correct."""

import pickle

from slam_bof.errors import MAX_MESSAGE, DatasetError, FrameError


def test_a_long_message_is_cut_in_its_middle() -> None:
    error = DatasetError(f"walk.bag: found {'[' * 5000}, expected a topic of 16UC1")
    for found in (error, pickle.loads(pickle.dumps(error))):
        text = str(found)
        assert text.startswith("walk.bag: found [[[")
        assert text.endswith("[[[, expected a topic of 16UC1")
        assert len(text) < MAX_MESSAGE + 10


def test_a_message_of_usual_length_stays_as_it_is() -> None:
    for text in ("", "x" * MAX_MESSAGE):
        assert str(FrameError(text)) == text
