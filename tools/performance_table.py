"""Write measured figures into a page, between its two marks: performance_table.py CORE ROS BROWSER PAGE."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- begin: figures -->", "<!-- end: figures -->"


def rows(core: dict[str, Any], *more: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """Figure, value, baseline, ratio: what the commands have measured."""
    found = []
    for one in core["figures"]:
        known = one["baseline"] is not None
        value = f"{one['value']:.3g} {one['unit']}" + (f"; {one['note']}" if one["note"] else "")
        baseline = f"{one['baseline_name']}: {one['baseline']:.3g} {one['unit']}" if known else ""
        found.append((one["name"], value, baseline, f"{1 / one['ratio']:.3g}" if known and one["ratio"] else ""))
    return found + [
        (one["figure"], one["value"], one["baseline"], one["ratio"]) for part in more for one in part["figures"]
    ]


def table(core: dict[str, Any], ros: dict[str, Any], browser: dict[str, Any]) -> str:
    """The figures as a table in Markdown; a ratio is the figure over its baseline."""
    lines = ["| figure | value | baseline | ratio |", "| --- | --- | --- | --- |"]
    lines += ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows(core, ros, browser)]
    return "\n".join([f"Measured on {ros['machine']}.", "", *lines])


def main() -> None:
    """Read the figures, write the page."""
    core, ros, browser, page = (Path(argument) for argument in sys.argv[1:])
    before, rest = page.read_text().split(BEGIN)
    after = rest.split(END)[1]
    new = table(*(json.loads(part.read_text()) for part in (core, ros, browser)))
    page.write_text(f"{before}{BEGIN}\n{new}\n{END}{after}")


if __name__ == "__main__":
    main()
