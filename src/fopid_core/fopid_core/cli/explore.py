"""The verb ``fopid explore``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from fopid_core.cli.options import ARGUMENTS

TOKEN_VARIABLE = "FOPID_EXPLORE_TOKEN"
DEFAULT_PORT = 8078


@click.command("explore", context_settings=ARGUMENTS)
@click.argument("source", metavar="[PROCESS|RECORD.csv|BAG]", default="P1")
@click.option("--port", type=int, default=DEFAULT_PORT, show_default=True, metavar="N", help="0 chooses a free one.")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
def explore_verb(source: str, port: int, no_browser: bool) -> None:
    """A page of this machine: move a slider, see what would happen; begin with a process or a record."""
    import asyncio

    from fopid_core.study.explore.server import Desk, serve
    from fopid_core.study.page.access import Access, chosen_token
    from fopid_core.study.page.listening import listening_sockets, page_address

    given = os.environ.get(TOKEN_VARIABLE)
    token = chosen_token(given, TOKEN_VARIABLE)
    start = _start(source)
    sockets = listening_sockets("127.0.0.1", port)
    where = sockets[0].getsockname()[1]
    click.echo(f"explore  {page_address('127.0.0.1', where, None if given else token)}")
    if given:
        click.echo(f"add #token= and what {TOKEN_VARIABLE} holds")
    if not no_browser:
        click.launch(page_address("127.0.0.1", where, token))
    asyncio.run(serve(Desk(start), Access(token), sockets))


def _start(source: str) -> dict[str, Any]:
    """What the page begins with."""
    from fopid_core.errors import InputError
    from fopid_core.model.process import read_process

    is_there = os.access(source, os.F_OK)  # Path.exists raises for a text that is too long for a name
    if Path(source).suffix.lower() in (".csv", ".mcap", ".db3") and not is_there:
        raise InputError(f"record {source!r}: no such file; allowed: a process, or a csv file or bag that is there")
    if is_there and Path(source).suffix.lower() not in (".yaml", ".yml"):
        from fopid_core.study.explore.learning import learnt
        from fopid_core.study.records import read_record

        found = learnt(read_record(source), Path(source).name)
        return {"process": found["best"]["process"] if found["best"] else "P1", "learnt": found}
    return {"process": source if source in ("P1", "P2", "P3", "P4") else str(read_process(source))}
