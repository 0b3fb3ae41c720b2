"""Open3D's library, on machines with a libusb and without, in interpreters of their own; BLAS."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from slam_bof.core import native_libraries as native, one_blas_thread, one_native_thread

MAPPED = (
    "import pathlib\n"
    "maps = pathlib.Path('/proc/self/maps').read_text()\n"
    "print(sorted({line.split()[-1] for line in maps.splitlines() if 'libusb' in line}))\n"
)


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_open3d_imports_and_computes() -> None:
    out = python(
        "from slam_bof.core import import_open3d\n"
        "o3d = import_open3d()\n"
        "assert o3d is import_open3d()\n"
        "print(len(o3d.geometry.TriangleMesh.create_box().vertices))"
    )
    assert out == "8"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc/self/maps")
def test_without_a_system_libusb_the_bundled_one_is_loaded_before_open3d() -> None:
    """``find_library`` is made blind, and what the process has mapped tells what was loaded."""
    out = python(
        "import ctypes.util, sys\n"
        "ctypes.util.find_library = lambda name: None\n"
        "loaded = []\n"
        "real = ctypes.CDLL\n"
        "def spy(name, mode=0, *args, **kwargs):\n"
        "    if 'usb' in str(name):\n"
        "        assert 'open3d' not in sys.modules\n"
        "        assert mode == ctypes.RTLD_GLOBAL\n"
        "        loaded.append(name)\n"
        "    return real(name, mode, *args, **kwargs)\n"
        "ctypes.CDLL = spy\n"
        "from slam_bof.core import import_open3d\n"
        "import_open3d()\n"
        "assert len(loaded) == 1, loaded\n" + MAPPED
    )
    assert "libusb_package" in out


@pytest.mark.skipif(
    ctypes.util.find_library("usb-1.0") is None or not sys.platform.startswith("linux"),
    reason="needs a libusb of the system's, and /proc/self/maps",
)
def test_with_a_system_libusb_the_bundled_one_is_left_alone() -> None:
    out = python("from slam_bof.core import import_open3d\nimport_open3d()\n" + MAPPED)
    assert "libusb_package" not in out
    assert "libusb-1.0" in out


def test_open3d_computes_with_one_thread_and_gives_the_cpus_back() -> None:
    python(
        "import os\n"
        "before = os.sched_getaffinity(0) if hasattr(os, 'sched_getaffinity') else None\n"
        "from slam_bof.core import import_open3d\n"
        "import_open3d()\n"
        "after = os.sched_getaffinity(0) if hasattr(os, 'sched_getaffinity') else None\n"
        "assert before == after, (before, after)\n"
    )


def blas_threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_blas_has_one_thread_within_and_what_it_had_before_after() -> None:
    @one_blas_thread()
    def within() -> list[int]:
        return blas_threads()

    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert set(before) == {2}
        assert set(within()) == {1}
        assert blas_threads() == before
        with pytest.raises(KeyError), one_blas_thread():
            raise KeyError
        assert blas_threads() == before


@pytest.mark.parametrize("limits", [(one_blas_thread, one_blas_thread),
                                    (one_native_thread, one_blas_thread),
                                    (one_blas_thread, one_native_thread)])  # fmt: skip
def test_overlapping_limits_of_two_threads_restore_what_they_found(limits) -> None:
    """The first to begin is the first to end, while the second still runs."""
    first_runs, second_runs, first_ended = (threading.Event() for _ in range(3))
    seen = {}

    def first() -> None:
        with limits[0]():
            first_runs.set()
            assert second_runs.wait(60)
        first_ended.set()

    def second() -> None:
        assert first_runs.wait(60)
        with limits[1]():
            second_runs.set()
            assert first_ended.wait(60)
            seen["within"] = blas_threads()

    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        threads = [threading.Thread(target=target) for target in (first, second)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert set(seen["within"]) == {1}
        assert blas_threads() == before
        assert set(before) == {2}


def test_nested_limits_restore_what_they_found() -> None:
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with one_blas_thread():
            with one_native_thread(), one_blas_thread():
                assert set(blas_threads()) == {1}
            assert set(blas_threads()) == {1}
        assert blas_threads() == before


def test_silenced_lets_native_output_go_nowhere_and_python_s_come_back(
    capfd: pytest.CaptureFixture[str],
) -> None:
    libc = ctypes.CDLL(None)
    with native.silenced():
        libc.puts(b"from C")
    os.write(1, b"after\n")
    assert capfd.readouterr().out == "after\n"
