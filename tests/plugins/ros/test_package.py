"""The files of the ROS package agree with its code; ROS is not needed."""

import ast
import re
import runpy
import sys
import tomllib
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml
from conftest import ROOT

from slam_bof.errors import ConfigError
from slam_bof_ros.parameters import PARAMETERS, check_parameter

PACKAGE = ROOT / "plugins" / "slam_bof_ros"
SOURCES = {path.name: ast.parse(path.read_text()) for path in PACKAGE.glob("slam_bof_ros/*.py")}
LAUNCH = PACKAGE / "launch" / "slam_bof.launch.py"
OF_PYTHON = {"slam_bof", "slam_bof_plugins", "slam_bof_ros", "numpy", "builtin_interfaces"}
"""Not named in package.xml: what pip installs, and what every message package brings along."""


def imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.partition(".")[0]


def test_package_xml_names_all_that_is_imported():
    xml = ElementTree.parse(PACKAGE / "package.xml").getroot()
    depends = {item.text for item in xml.findall("exec_depend")}
    trees = [*SOURCES.values(), ast.parse(LAUNCH.read_text())]
    found = {name for tree in trees for name in imported(tree)}
    standard = {name for name in found if name in __import__("sys").stdlib_module_names}
    assert found - standard - OF_PYTHON - {"ament_index_python"} == depends
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert xml.findtext("version") == project["version"]
    assert xml.findtext("export/build_type") == "ament_python"


def test_the_file_of_parameters_lists_them_all_with_their_defaults():
    written = yaml.safe_load((PACKAGE / "config" / "slam_bof.yaml").read_text())
    assert written["/**"]["ros__parameters"] == PARAMETERS


class Called:
    """Stands for a class of ROS's launch system; keeps the arguments that it is called with."""

    def __init__(self, *args, **options):
        self.args, self.options = args, options


@pytest.fixture
def launched(monkeypatch):
    """What the launch file returns, where ROS's launch system is not installed."""
    for name, members in {
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(PACKAGE)},
        "launch": {"LaunchDescription": Called},
        "launch.actions": {"DeclareLaunchArgument": type("DeclareLaunchArgument", (Called,), {})},
        "launch.substitutions": {"LaunchConfiguration": type("Configuration", (Called,), {})},
        "launch_ros": {},
        "launch_ros.actions": {"Node": type("Node", (Called,), {})},
    }.items():
        module = types.ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    (actions,) = runpy.run_path(str(LAUNCH))["generate_launch_description"]().args
    *declared, node = actions
    return {item.args[0]: item.options["default_value"] for item in declared}, node.options


def test_the_launch_file_starts_the_node_with_what_it_knows(launched):
    declared, node = launched
    (script,) = re.findall(r'console_scripts": \["(\w+) = ', (PACKAGE / "setup.py").read_text())
    name = ElementTree.parse(PACKAGE / "package.xml").getroot().findtext("name")
    assert (node["package"], node["executable"]) == (name, script)
    file, changed = node["parameters"]
    assert set(changed) <= set(PARAMETERS)
    assert Path(declared["parameters"]).is_file()
    source = (PACKAGE / "slam_bof_ros" / "node.py").read_text()
    suffix = re.search(r'suffix = "(/\w+)"', source).group(1)
    topics = {topic for _, topic in re.findall(r'_hear\((\w+), f?"([\w/]+)', source)}
    assert {topic for topic, _ in node["remappings"]} == topics | {f"depth/image_rect_raw{suffix}"}
    parts = [*changed.values(), file]
    for _, target in node["remappings"]:
        parts += target if isinstance(target, list) else [target]
    used = {part.args[0] for part in parts if isinstance(part, Called)}
    assert used == set(declared)


@pytest.mark.parametrize(
    ("name", "value"), [("mode", "localisation"), ("input", "image"), ("tf_rate", 0.0)]
)
def test_a_parameter_that_is_none_is_refused_with_its_name(name, value):
    check_parameter(name, PARAMETERS[name])
    with pytest.raises(ConfigError, match=f"parameter {name}: found"):
        check_parameter(name, value)


def test_rviz_shows_topics_that_the_node_publishes():
    shown = yaml.safe_load((PACKAGE / "rviz" / "slam_bof.rviz").read_text())
    displays = shown["Visualization Manager"]["Displays"]
    topics = {item["Topic"]["Value"] for item in displays if "Topic" in item}
    published = set(re.findall(r'"~/(\w+)"', (PACKAGE / "slam_bof_ros" / "node.py").read_text()))
    assert topics <= {f"/slam_bof/{name}" for name in published}
    assert len(topics) >= 5
