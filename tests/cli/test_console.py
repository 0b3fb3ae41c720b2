"""What is printed: foreign text as it is, and tables that can be read on narrow terminals."""

from __future__ import annotations

import re

import pytest
from rich.console import Console

from slam_bof.cli.console import Bar, print_table

PATHS = ["walk [final]", "take[/1", "[red]kitchen", "data/[/1]", ":smile: \\[x]"]
COLUMNS = ("keyframe", "frame", "time s", "scene", "probability", "x m", "y m", "z m", "loops")
ROWS = [(k, 10 * k, 1e3 + k / 3, "living room", 0.987, -12.345, 0.5, 6.789, k) for k in range(3)]


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch):
    """Make stdout and stderr count as a terminal of some width."""

    def of_width(columns: int) -> None:
        for name, value in (("FORCE_COLOR", "1"), ("TERM", "xterm"), ("COLUMNS", str(columns))):
            monkeypatch.setenv(name, value)
        monkeypatch.delenv("NO_COLOR", raising=False)

    return of_width


def plain(text: str) -> list[str]:
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text).splitlines()


@pytest.mark.parametrize("path", PATHS)
def test_text_in_tables_is_printed_as_it_is(path: str, capsys) -> None:
    print_table([path, "value"], [[path, 1.0]], title=path)
    lines = capsys.readouterr().out.splitlines()
    assert [path in line for line in lines] == [True, False, True, False, True, False]


@pytest.mark.parametrize("path", PATHS)
def test_text_of_progress_is_printed_as_it_is(path: str, capsys) -> None:
    with Bar(path) as bar:
        bar.warn(path)
        bar.show(10, 10, path)
    assert capsys.readouterr().err.splitlines() == [f"warning: {path}", f"{path}: 10/10 {path}"]


def test_text_of_others_does_not_control_the_terminal(capsys) -> None:
    foreign = "a\x1b[31m\u202eb"
    print_table([foreign], [[foreign]], title=foreign)
    with Bar(foreign) as bar:
        bar.warn(foreign)
        bar.show(10, 10, foreign)
    out, err = capsys.readouterr()
    for text, n in ((out, 3), (err, 3)):
        assert not re.search("[\x1b\u202e]", text)
        assert text.count(r"a\x1b[31m\u202eb") == n


@pytest.mark.parametrize("path", PATHS)
def test_text_of_a_progress_bar_is_printed_as_it_is(path: str, capsys, terminal) -> None:
    terminal(200)
    with Bar(path, live=False) as bar:
        bar.show(10, 10, path)
    assert any(line.count(path) == 2 for line in plain(capsys.readouterr().err))


@pytest.mark.parametrize("width", [80, 60])
def test_tables_fit_narrow_terminals(width: int, capsys, terminal) -> None:
    terminal(width)
    print_table(COLUMNS, ROWS, title="Keyframes")
    lines = plain(capsys.readouterr().out)
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    for name in COLUMNS:
        assert re.search(rf"(?<!\S){name}(?!\S)", text), "no name is cut or wrapped"
    assert text.count("1000.333") == text.count("living room") // 3 == 1
    heads = [line for line in lines if line.startswith("┃")]
    assert all(line.split()[1] == "keyframe" for line in heads), "rows can be told apart"
    assert len(heads) == 2


def test_a_long_text_is_wrapped_and_nothing_is_lost(capsys, terminal) -> None:
    terminal(60)
    reason = "only 77 % of the image agrees with the map, 95 % are needed to accept the pose"
    print_table(["frame", "why unknown"], [[7, reason]])
    lines = plain(capsys.readouterr().out)
    assert max(map(len, lines)) <= 60
    cells = [line.split("│")[2].strip() for line in lines if line.startswith("│")]
    assert " ".join(cells) == reason


def test_without_a_terminal_tables_are_whole(capsys) -> None:
    print_table(COLUMNS, [(*ROWS[0][:3], "x" * 300, *ROWS[0][4:])])
    lines = capsys.readouterr().out.splitlines()
    assert len({len(line) for line in lines}) == 1
    assert "x" * 300 in lines[3]
    assert Console().is_terminal is False
