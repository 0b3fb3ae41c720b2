"""The contracts of all plug-ins, as checks to run in the tests of your own plug-in.

>>> from slam_bof.testing import check_odometry
>>> def test_my_odometry():
...     check_odometry(MyOdometry, max_error_m=0.1)

Each check raises ``AssertionError`` with a message that says which contract of ``slam_bof.ports``
is broken. The checks need no data; they use a synthetic room.
"""

from slam_bof.testing.backends import check_backend
from slam_bof.testing.datasets import check_dataset
from slam_bof.testing.descriptors import check_descriptor
from slam_bof.testing.odometry import check_odometry
from slam_bof.testing.scenery import blind, example_frames
from slam_bof.testing.verifiers import check_verifier

__all__ = [
    "blind",
    "check_backend",
    "check_dataset",
    "check_descriptor",
    "check_odometry",
    "check_verifier",
    "example_frames",
]
