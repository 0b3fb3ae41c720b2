"""The atlas as an index: many maps, added, replaced, removed, read meanwhile, and damaged."""

import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from constellations import seen_again, view

from slam_bof.atlas import Atlas, DescribedKeyframes, atlas as atlas_module
from slam_bof.bof import Constellation, ConstellationIndex, PlacedBofs
from slam_bof.errors import AtlasError

LEVEL = np.eye(3, dtype=np.float32)


def keyframes(first, n):
    """Keyframes whose views are those of seeds from ``first`` on; ids 0, 2, 4 ..."""
    views = [view(seed) for seed in range(first, first + n)]
    return DescribedKeyframes(
        np.arange(0, 2 * n, 2, dtype=np.int32),
        ConstellationIndex.of(
            PlacedBofs(*map(np.concatenate, zip(*views, strict=True))),
            np.array([len(bofs.slices) for bofs in views]),
        ),
        np.tile(LEVEL, (n, 1, 1)),
    )


def best(atlas, seed, yaw=0.2, shift=0.3 - 0.1j):
    """The best match of a view seen again from elsewhere."""
    (match,) = atlas.search(Constellation(seen_again(view(seed), yaw, shift), np.eye(3)), 1)
    return match


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An atlas of 12 maps of 10 keyframes each; the view of seed s is keyframe s of them all."""
    path = tmp_path_factory.mktemp("atlas") / "fleet"
    for k in range(12):
        Atlas.add_described(path, [(f"/maps/{k}", keyframes(10 * k, 10))])
    return path


@pytest.fixture
def folder(made, tmp_path):
    """A copy of that atlas."""
    return shutil.copytree(made, tmp_path / "fleet")


def test_a_view_is_found_with_its_map_keyframe_and_pose(folder):
    atlas = Atlas.open(folder)
    assert len(atlas) == 120
    for seed in (0, 37, 63, 119):
        match = best(atlas, seed)
        assert (match.map.path, match.keyframe_id) == (f"/maps/{seed // 10}", 2 * (seed % 10))
        # Contours went by yaw and shift from the match to the query: the inverse is T_match_query.
        T = match.T_match_query
        assert np.arctan2(T[2, 0], T[0, 0]) == pytest.approx(-0.2, abs=0.05)
        shift = -(0.3 - 0.1j) * np.exp(-0.2j)
        assert T[0, 3] == pytest.approx(shift.real, abs=0.06)
        assert T[2, 3] == pytest.approx(shift.imag, abs=0.06)


def test_maps_are_merged_into_few_segments(folder):
    manifest = json.loads((folder / "atlas.json").read_text())
    sizes = [sum(n for _, n in segment["maps"]) for segment in manifest["segments"]]
    assert sum(sizes) == 120
    assert len(sizes) <= 3
    assert all(a >= 4 * b for a, b in pairwise(sizes))
    assert {path.name for path in folder.glob("segment-*")} == {
        segment["name"] for segment in manifest["segments"]
    }


def test_a_map_that_is_removed_is_not_found(folder):
    before = Atlas.open(folder)
    (gone,) = Atlas.remove(folder, ["/maps/3"])
    assert (gone.path, gone.n_keyframes) == ("/maps/3", 10)
    atlas = Atlas.open(folder)
    assert len(atlas) == 110
    assert best(atlas, 35).map.path != "/maps/3"
    assert best(atlas, 45).map.path == "/maps/4"
    assert best(before, 35).map.path == "/maps/3"  # a reader goes on with what it has opened
    with pytest.raises(AtlasError, match=r"found no map /maps/3, expected one that slam-bof atlas"):
        Atlas.remove(folder, ["/maps/4", "/maps/3"])
    assert len(Atlas.open(folder)) == 110


def test_what_is_removed_leaves_the_disk_in_the_end(folder):
    size = sum(path.stat().st_size for path in folder.rglob("*.npy"))
    Atlas.remove(folder, [f"/maps/{k}" for k in range(8)])
    assert sum(path.stat().st_size for path in folder.rglob("*.npy")) < size / 2
    assert best(Atlas.open(folder), 95).map.path == "/maps/9"
    Atlas.remove(folder, [f"/maps/{k}" for k in range(8, 12)])
    atlas = Atlas.open(folder)
    assert (len(atlas), atlas.maps) == (0, ())
    assert atlas.search(Constellation(view(0), np.eye(3)), 5) == []


def test_a_map_that_is_added_again_replaces_itself(folder):
    Atlas.add_described(folder, [("/maps/5", keyframes(900, 4))])
    atlas = Atlas.open(folder)
    assert len(atlas) == 114
    assert best(atlas, 902).map.path == "/maps/5"
    assert best(atlas, 55).map.path != "/maps/5"
    assert len({entry.id for entry in atlas.maps}) == len(atlas.maps) == 12


@pytest.mark.parametrize("step", ["save_segment", "write_manifest"])
def test_a_writer_that_fails_leaves_the_atlas_as_it_was(folder, monkeypatch, step):
    def fail(*_):
        raise OSError("disk full")

    with monkeypatch.context() as patched:
        patched.setattr(atlas_module, step, fail)
        with pytest.raises(OSError, match="disk full"):
            Atlas.add_described(folder, [("/maps/new", keyframes(500, 3))])
    assert len(Atlas.open(folder)) == 120
    Atlas.add_described(folder, [("/maps/new", keyframes(500, 3))])  # the lock is free
    assert best(Atlas.open(folder), 501).map.path == "/maps/new"


KILLED = """
import os, sys
sys.path[:0] = {path!r}
from test_atlas import Atlas, atlas_module, keyframes
def die(*_):
    os.kill(os.getpid(), 9)
atlas_module.write_manifest = die
Atlas.add_described({folder!r}, [("/maps/new", keyframes(500, 30))])
"""


def test_a_writer_that_is_killed_leaves_the_atlas_as_it_was(folder):
    program = KILLED.format(path=[*sys.path, str(Path(__file__).parent)], folder=str(folder))
    done = subprocess.run([sys.executable, "-c", program], check=False, cwd=os.getcwd())
    assert done.returncode == -9
    assert best(Atlas.open(folder), 37).map.path == "/maps/3"
    Atlas.add_described(folder, [("/maps/new", keyframes(500, 3))])
    assert best(Atlas.open(folder), 501).map.path == "/maps/new"
    named = {s["name"] for s in json.loads((folder / "atlas.json").read_text())["segments"]}
    assert {path.name for path in folder.glob("segment-*")} == named  # nothing is left over


def test_a_reader_that_comes_while_segments_are_merged_reads_again(folder, monkeypatch):
    read, seen = atlas_module.read_manifest, []

    def read_slowly(path):
        manifest = read(path)
        if not seen:
            seen.append(manifest)
            with monkeypatch.context() as patched:
                patched.setattr(atlas_module, "read_manifest", read)
                Atlas.add_described(folder, [("/maps/big", keyframes(300, 60))])
        return manifest

    monkeypatch.setattr(atlas_module, "read_manifest", read_slowly)
    assert len(Atlas.open(folder)) == 180


def test_one_program_writes_at_a_time(folder):
    with atlas_module._writing(folder), pytest.raises(AtlasError, match="another program"):
        Atlas.remove(folder, ["/maps/0"])
    assert len(Atlas.remove(folder, ["/maps/0"])) == 1


def forget_files(folder):
    """Leave the atlas without one file of each segment."""
    for path in folder.glob("segment-*/starts.npy"):
        path.unlink()


def lose_directions(folder):
    """Exchange the directions of gravity of all keyframes for infinity."""
    for path in folder.glob("segment-*/R_level_camera.npy"):
        np.save(path, np.full_like(np.load(path), np.inf))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (forget_files, r"starts\.npy: found no such file, expected one that atlas\.json names"),
        (lose_directions, "fleet: found keyframes that are damaged .*finite number"),
    ],
)
def test_a_writer_names_damage_in_one_line_and_changes_nothing(folder, damage, message):
    damage(folder)
    before = (folder / "atlas.json").read_bytes()
    for call in (
        lambda: Atlas.add_described(folder, [("/maps/new", keyframes(500, 30))]),
        lambda: Atlas.remove(folder, [f"/maps/{k}" for k in range(8)]),
    ):
        with pytest.raises(AtlasError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)
    assert (folder / "atlas.json").read_bytes() == before


def test_more_than_a_million_segments_can_be_made(folder):
    manifest = json.loads((folder / "atlas.json").read_text())
    manifest["n_segments_made"] = 10**6
    (folder / "atlas.json").write_text(json.dumps(manifest))
    Atlas.add_described(folder, [("/maps/new", keyframes(500, 3))])
    assert best(Atlas.open(folder), 501).map.path == "/maps/new"
    assert (folder / "segment-1000000").is_dir()


def damage_manifest(folder):
    (folder / "atlas.json").write_text('{"version": 1, "mapz": []}')


def damage_numbers(folder):
    text = (folder / "atlas.json").read_text()
    (folder / "atlas.json").write_text(text.replace('"n_keyframes": 10', '"n_keyframes": -10'))


def damage_name(folder):
    text = (folder / "atlas.json").read_text()
    (folder / "atlas.json").write_text(text.replace("segment-", "../segment-"))


def cut(folder):
    path = next(folder.glob("segment-*")) / "rows.npy"
    path.write_bytes(path.read_bytes()[:-32])


def drop(folder):
    (next(folder.glob("segment-*")) / "keys.npy").unlink()


def of_another_type(folder):
    path = next(folder.glob("segment-*")) / "views.npy"
    np.save(path, np.load(path).astype(np.int64))


def of_another_length(folder):
    path = next(folder.glob("segment-*")) / "views.npy"
    np.save(path, np.load(path)[:-1])


def replace_by_pipe(path):
    path.unlink()
    os.mkfifo(path)


def pipe_as_manifest(folder):
    replace_by_pipe(folder / "atlas.json")


def pipe_as_column(folder):
    replace_by_pipe(next(folder.glob("segment-*")) / "keys.npy")


def out_of_range(folder):
    path = next(folder.glob("segment-*")) / "starts.npy"
    starts = np.load(path)
    starts[3] = 10**9
    np.save(path, starts)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_manifest, r"atlas\.json: unknown key 'mapz'; did you mean 'maps'"),
        (damage_numbers, r"atlas\.json: key 'maps\.0\.n_keyframes': found -10"),
        (damage_name, r"atlas\.json: key 'segments\.0\.name'"),
        (cut, r"rows\.npy: found \d+ bytes, expected an array"),
        (drop, r"keys\.npy: found no such file, expected one that atlas\.json names"),
        (of_another_type, r"views\.npy: found an array \(\d+,\) of int64, expected int32"),
        (of_another_length, r"found columns of other lengths, expected \d+ keyframes"),
        (out_of_range, r"found columns of other lengths"),
        (pipe_as_manifest, r"atlas\.json: cannot be read: a named pipe"),
        (pipe_as_column, r"keys\.npy: cannot be read: a named pipe"),
    ],
)
def test_damage_is_named_in_one_line(folder, damage, message):
    damage(folder)
    with pytest.raises(AtlasError, match=message) as caught:
        Atlas.open(folder)
    assert "\n" not in str(caught.value)


def test_damage_inside_a_file_is_an_error_of_the_atlas(folder):
    path = max(folder.glob("segment-*"), key=lambda f: (f / "views.npy").stat().st_size)
    views = np.load(path / "views.npy")
    views[:] = 10**8
    np.save(path / "views.npy", views)
    with pytest.raises(AtlasError, match="found keyframes that are damaged"):
        best(Atlas.open(folder), 5)


def test_what_is_no_atlas_is_left_alone(tmp_path):
    (tmp_path / "photos").mkdir()
    for call in (
        lambda: Atlas.open(tmp_path / "photos"),
        lambda: Atlas.open(tmp_path / "none"),
        lambda: Atlas.add_described(tmp_path / "photos", [("/maps/0", keyframes(0, 2))]),
        lambda: Atlas.remove(tmp_path / "photos", ["/maps/0"]),
    ):
        with pytest.raises(AtlasError, match=r"found no atlas, expected a folder with atlas\.json"):
            call()
    assert list((tmp_path / "photos").iterdir()) == []


def test_more_votes_are_counted_where_params_say_so(folder):
    from slam_bof.atlas import AtlasParams

    query = Constellation(view(5), np.eye(3))
    (best,) = Atlas.open(folder).search(query, 1)
    by_few_votes = Atlas.open(folder, AtlasParams(max_votes=1)).search(query, 1)
    assert best.score > 2 * max([match.score for match in by_few_votes], default=0.0)
    one = Atlas.open(folder, AtlasParams(n_compared=1))
    assert len(one.search(query, 10)) == 1
