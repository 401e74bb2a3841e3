"""What a loop does: responses, margins, a verdict, a simulation as it runs."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from fopid_core.api.reading import as_loop, refuse_unknown
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.api.reading import ControllerLike, ProcessLike
    from fopid_core.model.evaluation import Evaluation
    from fopid_core.model.loop import Loop
    from fopid_core.model.margins import Margins
    from fopid_core.model.response import Response, Source
    from fopid_core.model.stability import Stability
    from fopid_core.runtime.simulation import Trace


def step_response(
    process: ProcessLike | Loop,
    controller: ControllerLike | None = None,
    horizon: float | None = None,
    source: Source = "setpoint",
    points: int | None = None,
) -> Response:
    """The exact answer of a loop to a unit step; ``.plot()`` draws it.

    Parameters
    ----------
    process : Process, str, python-control object or Loop
    controller : Fopid, TuningResult, str or sequence of float
        Left out after a loop.
    horizon : float, optional
        Last instant [s]; chosen from the loop when not given.
    source : {"setpoint", "load"}
        Where the step comes in.
    points : int, optional
        Evenly spaced instants; as many as describe it when not given.

    Examples
    --------
    >>> round(float(step_response("1/(s+1)", [1], horizon=1.0).output[-1]), 5)  # (1 - exp(-2)) / 2
    0.43233
    """
    from fopid_core.model import response
    from fopid_core.model.evaluation import default_horizon

    loop = as_loop(process, controller)
    return response.step_response(loop, default_horizon(loop) if horizon is None else horizon, source, points)


def margins(process: ProcessLike | Loop, controller: ControllerLike | None = None) -> Margins:
    """Margins and sensitivity peaks of a loop.

    Parameters
    ----------
    process, controller
        As for `step_response`.

    Returns
    -------
    Margins
        ``gain_margin`` as a factor, ``phase_margin`` [rad], ``crossover`` [rad/s], ``delay_margin`` [s], ``ms``.

    Examples
    --------
    >>> round(margins("1/(s+1)^3", [2]).gain_margin, 6)
    4.0
    """
    from fopid_core.model import margins as module

    return module.margins(as_loop(process, controller))


def stability(process: ProcessLike | Loop, controller: ControllerLike | None = None) -> Stability:
    """Whether a loop is stable, by the argument principle, and how many unstable poles it has.

    Parameters
    ----------
    process, controller
        As for `step_response`.

    Returns
    -------
    Stability
        ``stable``, ``decided`` and ``unstable_poles``; the reason where it could not be decided.

    Examples
    --------
    >>> stability("1/(s+1)^3", [9]).unstable_poles
    2
    """
    from fopid_core.model import stability as module

    return module.stability(as_loop(process, controller))


def evaluate(
    process: ProcessLike | Loop, controller: ControllerLike | None = None, horizon: float | None = None
) -> Evaluation:
    """Everything about a loop in one answer: stability, margins, indices of a setpoint step.

    Parameters
    ----------
    process, controller, horizon
        As for `step_response`.

    Returns
    -------
    Evaluation
        What is not known is NaN, with the reason.

    Examples
    --------
    >>> evaluate("P1", "1,0.4,0.5,1,1").stability.stable
    True
    """
    from fopid_core.model import evaluation

    return evaluation.evaluate(as_loop(process, controller), horizon)


def simulate(
    process: ProcessLike | Loop,
    controller: ControllerLike | None = None,
    horizon: float | None = None,
    *,
    setpoint: float = 1.0,
    disturbance: float = 0.0,
    sample_time: float = 0.01,
    **settings: Any,
) -> Trace:
    """The loop as it runs: sampled, held, with the filter bank, limits and noise; the same numbers as over ROS.

    Parameters
    ----------
    process : Process, str, python-control object or Loop
        Rational, with or without delay.
    controller : Fopid, TuningResult, str or sequence of float
        Left out after a loop.
    horizon : float, optional
        How long [s]; chosen from the loop when not given.
    setpoint, disturbance : float
        Both from the first sample on; the disturbance adds to the control.
    sample_time : float
        [s]
    **settings
        Of ``ControllerSettings`` (``control_max``, ``setpoint_weight``, ``derivative_filter_time``, ...) and of
        ``PlantSettings`` (``noise_std``, ``seed``, ``delay_model``, ...).

    Examples
    --------
    >>> trace = simulate("1/(s+1)", [4, 4], horizon=10.0, control_max=1.5)
    >>> bool(abs(trace.measurement[-1] - 1) < 0.01), float(trace.control.max())
    (True, 1.5)
    """
    from fopid_core.model.evaluation import default_horizon
    from fopid_core.runtime.controller import ControllerSettings, FopidController
    from fopid_core.runtime.convolved_plant import plant_of
    from fopid_core.runtime.plant import PlantSettings
    from fopid_core.runtime.simulation import simulate as run

    loop = as_loop(process, controller)
    horizon = default_horizon(loop) if horizon is None else horizon
    samples = round(horizon / sample_time) + 1 if sample_time > 0.0 else 0
    if not 2 <= samples <= _MOST_SAMPLES:
        raise InputError(f"horizon = {horizon:g}, sample_time = {sample_time:g}; allowed: 2 to {_MOST_SAMPLES} samples")
    known: dict[type, tuple[str, ...]] = {
        kind: tuple(each.name for each in fields(kind) if each.name not in _GIVEN)
        for kind in (ControllerSettings, PlantSettings)
    }
    refuse_unknown(tuple(settings), (*known[ControllerSettings], *known[PlantSettings]))

    def of(kind: type) -> dict[str, Any]:
        return {name: value for name, value in settings.items() if name in known[kind]}

    designed: dict[str, Any] = {
        "measurement_filter_order": loop.filter.order,
        "measurement_filter_time": loop.filter.time,
        "setpoint_weight": loop.weights.proportional,
        "derivative_setpoint_weight": loop.weights.derivative,
    }
    running = FopidController(ControllerSettings(loop.controller, sample_time, **designed | of(ControllerSettings)))
    plant = plant_of(PlantSettings(loop.process, sample_time, **of(PlantSettings)))
    return run(running, plant, samples, lambda _: setpoint, lambda _: disturbance)


_GIVEN = ("gains", "process", "sample_time", "on_trial")
"""Fields that are no settings of a simulation."""
_MOST_SAMPLES = 10_000_000
