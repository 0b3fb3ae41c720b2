"""``slam-bof map``: commands that inspect and maintain saved maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam_bof.cli.inputs import map_file
from slam_bof.cli.one_line import one_line
from slam_bof.cli.options import JSON, MAP, finite
from slam_bof.errors import ConfigError, MapError

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="Inspect and maintain saved maps.")

MAX_LINES = 20
FACTS = {
    "file": "File",
    "n_keyframes": "Keyframes",
    "n_loops": "Loops",
    "n_covisibility_edges": "Covisibility edges",
    "n_components": "Map components",
    "n_rooms": "Rooms",
    "bytes": "Size (bytes)",
    "bytes_per_keyframe": "Bytes per keyframe",
    "camera": "Camera",
    "model": "Model",
}
SESSION_COLUMNS = ("session", "data set", "sequence", "frames", "keyframes", "finished")
NEW = Annotated[Path, typer.Option("--out", "-o", help="The new map.db to write.")]


@app.command()
def info(map_: MAP, as_json: JSON = False) -> None:
    """Print the sessions, size and components of a map."""
    from dataclasses import asdict

    from slam_bof.cli.console import print_json, print_table
    from slam_bof.store import MapStore, components_of
    from slam_bof.types import EdgeKind

    path = map_file(map_)
    with MapStore.open(path) as store, store.snapshot():
        keyframes, loops, rooms = store.keyframes(), store.loops(), store.rooms()
        counts = {k: sum(f.session == k for f in keyframes) for k in range(len(store.sessions()))}
        sessions = [
            {
                "session": session.id,
                "dataset": session.dataset,
                "sequence": session.sequence,
                "n_frames": len(store.frames(session.id)),
                "n_keyframes": counts[session.id],
                "is_finished": session.is_finished,
            }
            for session in store.sessions()
        ]
        size = path.stat().st_size
        camera = store.intrinsics()
        facts = {
            "file": str(path),
            "n_keyframes": len(keyframes),
            "n_loops": sum(loop.kind == EdgeKind.LOOP for loop in loops),
            "n_covisibility_edges": sum(loop.kind != EdgeKind.LOOP for loop in loops),
            "n_components": len(set(components_of(store).tolist())),
            "n_rooms": len(rooms),
            "bytes": size,
            "bytes_per_keyframe": round(size / max(len(keyframes), 1)),
            "camera": None if camera is None else asdict(camera),
            "model": store.parameters().get("model"),
        }
    if as_json:
        print_json({**facts, "sessions": sessions})
        return
    print_table(("property", "value"), [(FACTS[key], _text(facts[key])) for key in FACTS])
    if sessions:
        rows = [list(session.values()) for session in sessions]
        print_table(SESSION_COLUMNS, rows, title="Sessions")


@app.command()
def check(map_: MAP, as_json: JSON = False) -> None:
    """Check a map for damage and list it; exit code 1 if there is any."""
    from slam_bof.cli.console import print_json
    from slam_bof.store import check_map

    path = map_file(map_)
    found = check_map(path)
    if as_json:
        print_json(
            {
                "file": str(path),
                "is_whole": not found,
                "damage": [{**damage._asdict(), "text": str(damage)} for damage in found],
            }
        )
    else:
        for damage in found[:MAX_LINES]:
            typer.echo(one_line(str(damage)))
        if len(found) > MAX_LINES:
            typer.echo(f"and {len(found) - MAX_LINES} more; --json prints all")
    if found:
        raise MapError(
            f"{path}: found damage in {len(found)} place{'s' if len(found) > 1 else ''}; "
            "slam-bof map recover copies the intact rows into a new map"
        )
    if not as_json:
        typer.echo(f"{path}: intact")


@app.command()
def prune(
    map_: MAP,
    distance: Annotated[
        float,
        typer.Option(
            min=0.0, callback=finite, metavar="M", help="Drop keyframes this close to an older one"
        ),
    ] = 0.2,
    angle: Annotated[
        float,
        typer.Option(
            min=0.0, callback=finite, metavar="RAD", help="and rotated from it by less than this."
        ),
    ] = 0.2,
    session: Annotated[
        int | None, typer.Option(min=0, help="Drop the keyframes of this session instead.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only print how many.")] = False,
    as_json: JSON = False,
) -> None:
    """Drop keyframes close to an older one, or those of a whole session.

    The poses of the other keyframes do not change.
    """
    from slam_bof.cli.console import print_json
    from slam_bof.store import MapStore, find_redundant_keyframes, prune_map

    def choose(store: MapStore) -> list[int]:
        if session is None:
            return find_redundant_keyframes(store, distance_m=distance, angle_rad=angle)
        if session >= (n := len(store.sessions())):
            raise ConfigError(f"--session: found {session}, expected below {n}")
        return [k.id for k in store.keyframes() if k.session == session]

    path = map_file(map_)
    with MapStore.open(path) as store:
        n_before, n_chosen = len(store.keyframes()), len(choose(store))
    n_dropped = n_chosen if dry_run else prune_map(path, choose)
    answer = {
        "file": str(path),
        "n_keyframes": n_before - n_dropped,
        "n_dropped": n_dropped,
        "bytes": path.stat().st_size,
    }
    if as_json:
        print_json(answer)
    else:
        what = "to drop" if dry_run else "dropped"
        typer.echo(f"{path}: {n_dropped} of {n_before} keyframes {what}")


@app.command()
def recover(map_: MAP, out: NEW, as_json: JSON = False) -> None:
    """Copy the intact rows of a damaged map into a new one."""
    from slam_bof.cli.console import print_json
    from slam_bof.store import recover_map

    found = recover_map(map_file(map_), out)
    if as_json:
        print_json({"file": str(out), **found._asdict()})
    else:
        typer.echo(f"{out}: {found.n_keyframes} keyframes, {found.n_lost} lost")
        if found.is_camera_lost:
            typer.echo("the camera is lost: poses and labels can be used, depth images cannot")


@app.command()
def merge(
    maps: Annotated[
        list[Path], typer.Argument(metavar="MAP...", help="Two or more maps, or folders of runs.")
    ],
    out: NEW,
    as_json: JSON = False,
) -> None:
    """Merge maps into a new one: their keyframes are matched, and loops join them."""
    from slam_bof.cli.console import print_json
    from slam_bof.maps import merge_maps

    if len(maps) < 2:
        raise ConfigError(f"found {len(maps)} map, expected two or more to merge")
    found = merge_maps([map_file(path) for path in maps], out)
    if as_json:
        print_json({"file": str(out), **found._asdict()})
        return
    typer.echo(
        f"{out}: {found.n_sessions} sessions, {found.n_keyframes} keyframes, "
        f"{found.n_loops_across} loops between maps, {found.n_components} "
        f"component{'s' if found.n_components > 1 else ''}"
    )


@app.command()
def finish(map_: MAP, as_json: JSON = False) -> None:
    """Finish an interrupted session from what the map holds, where its data are gone."""
    from slam_bof.cli.console import print_json
    from slam_bof.maps import finish_map
    from slam_bof.store import MapStore

    path = map_file(map_)
    with MapStore.open(path, read_only=False) as store:
        session = finish_map(store)
        n_keyframes = sum(
            session is not None and keyframe.session == session.id for keyframe in store.keyframes()
        )
    if as_json:
        id_ = None if session is None else session.id
        print_json({"file": str(path), "session": id_, "n_keyframes": n_keyframes})
    elif session is None:
        typer.echo(f"{path}: all sessions are finished")
    else:
        typer.echo(f"{path}: finished session {session.id} of {n_keyframes} keyframes")


@app.command()
def vacuum(map_: MAP, as_json: JSON = False) -> None:
    """Rebuild the file of a map without the space of deleted rows."""
    from slam_bof.cli.console import print_json
    from slam_bof.store import MapStore, require_intact

    path = map_file(map_)
    require_intact(path)
    before = path.stat().st_size if path.is_file() else 0
    with MapStore.open(path, read_only=False) as store:
        store.vacuum()
    after = path.stat().st_size
    if as_json:
        print_json({"file": str(path), "bytes_before": before, "bytes": after})
    else:
        typer.echo(f"{path}: {before} -> {after} bytes")


def _text(value: object) -> object:
    if isinstance(value, dict):
        return ", ".join(f"{key} {number:g}" for key, number in value.items())
    return value
