"""Fractional-order PID control: processes, loops, tuning, and the controller that runs.

Everything that is needed at a keyboard is here; a transfer function is typed as text wherever a process is wanted::

    import fopid_core as fopid

    plant = fopid.read_process("2/(s+1)^3 * exp(-0.2s)")
    pid = fopid.tune(plant, index="iae", ms_max=1.6, structure="pid")
    best = fopid.tune(plant, index="iae", ms_max=1.6, structure="fopid")
    figure = fopid.step_response(plant, pid).plot(label="PID")
    fopid.step_response(plant, best).plot(figure, label="FOPID")

Each name is loaded when it is first used, so that ``import fopid_core`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fopid_core.api.comparing import compare, front
    from fopid_core.api.learning import identify, reduce, tune
    from fopid_core.api.limiting import limit
    from fopid_core.api.looking import evaluate, margins, simulate, stability, step_response
    from fopid_core.design.specification import Bound
    from fopid_core.errors import InputError
    from fopid_core.model.fopid import Fopid, read_gains
    from fopid_core.model.loop import Loop
    from fopid_core.model.process import Process, read_process
    from fopid_core.model.rational import from_control, to_state_space, to_transfer_function
    from fopid_core.study.records import read_record

    __version__: str

_HOME = {
    "Bound": "design.specification",
    "Fopid": "model.fopid",
    "InputError": "errors",
    "Loop": "model.loop",
    "Process": "model.process",
    "compare": "api.comparing",
    "front": "api.comparing",
    "evaluate": "api.looking",
    "from_control": "model.rational",
    "identify": "api.learning",
    "limit": "api.limiting",
    "margins": "api.looking",
    "read_gains": "model.fopid",
    "read_process": "model.process",
    "read_record": "study.records",
    "reduce": "api.learning",
    "simulate": "api.looking",
    "stability": "api.looking",
    "step_response": "api.looking",
    "to_state_space": "model.rational",
    "to_transfer_function": "model.rational",
    "tune": "api.learning",
}
"""Name -> the module it comes from."""

__all__ = [
    "Bound",
    "Fopid",
    "InputError",
    "Loop",
    "Process",
    "compare",
    "evaluate",
    "from_control",
    "front",
    "identify",
    "limit",
    "margins",
    "read_gains",
    "read_process",
    "read_record",
    "reduce",
    "simulate",
    "stability",
    "step_response",
    "to_state_space",
    "to_transfer_function",
    "tune",
]


def __getattr__(name: str) -> Any:
    """A name of the list above, loaded the first time it is asked for (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        return version("fopid_core")
    if name not in _HOME:
        raise AttributeError(f"module 'fopid_core' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"fopid_core.{_HOME[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
