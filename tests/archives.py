"""Archives as data sets come in, and what is in them."""

from __future__ import annotations

import io
import stat
import tarfile
import zipfile
from pathlib import Path


def zipped(files: dict[str, bytes], *, link: str = "") -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in files.items():
            packed.writestr(name, content)
        if link:
            entry = zipfile.ZipInfo(link)
            entry.external_attr = (stat.S_IFLNK | 0o777) << 16
            packed.writestr(entry, "/etc/passwd")
    return data.getvalue()


def tarred(files: dict[str, bytes], *, link: bytes = b"", name: str = "link") -> bytes:
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w:gz") as packed:
        for path, content in files.items():
            entry = tarfile.TarInfo(path)
            entry.size = len(content)
            packed.addfile(entry, io.BytesIO(content))
        if link:
            entry = tarfile.TarInfo(name)
            entry.type = link
            entry.linkname = "../../outside"
            packed.addfile(entry)
    return data.getvalue()


CHESS = zipped(
    {
        "chess/TrainSplit.txt": b"sequence1\n",
        "chess/seq-01.zip": zipped(
            {"seq-01/frame-000000.depth.png": b"depth", "seq-01/frame-000000.pose.txt": b"pose"}
        ),
        "chess/seq-02.zip": zipped({"seq-02/frame-000000.depth.png": b"other"}),
    }
)


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


UNPACKED = {
    "chess/TrainSplit.txt": b"sequence1\n",
    "chess/seq-01/frame-000000.depth.png": b"depth",
    "chess/seq-01/frame-000000.pose.txt": b"pose",
    "chess/seq-02/frame-000000.depth.png": b"other",
}
