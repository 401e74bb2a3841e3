"""What a loop is worth as it runs: how it follows, what it makes of a load, of noise, and how near it is to trouble."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fopid_core.design.identification.noise_spectrum import NoiseSpectrum
from fopid_core.design.robust_verification import as_held
from fopid_core.design.sampled_loop import sampled_controller, sampled_process
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.settings import as_designed

_POINTS = 600


@dataclass(frozen=True)
class LoopWorth:
    """What gains are worth on a process.

    Attributes
    ----------
    setpoint, load : float
        Integral of the absolute error after a unit step of each, over the same horizon; infinite for an unstable loop.
    ms : float
        max |S|.
    noise_gain : float
        Standard deviation of the control over that of the measurement's noise, which is white at the ticks if nobody
        knows better.
    """

    setpoint: float
    load: float
    ms: float
    noise_gain: float

    def __str__(self) -> str:
        return (
            f"IAE {self.setpoint:.4g} to a setpoint step and {self.load:.4g} to a load step, Ms {self.ms:.3g}, "
            f"noise gain {self.noise_gain:.3g}"
        )


def loop_worth(loop: Loop, sample_time: float, horizon: float, spectrum: NoiseSpectrum | None = None) -> LoopWorth:
    """Judge a loop whose controller ticks every ``sample_time`` [s] over a horizon [s], in noise of a spectrum.

    The control is held from tick to tick, which counts as a delay of half as long; the setpoint moves at a tick, and so
    is acted on without that delay.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> judged = loop_worth(Loop(Process.parse("1/(s+1)"), Fopid(kp=1.0, ki=1.0)), 0.01, 50.0)
    >>> round(judged.setpoint, 3), round(judged.load, 3)  # 1/(s+1) and s/(s+1)^2
    (1.0, 1.0)
    """
    held = replace(loop, process=as_held(loop.process, sample_time))
    if not stability(held).stable:
        return LoopWorth(math.inf, math.inf, math.inf, math.inf)
    errors = []
    for source in ("setpoint", "load"):
        try:
            response = step_response(held, horizon, source)
            errors.append(indices(response.time, response.error).iae)
        except InputError:  # near the border of stability the response is not known
            errors.append(math.inf)
    setpoint, load = errors
    return LoopWorth(setpoint - 0.5 * sample_time, load, margins(held).ms, noise_gain(loop, sample_time, spectrum))


def noise_gain(loop: Loop, sample_time: float, spectrum: NoiseSpectrum | None = None) -> float:
    """Root mean square of |C F S| of the sampled loop, over all frequencies up to the Nyquist frequency.

    With a spectrum over those of the noise: the standard deviation of the control over the noise's in any case.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> round(noise_gain(Loop(Process.parse("0.001/(s+1)"), Fopid(kp=2.0)), 0.01), 3)
    2.0
    """
    seen = spectrum.angles(sample_time) if spectrum else None
    if spectrum and seen is not None:
        return math.sqrt(float(np.asarray(spectrum.share) @ _control_from_noise(loop, sample_time, seen)))
    theta = np.union1d(np.geomspace(1e-6, math.pi, _POINTS), np.linspace(0.0, math.pi, _POINTS + 1)[1:])
    gain = _control_from_noise(loop, sample_time, theta)
    return math.sqrt(_area(gain, theta) / math.pi)


def _area(heights: Floats, theta: Floats) -> float:
    """Below straight lines; numpy calls that by other names before and after its version 2."""
    return float(np.sum(0.5 * (heights[1:] + heights[:-1]) * np.diff(theta)))


def control_rate_in_noise(loop: Loop, sample_time: float) -> float:
    """Standard deviation of the control's moves from tick to tick, over that of white noise at the ticks [1/s].

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> idle = Loop(Process.parse("0.001/(s+1)"), Fopid(kp=2.0))  # moves by 2 times the difference of two such noises
    >>> round(control_rate_in_noise(idle, 0.01) / (2.0 * math.sqrt(2.0) / 0.01), 3)
    1.0
    """
    theta = np.linspace(0.0, math.pi, 4 * _POINTS + 1)[1:]
    power = _control_from_noise(loop, sample_time, theta) * np.abs(np.expm1(1j * theta)) ** 2
    return math.sqrt(_area(power, theta) / math.pi) / sample_time


def _control_from_noise(loop: Loop, sample_time: float, theta: Floats) -> Floats:
    """|C F S|^2 of the sampled loop, at frequencies [rad]."""
    settings = as_designed(loop.controller, sample_time, loop.filter, loop.weights)
    controller = sampled_controller(FopidController(settings), theta)
    return np.asarray(np.abs(controller / (1.0 + controller * sampled_process(loop.process, sample_time, theta))) ** 2)
