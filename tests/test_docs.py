"""What the documentation shows is there: imports, commands, options, keys, files and links."""

from __future__ import annotations

import ast
import re
import runpy
import shlex
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from conftest import ROOT

from slam_bof import Config, LoopCloser, Step
from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.maps import LocalizedFrame
from slam_bof.places.recogniser import PlaceMatch
from slam_bof.slam import PluginChoice
from slam_bof.types import Params

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\((?!https?:)([^)#]*)(?:#[^)]*)?\)")
KEY = re.compile(r"`((?:--set )?[a-z_]+(?:\.[a-z_0-9]+)+)(?:[:=][^`]*)?`")
FILES = {"loops.csv", "loops.py", "map.db", "map.ply", "map.saved.db"}
"""Look like keys of a configuration."""
GENERATED = ("reference/", "project/")
"""Folders of pages that are made when the site is built, which checks the links to them."""

ANSWERS = {"step": Step, "match": PlaceMatch, "located": LocalizedFrame}
"""What the variables of these names are in the examples."""


def blocks(language: str) -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        for found, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            if found == language:
                yield page, text


def commands() -> Iterator[tuple[Path, list[str]]]:
    """Each line of a shell block that calls slam-bof, as words without comments."""
    for page, text in blocks("bash"):
        for line in text.splitlines():
            for part in line.split("&&"):
                words = shlex.split(part, comments=True)
                if words[:1] == ["slam-bof"]:
                    yield page, words[1:]


def test_there_is_something_to_check() -> None:
    assert len(list(blocks("python"))) >= 8
    assert len(list(commands())) >= 40


def test_every_import_that_is_shown_works() -> None:
    missing = []
    for page, text in blocks("python"):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    import_module(alias.name)
            elif isinstance(node, ast.ImportFrom):
                module = import_module(str(node.module))
                missing += [
                    f"{page.name}: {node.module}.{alias.name}"
                    for alias in node.names
                    if not hasattr(module, alias.name) and not _is_module(node.module, alias.name)
                ]
    assert missing == []


def _is_module(package: str | None, name: str) -> bool:
    try:
        import_module(f"{package}.{name}")
    except ModuleNotFoundError:
        return False
    return True


def test_every_command_and_option_that_is_shown_exists() -> None:
    root: Any = typer.main.get_command(app)
    for page, words in commands():
        command, rest = root, words
        while rest and hasattr(command, "commands"):
            assert rest[0] in command.commands, f"{page.name}: slam-bof {' '.join(words)}"
            command, rest = command.commands[rest[0]], rest[1:]
        known = {option for param in command.params for option in param.opts} | {"--help"}
        known |= {option for param in command.params for option in param.secondary_opts}
        options = [word for word in rest if re.match(r"--?[a-z]", word)]
        assert set(options) <= known, f"{page.name}: slam-bof {' '.join(words)}"


def test_every_parameter_that_is_named_exists() -> None:
    keys = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found = {key.removeprefix("--set ") for key in KEY.findall(text)}
        found |= set(re.findall(r"--set \"?([a-z_.]+)=", text))
        found = {key for key in found if key.split(".")[0] in Config.model_fields}
        keys |= {(page.name, key) for key in found - FILES}
    assert len(keys) > 20
    assert [(page, key) for page, key in sorted(keys) if not _is_key(key)] == []


def _is_key(key: str) -> bool:
    """Return whether a configuration has the key; options of plug-ins are the plug-ins' own."""
    part: Any = Config()
    for name in key.split("."):
        if isinstance(part, PluginChoice) and name in ("name", "options"):
            return True
        if not isinstance(part, Params) or name not in type(part).model_fields:
            return False
        part = getattr(part, name)
    return True


def test_the_search_for_keys_sees_a_wrong_one() -> None:
    assert KEY.findall("`labels.stay_m: 3`, `--set loops.by=bags`") == [
        "labels.stay_m",
        "--set loops.by",
    ]
    assert _is_key("dataset.options.topic")
    assert not _is_key("loops.no_such")
    assert not _is_key("labels.stay_m.deeper")


def test_every_relative_link_leads_to_a_file() -> None:
    broken = []
    for page in PAGES:
        for target in LINK.findall(page.read_text(encoding="utf-8")):
            path = (page.parent / target).resolve() if target else page
            inside = path.relative_to(ROOT / "docs") if path.is_relative_to(ROOT / "docs") else None
            made = inside is not None and inside.as_posix().startswith(GENERATED)
            if not (path.is_file() or made):
                broken.append(f"{page.name}: {target}")
    assert broken == []


def test_every_file_of_the_project_that_is_named_exists() -> None:
    pattern = re.compile(
        r"(?<![\w/.])((?:slam_bof|slam_bof_plugins|scripts|tests)/[\w/]+(?:\.\w+)?)"
    )
    missing = []
    for page in PAGES:
        for name in set(pattern.findall(page.read_text(encoding="utf-8"))):
            path = ROOT / ("plugins" if name.startswith("slam_bof_plugins") else "") / name
            if not path.exists():
                missing.append(f"{page.name}: {name}")
    assert missing == []


def test_every_included_plugin_is_listed() -> None:
    page = (ROOT / "docs/how-to/plugins.md").read_text(encoding="utf-8")
    rows = {line.split("|")[1].strip(" `"): line for line in page.splitlines() if "| `" in line}
    for item in registry.listing():
        if item.distribution == "slam-bof":
            assert f"`{item.name}`" in rows[item.port], f"{item.port}: {item.name}"


def test_the_readme_is_short_and_its_picture_small() -> None:
    assert (ROOT / "README.md").read_text(encoding="utf-8").count("\n") <= 110
    for picture in (ROOT / "docs").rglob("*.svg"):
        assert picture.stat().st_size < 200_000, picture.name


def test_a_package_index_shows_no_relative_link() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert LINK.search(text)
    for rule in project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    assert LINK.findall(text) == []
    assert "Benchmarks (`docs/benchmarks.md`)" in text
    assert "doi.org/10.3390/s23218836)" in text


def test_the_generated_pages_have_every_command_and_every_parameter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    pytest.importorskip("griffe", reason="needs the extra docs")
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "scripts")])
    docs_pages: Any = import_module("docs_pages")
    page = docs_pages.commands_page()
    for name, _ in docs_pages.commands(typer.main.get_command(app)):
        assert f"\n## {name}\n" in page
    page = docs_pages.parameters_page()
    for path, name in _leaves(Config(), ""):
        section = page.split(f"\n## `{path}`\n" if path else "\n## The top\n")[1].split("\n## ")[0]
        assert f"\n| `{name}` |" in section, f"{path}.{name}"
    assert "| `distance_m` | `0.12` | m | 0 < x |" in page.replace("\N{NO-BREAK SPACE}", " ")


def _leaves(part: Params, path: str) -> Iterator[tuple[str, str]]:
    for name in type(part).model_fields:
        value = getattr(part, name)
        if isinstance(value, Params) and not isinstance(value, PluginChoice):
            yield from _leaves(value, f"{path}.{name}".lstrip("."))
        else:
            yield path, name


def test_every_attribute_that_is_shown_of_a_closer_and_its_answers_exists() -> None:
    closer = LoopCloser.from_preset("indoor")
    shown, missing = set(), []
    for page, text in blocks("python"):
        for node in ast.walk(ast.parse(text)):
            chain = ast.unparse(node) if isinstance(node, ast.Attribute) else ""
            start, *names = chain.split(".")
            if "(" in chain or start not in ("closer", *ANSWERS):
                continue
            shown.add(chain)
            if start == "closer" and not _has(closer, names):
                missing.append(f"{page.name}: {chain}")
            if start in ANSWERS and names[0] not in {f.name for f in fields(ANSWERS[start])}:
                missing.append(f"{page.name}: {chain}")
    assert {"closer.map.components", "step.T_map_odom", "match.inlier_ratio"} <= shown
    assert missing == []


def _has(thing: Any, names: list[str]) -> bool:
    for name in names:
        if not hasattr(thing, name):
            return False
        thing = getattr(thing, name)
    return True


def test_the_picture_of_a_run_that_is_none_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["x", str(tmp_path), "--out", str(tmp_path / "x.svg")])
    script = runpy.run_path(str(ROOT / "scripts" / "make_readme_picture"))
    assert script["main"]() == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1


def test_walls_are_strokes_over_neighbouring_cells() -> None:
    script = runpy.run_path(str(ROOT / "scripts" / "make_readme_picture"))
    cells = np.array([[2, 0], [0, 0], [1, 0], [5, 0], [1, 1]])
    size = script["CELL_M"] * script["PX_PER_M"]
    path = script["wall_path"](cells, np.zeros(2))
    lengths = [float(part.split("h")[1]) / size for part in path.split("M")[1:]]
    assert np.round(lengths).tolist() == [3, 1, 1]
