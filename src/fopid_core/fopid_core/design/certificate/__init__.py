"""Certificates: proofs of stability and bounds, for a loop or a whole box of processes, and their checker.

They need python-flint, which is the extra ``certify`` of this package.
"""

from __future__ import annotations

from importlib.util import find_spec

from fopid_core.errors import InputError


def require_ball_arithmetic() -> None:
    """Raise an InputError where python-flint is not installed."""
    if find_spec("flint") is None:
        raise InputError("python-flint is not installed; certificates need it: pip install python-flint")
