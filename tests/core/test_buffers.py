import threading

import numpy as np

from slam_bof.bof import PlaceParams, descriptors
from slam_bof.core import thread_buffer


def test_a_name_and_shape_have_one_array_in_a_thread():
    first = thread_buffer("test", (2, 3))
    assert thread_buffer("test", (2, 3)) is first
    assert thread_buffer("other", (2, 3)) is not first
    assert thread_buffer("test", (4,)).shape == (4,)
    assert first.dtype == np.uint8


def test_threads_do_not_disturb_each_other(look):
    params = PlaceParams()
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    poses[:, :3, 3] = [[2.0, 2.0, 1.0 + 0.2 * i] for i in range(3)]
    frames = [look(pose, index) for index, pose in enumerate(poses)]
    alone = [descriptors(frame, params) for frame in frames]
    found = {}

    def describe(index):
        for _ in range(10):
            found[index] = descriptors(frames[index], params)
            np.testing.assert_array_equal(found[index], alone[index])

    threads = [threading.Thread(target=describe, args=(index,)) for index in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for index, expected in enumerate(alone):
        np.testing.assert_array_equal(found[index], expected)
