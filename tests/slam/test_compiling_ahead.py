"""No frame waits for the compiler: a loop closer compiles all loops when it is built."""

import subprocess
import sys

SCRIPT = """
import sys
from numba.core.dispatcher import Dispatcher
from slam_bof.slam import LoopCloser
from slam_bof.testing import example_frames

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("slam_bof")]
    functions = [f for m in modules for f in vars(m).values() if isinstance(f, Dispatcher)]
    return {(f.__module__, f.__name__): f.signatures for f in functions if f.signatures}

frames = example_frames()
closer = LoopCloser.from_preset("indoor")
before = compiled()
for frame, T in zip(*frames, strict=True):
    closer.process(frame, T)
after = compiled()
print(len(closer.map), len(before), {f: s for f, s in after.items() if s != before.get(f)})
"""


def test_no_frame_waits_for_the_compiler():
    """In a process of its own, because other tests compile as well."""
    found = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=240
    )
    n_keyframes, n_compiled, later = found.stdout.split(maxsplit=2)
    assert int(n_keyframes) >= 2
    assert int(n_compiled) >= 15
    assert later.strip() == "{}"
