"""A data set downloaded and unpacked, by the library and by the command."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from archives import CHESS, UNPACKED, tarred, tree, zipped
from typer.testing import CliRunner, Result
from web_server import Server

from slam_bof.cli import app
from slam_bof.datasets import CATALOGUE, find_archives
from slam_bof.datasets.download import download
from slam_bof.errors import DatasetError


def test_a_scene_is_downloaded_once(server: Server, tmp_path: Path) -> None:
    server.files["chess.zip"] = CHESS
    (found,) = download("7scenes", "chess", tmp_path, base_url=f"{server.url}/")
    assert (found.folder, found.was_there) == (tmp_path / "7scenes" / "chess", False)
    sums = f"{hashlib.sha256(CHESS).hexdigest()}  chess.zip\n"
    assert tree(tmp_path / "7scenes") == UNPACKED | {"SHA256SUMS": sums.encode()}
    (again,) = download("7scenes", "chess", tmp_path, base_url=server.url)
    assert again.was_there
    assert len(server.asked) == 1


def test_an_archive_that_has_changed_is_refused(server: Server, tmp_path: Path) -> None:
    """The sum of the first download counts; a damaged one is not recorded."""
    server.files["chess.zip"] = CHESS[:300]
    with pytest.raises(DatasetError, match=r"\.bad"):
        download("7scenes", "chess", tmp_path, base_url=server.url)
    assert not (tmp_path / "7scenes" / "SHA256SUMS").exists()
    server.files["chess.zip"] = CHESS
    (found,) = download("7scenes", "chess", tmp_path, base_url=server.url)
    shutil.rmtree(found.folder)
    server.files["chess.zip"] = other = zipped({"chess/seq-01/frame-000000.depth.png": b"another"})
    with pytest.raises(DatasetError) as caught:
        download("7scenes", "chess", tmp_path, base_url=server.url)
    sums = [hashlib.sha256(data).hexdigest() for data in (other, CHESS)]
    assert "chess.zip: found SHA-256 {}, expected {} as SHA256SUMS has it".format(*sums) in str(
        caught.value
    )
    assert not found.folder.exists()
    (tmp_path / "7scenes" / "SHA256SUMS").write_text("# trusted\n")
    (found,) = download("7scenes", "chess", tmp_path, base_url=server.url)
    assert found.folder.is_dir()
    assert (tmp_path / "7scenes" / "SHA256SUMS").read_text() == (
        f"# trusted\n{sums[0]}  chess.zip\n"
    )


def test_the_archive_is_kept_on_demand_and_used_again(server: Server, tmp_path: Path) -> None:
    server.files["rgbd_dataset_freiburg1_desk.tgz"] = tarred(
        {"rgbd_dataset_freiburg1_desk/depth.txt": b"#"}
    )
    options = {"base_url": server.url, "keep_archive": True}
    (found,) = download("tum", "fr1/desk", tmp_path, **options)
    (found.folder / "depth.txt").unlink()
    found.folder.rmdir()
    (found,) = download("tum", "fr1/desk", tmp_path, **options)
    assert (found.folder / "depth.txt").is_file()
    assert len(server.asked) == 1


def test_a_damaged_archive_is_renamed(server: Server, tmp_path: Path) -> None:
    for bad in (CHESS[:300], zipped({"fire/x": b"1"}), zipped({"../chess/x": b"1"})):
        server.files["chess.zip"] = bad
        with pytest.raises(DatasetError, match=r"; renamed to chess\.zip\.bad"):
            download("7scenes", "chess", tmp_path, base_url=server.url)
        assert [file.name for file in tmp_path.rglob("*")] == ["7scenes", "chess.zip.bad"]
    server.files["chess.zip"] = CHESS
    download("7scenes", "chess", tmp_path, base_url=server.url)
    assert (tmp_path / "7scenes" / "chess" / "seq-02").is_dir()


def test_the_catalogue_has_the_official_places() -> None:
    assert list(CATALOGUE["7scenes"].parts) == [
        "chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs"
    ]  # fmt: skip
    (desk,) = find_archives("tum", "fr1/desk")
    assert desk.url == (
        "https://cvg.cit.tum.de/rgbd/dataset/freiburg1/rgbd_dataset_freiburg1_desk.tgz"
    )
    assert [archive.folder for archive in find_archives("sunrgbd")] == ["SUNRGBD", "SUNRGBDtoolbox"]
    for collection in CATALOGUE.values():
        assert collection.licence
        for archives in collection.parts.values():
            assert all(archive.url.startswith("https://") for archive in archives)


# The command


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_command_shows_the_licence_and_what_to_do_next(server: Server, tmp_path: Path) -> None:
    server.files["chess.zip"] = CHESS
    common = ("download", "7scenes", "chess", "-o", tmp_path, "--base-url", server.url)
    result = run(*common)
    assert result.exit_code == 0, result.output
    assert result.stdout == f"{tmp_path / '7scenes' / 'chess'}\n"
    assert "non-commercial research only" in result.stderr
    assert "Downloading chess.zip (MB): 0/0" in result.stderr
    result = run(*common, "--json", "--quiet")
    assert result.stderr == ""
    assert json.loads(result.stdout) == [
        {"folder": str(tmp_path / "7scenes" / "chess"), "was_there": True}
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["7scene", "chess"], "no data set '7scene' to download; did you mean '7scenes'?"),
        (["7scenes", "chest"], "7scenes: no part 'chest'; did you mean 'chess'?"),
        (["7scenes"], "7scenes: which part? one of: chess, fire, heads"),
        (["tum", "fr1/desk", "fr9/x"], "tum: no part 'fr9/x'"),
    ],
)
def test_the_command_says_what_there_is(arguments: list[str], message: str, tmp_path: Path) -> None:
    result = run("download", *arguments, "-o", tmp_path)
    assert result.exit_code == 1
    assert message in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_without_arguments_the_command_lists_all() -> None:
    assert "fr3/long_office_household" in run("download").stdout
    assert json.loads(run("download", "--json").stdout)["7scenes"][0] == "chess"
