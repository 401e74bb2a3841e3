"""Runs a line of the command ``fopid`` within this process."""

from __future__ import annotations

import inspect
from collections.abc import Sequence

from click.testing import CliRunner, Result

from fopid_core.cli.main import main

# click 8.1 mixes the two streams unless told otherwise, 8.2 keeps them apart and takes no such word.
_APART = {"mix_stderr": False} if "mix_stderr" in inspect.signature(CliRunner).parameters else {}


def invoke(arguments: Sequence[str], *, catch_exceptions: bool = True) -> Result:
    """What ``fopid`` with these arguments prints, and its status."""
    return CliRunner(**_APART).invoke(main, list(arguments), catch_exceptions=catch_exceptions)
