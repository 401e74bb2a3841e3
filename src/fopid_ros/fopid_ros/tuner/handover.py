"""What gains must fulfil that ~/tune is to apply: as the controller runs them, and proved where that is asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.specification import TuningRequest, TuningResult


def refusal(wanted: TuningRequest, result: TuningResult, sample_time: float, values: dict[str, Any]) -> str:
    """Why a design is not applied to a controller with this tick [s], whatever tick it was made for; empty if it is."""
    from fopid_core.design.acceptance import rejection_reason
    from fopid_core.design.sampled_loop import running

    if result.controller is not None and sample_time != wanted.sample_time:
        result = replace(result, running=running(wanted.process, result.controller, sample_time, result.filter))
    return rejection_reason(result, sample_time, values["verify.ms_max"], values["verify.ticks"])


def proof(wanted: TuningRequest, result: TuningResult, values: dict[str, Any]) -> tuple[str, str]:
    """The certificate of a design by the node's parameters, or why it is not applied; both empty if none is asked for.

    With ``verify.box`` it is about every process in the box, and about this one, too, with what was asked for.
    """
    box = values["verify.box"].replace(";", " ").split()
    if not (values["verify.certify"] or box):
        return "", ""
    from fopid_core.design.certified_tuning import certificate_or_refusal

    certificate, refused = certificate_or_refusal(wanted, result, values["verify.ms_max"])
    if refused or not box:
        return certificate, refused
    from fopid_core.design.certificate.family_text import read_family, read_sides

    try:
        family = read_family(str(wanted.process), read_sides(box))
    except InputError as error:
        return "", f"not applied: verify.{error}"
    return certificate_or_refusal(wanted, result, values["verify.ms_max"], family, values["timeout"])
