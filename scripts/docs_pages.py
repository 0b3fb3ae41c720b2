"""Pages of the documentation that are generated from the code: hooks of MkDocs.

Commands come from the Typer application, parameters from ``Config``, options from the installed
plug-ins, and the Python reference has one page for each room of the package.
"""

from __future__ import annotations

import ast
import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import annotated_types
import griffe
import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pydantic.fields import FieldInfo

import slam_bof
from slam_bof import Config
from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.errors import PluginError
from slam_bof.slam import unit_of
from slam_bof.types import Params

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "slam_bof"
DISTRIBUTION = "slam-bof"
NO_BREAK = "\N{NO-BREAK SPACE}"
NOT_SHOWN = {"cli"}
"""Rooms without a page of the Python reference: the commands have a page of their own."""
PROJECT_PAGES = {"contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}


DOCTEST = re.compile(r"((?:^[ ]*>>> .*\n?)(?:^[ ]*\S.*\n?)*)", flags=re.MULTILINE)
"""Lines of an example up to the next empty one."""


class FencedDoctests(griffe.Extension):
    """Shows the examples in docstrings as code, wherever they stand in them."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Put fences around the examples of a docstring."""
        if obj.docstring and "Examples\n---" not in obj.docstring.value:
            text = re.sub(r"[ ]*# doctest: \+\w+", "", obj.docstring.value)
            obj.docstring.value = DOCTEST.sub(_fenced, text)


def _fenced(match: re.Match[str]) -> str:
    return f"```pycon\n{match[1].rstrip()}\n```\n"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put a page for each room in the place that ``nav`` has for them."""
    for section in config.nav or []:
        for pages in section.values():
            if isinstance(pages, list):
                _fill_nav(pages)
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for name, text in pages().items():
        files.append(File.generated(config, name, content=text))
    return files


def pages() -> dict[str, str]:
    """Return the text of every generated page by its path below ``docs``."""
    texts = {
        "reference/commands.md": commands_page(),
        "reference/parameters.md": parameters_page(),
        "reference/plugin-options.md": plugin_options_page(),
    }
    for room, modules in rooms().items():
        texts[f"reference/python/{room}.md"] = _room_page(room, modules)
    for page, source in PROJECT_PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        texts[f"project/{page}"] = text.replace("](docs/", "](../")
    return texts


def rooms() -> dict[str, list[str]]:
    """Return the modules of each room by the room's name; of a room that is a file, none."""
    found = {"slam_bof": []}
    for path in sorted(PACKAGE.iterdir()):
        if path.suffix == ".py" and not path.stem.startswith("__"):
            found[path.stem] = []
        elif (path / "__init__.py").is_file() and path.name not in NOT_SHOWN:
            files = sorted(path.rglob("*.py"))
            names = (".".join(f.relative_to(path).with_suffix("").parts) for f in files)
            found[path.name] = [n for n in names if "__init__" not in n and "__main__" not in n]
    return found


def commands_page() -> str:
    """Return the page of all commands, their arguments and options."""
    root = typer.main.get_command(app)
    lines = [
        "# Commands",
        "",
        "Generated from the command line itself; `slam-bof COMMAND --help` prints the same.",
        "",
        "Exit code 0 means done, 1 a mistake that you can correct (one line on stderr), 2 wrong "
        "usage, 130 interrupted. Commands that compute take `--json`.",
        "",
    ]
    for name, command in commands(root):
        lines += _command_section(name, command)
    return "\n".join(lines)


def commands(group: Any, prefix: str = "slam-bof") -> Iterator[tuple[str, Any]]:
    """Return each command below a group with its full name; groups themselves are left out."""
    for name, command in group.commands.items():
        full = f"{prefix} {name}"
        if hasattr(command, "commands"):
            yield from commands(command, full)
        else:
            yield full, command


def _command_section(name: str, command: Any) -> list[str]:
    context = command.context_class(command, info_name=name)
    usage = " ".join(command.collect_usage_pieces(context))
    text = (command.help or "").replace("\f", "").strip()
    lines = [f"## {name}", "", text, "", "```text", f"{name} {usage}", "```", ""]
    rows = []
    for param in command.get_params(context):
        record = param.get_help_record(context)
        if record and "--help" not in param.opts:
            rows.append(f"| {_code(record[0])} | {_cell(record[1])} |")
    return [*lines, "| argument or option | meaning |", "|---|---|", *rows, ""] if rows else lines


def parameters_page() -> str:
    """Return the page of every parameter of a configuration."""
    lines = [
        "# Parameters",
        "",
        "Generated from the configuration's own classes: all of what a YAML file or `--set` may "
        "say, with the default of the preset `indoor`. `slam-bof config` prints the same as a "
        "file; what a file leaves out keeps its default, and a key that does not exist is refused.",
        "",
        "```bash",
        "slam-bof config indoor > my.yaml",
        "slam-bof run SEQUENCE --config my.yaml --set loops.top_k=5",
        "```",
        "",
    ]
    lines += _params_sections(Config, Config(), "")
    return "\n".join(lines)


def plugin_options_page() -> str:
    """Return the page of the options of every plug-in that is installed and takes any."""
    lines = [
        "# Plug-in options",
        "",
        "Generated from the installed plug-ins. In a configuration the options of the verifier, "
        "for example, stand below `verifier.options`.",
        "",
    ]
    for port in registry.PORTS:
        lines += [f"## {port}", ""]
        for plugin in registry.listing():
            if plugin.port == port and plugin.distribution == DISTRIBUTION:
                lines += _plugin_section(plugin)
    return "\n".join(lines)


def _plugin_section(plugin: registry.Listing) -> list[str]:
    lines = [f"### {plugin.name}", ""]
    try:
        kind = registry.load(plugin.port, plugin.name)
    except PluginError as error:  # a library that is optional
        return [*lines, f"Its options cannot be shown: {error}.", ""]
    lines += [*(kind.__doc__ or "").strip().splitlines()[:1], ""]
    params = getattr(kind, "Params", None)
    if params is not None and params.model_fields:
        values = params.model_construct()
        lines += [*_table(params, values), *_params_sections(params, values, "", level=4)]
    return lines


def _params_sections(kind: type[Params], values: Any, path: str, level: int = 2) -> list[str]:
    """Return a section for a part of the configuration, and one for each part below it."""
    lines = []
    if path or level == 2:
        title = f"`{path}`" if path else "The top"
        summary = (kind.__doc__ or "").strip().split("\n\n")[0]
        lines += [
            f"{'#' * level} {title}",
            "",
            " ".join(summary.split()),
            "",
            *_table(kind, values),
        ]
    for name in kind.model_fields:
        value = getattr(values, name, None)
        if isinstance(value, Params) and not value.keeps_own_defaults:
            below = f"{path}.{name}" if path else name
            lines += _params_sections(type(value), value, below, level)
    return lines


def _table(kind: type[Params], values: Any) -> list[str]:
    rows = []
    for name, field in kind.model_fields.items():
        value = "" if field.is_required() else getattr(values, name)
        if isinstance(value, Params) and not value.keeps_own_defaults:
            continue
        if isinstance(value, Params):
            value = value.model_dump(mode="json").get("name")
        cells = (
            f"`{name}`",
            f"`{_plain(value)}`" if value != "" else "required",
            unit_of(name),
            allowed(field),
        )
        rows.append(f"| {' | '.join(cells)} | {_cell(field.description or '')} |")
    if not rows:
        return []
    return ["| key | default | unit | allowed | meaning |", "|---|---|---|---|---|", *rows, ""]


def allowed(field: FieldInfo) -> str:
    """Return the range or the choices that a parameter is held to."""
    low = high = ""
    for rule in field.metadata:
        if isinstance(rule, annotated_types.Ge | annotated_types.Gt):
            bound, sign = (rule.ge, "≤") if isinstance(rule, annotated_types.Ge) else (rule.gt, "<")
            low = f"{bound:g} {sign} "
        if isinstance(rule, annotated_types.Le | annotated_types.Lt):
            bound, sign = (rule.le, "≤") if isinstance(rule, annotated_types.Le) else (rule.lt, "<")
            high = f" {sign} {bound:g}"
    choices = getattr(field.annotation, "__args__", ())
    if choices and all(isinstance(choice, str) for choice in choices):
        return " or ".join(f"`{choice}`" for choice in choices)
    return f"{low}x{high}".replace(" ", NO_BREAK) if low or high else ""


def _public_page() -> str:
    """Return the page of the names that ``import slam_bof`` gives."""
    rows = []
    for name in sorted(slam_bof.__all__):
        thing = getattr(slam_bof, name)
        summary = (thing.__doc__ or "").strip().splitlines()[0]
        rows.append(f"| [`{name}`][{thing.__module__}.{name}] | {_cell(summary)} |")
    text = "The public names of the package, imported when they are first asked for."
    return "\n".join(["# slam_bof", "", text, "", "| name | |", "|---|---|", *rows, ""])


def _room_page(room: str, modules: list[str]) -> str:
    if room == "slam_bof":
        return _public_page()
    name = f"slam_bof.{room}"
    lines = [f"# {name}", ""]
    if not modules:
        return "\n".join([*lines, *_members(name, 2)])
    door = ast.get_docstring(ast.parse((PACKAGE / room / "__init__.py").read_text("utf-8")))
    lines += [door or "", ""]
    for module in modules:
        path = f"slam_bof/{room}/{module.replace('.', '/')}.py"
        lines += [f"## {name}.{module}", "", f"`{path}`", "", *_members(f"{name}.{module}", 3)]
    return "\n".join(lines)


def _members(module: str, level: int) -> list[str]:
    options = [f"heading_level: {level}", "show_root_heading: false", "show_root_toc_entry: false"]
    return [f"::: {module}", "    options:", *(f"      {line}" for line in options), ""]


def _fill_nav(pages: list[Any]) -> None:
    for page in pages:
        if isinstance(page, dict) and page.get("Python") == "reference/python":
            page["Python"] = [
                {"slam_bof" if room == "slam_bof" else room: f"reference/python/{room}.md"}
                for room in rooms()
            ]


def _plain(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_plain, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _code(text: str) -> str:
    """Return code for a cell of a table, where a bar would end the cell."""
    return f"<code>{html.escape(' '.join(text.split())).replace('|', '&#124;')}</code>"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
