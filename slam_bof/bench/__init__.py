"""What place recognition costs: the paper's tables 7 to 9, measured here on real frames.

CPU time is the process's, on one thread. All methods describe the same frames, in turn and
block by block, so that a noisy machine treats them alike. Reading and decoding images does not
count, and is told apart.
"""

from slam_bof.bench.describing import METHODS, Method
from slam_bof.bench.tables import run_bench

__all__ = ["METHODS", "Method", "run_bench"]
