"""Placeholder until the method is in place."""

from __future__ import annotations

from fopid_core.design.specification import Expired, Progress, Proposal, TuningRequest
from fopid_core.errors import InputError


def propose_rule(request: TuningRequest, progress: Progress, expired: Expired) -> Proposal:
    """Refuse."""
    raise InputError(f"method = {request.method!r}; allowed: frequency")
