"""Pages of the reference that are read off the code: parameters, messages, commands."""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import entry_points
from pathlib import Path

import click

from fopid_core.cli.main import main as fopid
from fopid_ros.common.managed_node import AUTOSTART
from fopid_ros.common.parameters import Spec
from fopid_ros.controller.parameters import SPECS as CONTROLLER
from fopid_ros.dashboard.node import SPECS as DASHBOARD
from fopid_ros.plant.node import SPECS as PLANT
from fopid_ros.tuner.parameters import SPECS as TUNER

INTERFACES = Path(__file__).parents[1] / "src" / "fopid_msgs"
NODES: dict[str, Sequence[Spec]] = {
    "fopid_controller": (*CONTROLLER, AUTOSTART),
    "fopid_tuner": (*TUNER, AUTOSTART),
    "plant_simulator": (*PLANT, AUTOSTART),
    "dashboard": DASHBOARD,
}
FAR = 1e9
"""Bounds from here on keep numbers computable and say nothing to a reader."""


def write(folder: Path) -> None:
    """Write all pages, each only when it has changed."""
    folder.mkdir(exist_ok=True)
    for name, lines in (("parameters", parameters()), ("messages", messages()), ("commands", commands())):
        path, text = folder / f"{name}.md", "\n".join(lines) + "\n"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def parameters() -> Iterable[str]:
    """Tables of the parameters of every node."""
    yield "# Parameters"
    yield ""
    yield "Read off the tables that the nodes themselves check against. The column *when* says when a parameter may"
    yield "change: `always`, while the node is `unconfigured`, or only at the `start`."
    for node, specs in NODES.items():
        yield from ("", f"## {node}", "", "| parameter | default | allowed | when | meaning |", "| --- " * 5 + "|")
        for spec in specs:
            when = "start" if spec.read_only else "unconfigured" if spec.at_configure else "always"
            cells = (f"`{spec.name}`", _default(spec), _allowed(spec), when, spec.description)
            yield "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _default(spec: Spec) -> str:
    if isinstance(spec.default, bool):
        return f"`{str(spec.default).lower()}`"
    return f"`{spec.default}`" if spec.default != "" else "empty"


def _allowed(spec: Spec) -> str:
    if spec.choices:
        return ", ".join(f"`{choice}`" for choice in spec.choices)
    if isinstance(spec.default, bool):
        return "`true`, `false`"
    if isinstance(spec.default, str):
        return "text"
    low, high = (math.copysign(math.inf, bound) if abs(bound) >= FAR else bound for bound in (spec.low, spec.high))
    if math.isinf(low) and math.isinf(high):
        return "a number"
    if math.isinf(high):
        return f"{low:g} or more"
    return f"{low:g} to {high:g}"


def messages() -> Iterable[str]:
    """The interface definitions; their comments hold the units."""
    yield "# Messages, services, actions"
    yield ""
    yield "The definitions of `fopid_msgs` as they are compiled. Units stand in brackets; angles are in radians."
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        yield from ("", f"## {title}")
        for path in sorted((INTERFACES / kind).iterdir()):
            yield from ("", f"### fopid_msgs/{kind}/{path.stem}", "", "```text", path.read_text().rstrip(), "```")


def commands() -> Iterable[str]:
    """What every command says of itself."""
    yield "# Commands"
    yield ""
    yield "## fopid"
    yield ""
    yield "Every verb takes `--json` and then writes exactly one JSON object to stdout. Exit status: 0 done; 2 bad"
    yield "input, one line on stderr; 3 well-formed but cannot be met."
    yield from _verb(fopid, click.Context(fopid, info_name="fopid"))
    yield from (
        "",
        "## Executables of fopid_ros",
        "",
        "Plain commands in `.venv`; `ros2 run fopid_ros NAME` elsewhere.",
    )
    for entry in sorted(entry_points(group="console_scripts"), key=lambda entry: entry.name):
        if entry.module.startswith("fopid_ros."):
            yield from ("", f"### {entry.name}", "", "```text", _help(entry.name, entry.module), "```")


def _verb(command: click.Command, context: click.Context) -> Iterable[str]:
    yield from ("", f"### {context.command_path}", "", "```text", command.get_help(context).rstrip(), "```")
    for name, inner in sorted(getattr(command, "commands", {}).items()):
        yield from _verb(inner, click.Context(inner, info_name=name, parent=context, max_content_width=100))


def _help(executable: str, module: str) -> str:
    told, before = io.StringIO(), sys.argv
    sys.argv = [executable, "--help"]
    try:
        with contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
            importlib.import_module(module).main()
    finally:
        sys.argv = before
    return told.getvalue().rstrip()
