"""What every plug-in is held to: run these in the tests of your own.

>>> from slam_bof.testing import check_odometry
>>> def test_my_odometry():
...     check_odometry(MyOdometry, max_error_m=0.1)

Each check raises ``AssertionError`` that says in words what is not as its port
(``slam_bof.ports``) has it. They need no data: what they show is a synthetic room.
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
