"""Tests of reading files whole, of moderate size."""

import os
from pathlib import Path

import pytest

from slam_bof.core import naming, read_bytes, read_text
from slam_bof.core.files import MAX_BYTES, MAX_TEXT_BYTES


def sparse(path: Path, n_bytes: int) -> Path:
    """Make a file of zeros that takes no place on the disk."""
    path.touch()
    os.truncate(path, n_bytes)
    return path


def test_a_file_is_read_whole(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_bytes("\ufeffdépth\r\n".encode())
    assert read_bytes(file) == "\ufeffdépth\r\n".encode()
    assert read_text(file) == "dépth\r\n"
    file.write_bytes(b"\xff")
    assert read_text(file, "replace") == "\ufffd"
    with pytest.raises(UnicodeDecodeError):
        read_text(file)


def test_the_limit_itself_is_read(tmp_path: Path) -> None:
    assert len(read_bytes(sparse(tmp_path / "a", 100), 100)) == 100
    with pytest.raises(OSError, match="more than 99 bytes"):
        read_bytes(tmp_path / "a", 99)


def test_sparse_files_of_terabytes_are_refused(tmp_path: Path) -> None:
    file = sparse(tmp_path / "a", 1 << 40)
    with pytest.raises(OSError, match=f"more than {MAX_BYTES} bytes") as caught:
        read_bytes(file)
    assert caught.value.filename == str(file)
    with pytest.raises(OSError, match=f"more than {MAX_TEXT_BYTES} bytes"):
        read_text(file)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no /dev/zero")
def test_a_device_without_end_is_refused() -> None:
    with pytest.raises(OSError, match="more than 5000 bytes"):
        read_bytes(Path("/dev/zero"), 5000)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_named_pipe_is_refused_at_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    (tmp_path / "link.yaml").symlink_to(pipe)
    for path in (pipe, tmp_path / "link.yaml"):
        with pytest.raises(OSError, match="a named pipe") as caught:
            read_text(path)
        assert caught.value.filename == str(path)


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="no /dev/fd")
def test_a_pipe_is_read() -> None:
    reading, writing = os.pipe()
    os.write(writing, b"seed: 7\n")
    os.close(writing)
    try:
        assert read_text(Path(f"/dev/fd/{reading}")) == "seed: 7\n"
    finally:
        os.close(reading)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_named() -> None:
    with (
        pytest.raises(OSError, match="No space left on device: '/dev/full'"),
        naming(Path("/dev/full")),
        Path("/dev/full").open("w") as file,
    ):
        file.write("x")
