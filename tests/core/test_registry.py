from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from slam_bof.core import registry
from slam_bof.errors import ConfigError, DatasetError, PluginError


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A third party's package with plug-ins, installed beside slam_bof."""
    (tmp_path / "stranger.py").write_text(
        "from slam_bof.types import Params as Base\n"
        "class Plain:\n"
        "    pass\n"
        "class Tuned:\n"
        "    class Params(Base):\n"
        "        gain: float = 1.0\n"
        "    def __init__(self, params):\n"
        "        self.params = params\n"
    )
    (tmp_path / "stranger_needy.py").write_text("import cv9_of_no_one\n")
    info = tmp_path / "stranger-1.2.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.2.3\n")
    (info / "entry_points.txt").write_text(
        "[slam_bof.odometry]\n"
        "plain = stranger:Plain\n"
        "tuned = stranger:Tuned\n"
        "needy = stranger_needy:Odometry\n"
        "gone = stranger:Gone\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    return tmp_path


def test_built_ins_enter_by_entry_points() -> None:
    assert "kiss-icp" in registry.names("odometry")
    assert "7scenes" in registry.names("datasets")
    assert registry.load("backends", "gtsam").__name__ == "GtsamBackend"


def test_a_strangers_plugin_is_listed_and_built(stranger: Path) -> None:
    found = {item.name: item for item in registry.listing() if item.distribution == "stranger"}
    assert sorted(found) == ["gone", "needy", "plain", "tuned"]
    assert found["tuned"].version == "1.2.3"
    assert found["tuned"].target == "stranger:Tuned"
    assert "stranger" not in sys.modules, "listing must import no plug-in"
    assert registry.build("odometry", "tuned", {"gain": 2}).params.gain == 2.0
    assert type(registry.build("odometry", "plain")).__name__ == "Plain"


def test_unknown_name_lists_what_is_installed() -> None:
    with pytest.raises(PluginError, match=r"no backends plug-in 'g3o'; installed: .*gtsam"):
        registry.load("backends", "g3o")


def test_missing_library_names_the_pip_command(stranger: Path) -> None:
    with pytest.raises(
        PluginError, match=r"'needy' needs cv9_of_no_one.*pip install cv9-of-no-one"
    ):
        registry.load("odometry", "needy")


def test_missing_names_the_library_and_imports_nothing(stranger: Path) -> None:
    lacks = {
        i.name: registry.missing(i) for i in registry.listing() if i.distribution == "stranger"
    }
    assert lacks["plain"] == lacks["tuned"] == ""
    assert lacks["needy"].startswith("needs cv9_of_no_one, which is not installed; try: pip ")
    assert "stranger" not in sys.modules
    assert "stranger_needy" not in sys.modules


def test_an_extra_that_brings_the_library_is_named(stranger: Path) -> None:
    metadata = stranger / "stranger-1.2.3.dist-info" / "METADATA"
    extra = 'Provides-Extra: eyes\nRequires-Dist: cv9-of-no-one>=1; extra == "eyes"\n'
    metadata.write_text(metadata.read_text() + extra)
    with pytest.raises(PluginError, match=r'try: pip install "stranger\[eyes\]"$'):
        registry.load("odometry", "needy")


def test_missing_class_is_a_plugin_error(stranger: Path) -> None:
    with pytest.raises(PluginError, match=r"'gone' cannot be loaded: .*Gone"):
        registry.load("odometry", "gone")


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("tuned", {"gian": 1}, "odometry plug-in 'tuned': unknown key 'gian'; did you mean 'gain'"),
        ("tuned", {"gain": "much"}, "key 'gain': found 'much', input should be a valid number"),
        ("plain", {"gain": 1}, "takes no options, found gain"),
    ],
)
def test_wrong_options_name_the_key(
    stranger: Path, name: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        registry.build("odometry", name, options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_port_is_the_programmers_mistake() -> None:
    with pytest.raises(ValueError, match="port must be one of"):
        registry.names("odometries")


def test_only_the_named_plugin_is_imported() -> None:
    code = (
        "import sys; from slam_bof.core import registry; registry.listing();"
        "registry.load('datasets', '7scenes');"
        "found = {'open3d', 'gtsam', 'kiss_icp', 'sklearn'} & set(sys.modules);"
        "assert not found, found"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# Data sets by their content


class Layout:
    """A data set that recognises folders with a file of its name."""

    file = "mine"

    @classmethod
    def recognises(cls, path: Path) -> str | bool:
        return cls.file if (path / cls.file).exists() else ""


class OtherLayout(Layout):
    file = "other"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return (path / cls.file).exists()


@pytest.fixture
def layouts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two data sets in place of those that come along, and one whose library is missing."""
    found = {
        "mine": EntryPoint("mine", f"{__name__}:Layout", "slam_bof.datasets"),
        "other": EntryPoint("other", f"{__name__}:OtherLayout", "slam_bof.datasets"),
        "needy": EntryPoint("needy", "stranger_needy:Dataset", "slam_bof.datasets"),
    }
    monkeypatch.setattr(registry, "_found", lambda port: found if port == "datasets" else {})


def refused(path: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        registry.recognise_dataset(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.usefixtures("stranger", "layouts")
def test_a_layout_is_recognised_and_says_by_what(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "mine").touch()
    assert str(registry.recognise_dataset(folder)) == "recognised as mine: mine"
    (folder / "mine").rename(folder / "other")
    assert str(registry.recognise_dataset(folder)) == "recognised as other: its content"


@pytest.mark.usefixtures("stranger", "layouts")
def test_two_layouts_at_once_are_refused(tmp_path: Path) -> None:
    for name in ("mine", "other"):
        (tmp_path / name).touch()
    assert refused(tmp_path).endswith(
        "found mine (mine) and other (its content), expected one layout; "
        "choose by --dataset mine or other"
    )


@pytest.mark.usefixtures("stranger", "layouts")
def test_an_unknown_layout_is_told_with_what_is_there_and_who_was_not_asked(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    assert "found no known layout, expected one of: mine, needy, other; in it: nothing" in refused(
        folder
    )
    assert "plug-in 'needy' needs cv9_of_no_one, which is not installed" in refused(folder)
    for number in range(12):
        (folder / f"{number:02d}.txt").touch()
    assert "in it: 00.txt, 01.txt, " in refused(folder)
    assert "07.txt, 4 more" in refused(folder)
    (folder / "00").mkdir()
    (folder / "00" / "mine").touch()
    assert f"did you mean {folder / '00'} (mine)?" in refused(folder)
    assert "00.txt: found an empty file, expected the folder of" in refused(folder / "00.txt")
    (folder / "00.txt").write_text("hello")
    assert "00.txt: found a file, expected the folder of a sequence" in refused(folder / "00.txt")
    assert "none: found nothing, expected the folder" in refused(folder / "none")
