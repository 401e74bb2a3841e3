"""One report from a process or a record: the fit, controllers of several structures, their gains in several forms."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from fopid_core import notebook
from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.pid_forms import series_form, standard_form
from fopid_core.model.process import Process
from fopid_core.model.response import step_response

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRUCTURES = ("pi", "pid", "fopid")
_MINUTE = 60.0


@dataclass(frozen=True)
class StructureDesign:
    """A controller of one structure.

    Attributes
    ----------
    structure : str
    result : TuningResult
    """

    structure: str
    result: TuningResult

    @property
    def forms(self) -> dict[str, dict[str, Any]]:
        """The gains in parallel, standard and series form; a form that does not exist has its reason."""
        return {} if self.result.controller is None else gain_forms(self.result.controller)


def gain_forms(controller: Fopid) -> dict[str, dict[str, Any]]:
    """The gains in parallel, standard and series form; a form that does not exist has its reason.

    Examples
    --------
    >>> gain_forms(Fopid(kp=2.0, ki=0.5, kd=1.0))["standard"]["Ti_s"]
    4.0
    >>> gain_forms(Fopid(kp=2.0, ki=0.5, kd=1.0, mu=0.9))["series"]
    {'reason': 'lam = 1, mu = 0.9; allowed: orders of 1'}
    """
    kp, ki, kd, lam, mu = controller.gains
    found: dict[str, dict[str, Any]] = {"parallel": {"kp": kp, "ki": ki, "kd": kd, "lam": lam, "mu": mu}}
    for name, form in (("standard", standard_form), ("series", series_form)):
        try:
            one = form(controller)
        except InputError as error:
            found[name] = {"reason": str(error)}
        else:
            found[name] = {
                "K": one.gain,
                "Ti_s": one.integral_time,
                "Td_s": one.derivative_time,
                "Ti_min": one.integral_time / _MINUTE,
                "Td_min": one.derivative_time / _MINUTE,
                "proportional_band_pct": one.proportional_band,
            }
    return found


def design_structures(
    process: Process, index: str, ms_max: float | None, sample_time: float
) -> tuple[StructureDesign, ...]:
    """The best controller of each structure for the same bounds."""
    asked = {"method": "time", "index": index, "ms_max": ms_max, "sample_time": sample_time}
    return tuple(StructureDesign(name, tune(TuningRequest(process, structure=name, **asked)))  # type: ignore[arg-type]
                 for name in STRUCTURES)  # fmt: skip


def responses_figure(process: Process, designs: Sequence[StructureDesign], source: str) -> Figure | None:
    """The answers of all designs to one step, over each other; None where there is no design."""
    from fopid_core.model.evaluation import default_horizon

    loops = {
        one.structure: Loop(process, one.result.controller, one.result.filter, one.result.weights)
        for one in designs
        if one.result.controller is not None
    }
    if not loops:
        return None
    horizon = min(default_horizon(loop) for loop in loops.values()) / 2.0
    figure = None
    for name, loop in loops.items():
        response = step_response(loop, horizon, source, 600)  # type: ignore[arg-type]
        figure = response.plot(figure, label=name, title=f"{source} step")
    return figure


def report(process: Process, designs: Sequence[StructureDesign], fit: Figure | None, facts: Mapping[str, Any]) -> str:
    """The report as one page of HTML that needs nothing else."""
    parts = [notebook.table("Process", facts)]
    parts += [_picture(fit)] if fit is not None else []
    for one in designs:
        result = one.result
        told: dict[str, Any] = {"success": result.success, "message": result.message, "cost": result.cost}
        if result.achieved is not None:
            told |= {"max |S|": result.achieved.ms, "max |T|": result.achieved.mt,
                     "phase margin [deg]": result.achieved.phase_margin_deg}  # fmt: skip
        parts.append(f"<h2>{escape(one.structure.upper())}</h2>" + notebook.table("Design", told))
        parts += [notebook.table(f"{name.capitalize()} form", rows) for name, rows in one.forms.items()]
    parts += [_picture(figure) for source in ("setpoint", "load")
              if (figure := responses_figure(process, designs, source)) is not None]  # fmt: skip
    style = "body{font-family:sans-serif;max-width:60em;margin:2em auto}th{text-align:left;padding-right:1em}"
    style += "img{width:100%}caption{font-weight:bold;text-align:left}table{margin:1em 0}"
    head = f"<meta charset='utf-8'><title>Design for {escape(str(process))}</title><style>{style}</style>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body><h1>Design</h1>{''.join(parts)}</body></html>"


def _picture(figure: Figure) -> str:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=120)
    return f"<img alt='' src='data:image/png;base64,{base64.b64encode(out.getvalue()).decode()}'>"
