"""How far the loop is from trouble: margins, sensitivity peaks, the slope of the phase."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from fopid_core import notebook
from fopid_core.model.adaptive_grid import refine, roots
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.loop import Loop
from fopid_core.model.loop_peaks import LoopPeaks
from fopid_core.model.peaks import limits
from fopid_core.model.winding import LARGEST_LOG, right_half_plane_zeros

Curve = Callable[[Floats], Floats]

_TURN_STEP = 0.1  # of the delay's phase between points [rad]
_LAST_TURNS = 4.0 * math.pi  # of the delay's phase that are looked at after abs(L) has become quiet [rad]
_MOST_TURNS = 2000.0  # [rad]
_QUIET = 0.3
_LEVEL = 1e-12  # an angle to the real axis that is rounding


@dataclass(frozen=True)
class Margins:
    """The open loop L(jw) seen from -1.

    Attributes
    ----------
    phase_margin : float
        Angle [rad] from -1 to L(jw) where abs(L) = 1, in (-pi, pi]; of several the smallest in absolute value,
        infinite without a crossover.
    crossover : float
        Where it was taken [rad/s]; NaN without a crossover.
    gain_margin : float
        Factor on the loop gain that takes L(jw) through -1; of several the one nearest to 1, infinite when
        there is none.
    phase_crossover : float
        Where it was taken [rad/s]; infinite where it is the limit there.
    delay_margin : float
        The additional delay [s] that takes L(jw) through -1.
    jitter_margin : float
        The largest varying additional delay [s] for which w abs(T(jw)) < 1 / jitter_margin still proves a stable loop
        stable (Kao and Lincoln 2004).
    ms, ms_frequency, mt, mt_frequency : float
        Largest abs(S(jw)) and abs(T(jw)), exact to 1e-8, and where [rad/s]; 0 or infinity when it is the limit there.
        NaN where they are not known, because stability is not.
    phase_slope : float
        d arg L / dw at the crossover [rad/(rad/s)], eq. (3) of the paper.
    crossovers, phase_crossovers : tuple of float
        All of them, ascending [rad/s].
    """

    phase_margin: float
    crossover: float
    gain_margin: float
    phase_crossover: float
    delay_margin: float
    jitter_margin: float
    ms: float
    ms_frequency: float
    mt: float
    mt_frequency: float
    phase_slope: float
    crossovers: tuple[float, ...]
    phase_crossovers: tuple[float, ...]

    @property
    def phase_margin_deg(self) -> float:
        """The phase margin [deg]."""
        return math.degrees(self.phase_margin)

    def _repr_html_(self) -> str:
        return notebook.table("Margins", {"phase_margin_deg": self.phase_margin_deg, **asdict(self)})


def margins(loop: Loop, peaks: LoopPeaks | None = None, *, jitter: bool = True) -> Margins:
    """Margins of a loop; quicker from its peaks where somebody has them.

    The gain and phase margins describe the curve whether or not the loop is stable; ask ``stability`` which. The delay
    and jitter margins of a loop that is not stable are 0. With a delay, phase crossovers are listed up to two turns of
    it past the frequency above which abs(L) stays below 0.3. Without ``jitter`` that margin, a search
    of its own, is NaN.

    Examples
    --------
    >>> import math
    >>> from fopid_core.model.fopid import Fopid
    >>> from fopid_core.model.process import Process
    >>> found = margins(Loop(Process.parse("1/(s+1)^3"), Fopid(kp=2.0)))
    >>> round(found.gain_margin, 9), round(math.degrees(found.phase_margin), 2)
    (4.0, 67.6)
    """
    if loop.open_loop_numerator.is_zero:
        return _without_feedback(loop)
    peaks = peaks or LoopPeaks(loop)
    stable = bool(peaks.closed.all_left[0])
    z, response = refine(lambda x: loop(1j * np.exp(x)), _grid(loop, peaks.log_frequency))
    with np.errstate(divide="ignore"):  # a loop next to nothing is zero somewhere
        crossovers = _crossings(lambda x: np.log(np.abs(loop(1j * np.exp(x)))), z, np.log(np.abs(response)))
    phase_margin, crossover, delay_margin, slope = _phase_margin(loop, crossovers)
    phase_crossovers = _phase_crossings(loop, z, response)
    at_infinity = limits(loop.open_loop_numerator, loop.open_loop_denominator)[1]
    gain_margin, phase_crossover = _gain_margin(loop, phase_crossovers, at_infinity)
    sensitivity, complementary = peaks.sensitivity(), peaks.complementary()
    varying = math.nan
    if jitter:
        varying = 1.0 / peaks.weighted_complementary().value if stable else 0.0
    tolerant = stable and at_infinity < 1.0
    return Margins(
        phase_margin, crossover, gain_margin, phase_crossover,
        delay_margin if tolerant else 0.0, varying,
        sensitivity.value, sensitivity.frequency, complementary.value, complementary.frequency,
        slope, tuple(crossovers.tolist()), tuple(phase_crossovers.tolist()),
    )  # fmt: skip


def _without_feedback(loop: Loop) -> Margins:
    delay = math.inf if right_half_plane_zeros(loop.characteristic).all_left[0] else 0.0
    inf, nan = math.inf, math.nan
    return Margins(inf, nan, inf, nan, delay, delay, 1.0, 0.0, 0.0, 0.0, nan, (), ())


def _grid(loop: Loop, z: Floats) -> Floats:
    """The grid ln w for crossovers: as far as no power of s overflows, and as fine as a delay's turns."""
    z = z[np.abs(z) < LARGEST_LOG / (2.0 + loop.characteristic.degree)]
    delay = max(t.delay for t in loop.characteristic.terms)
    if delay:
        loud = z[np.abs(loop(1j * np.exp(z))) > _QUIET]
        last_turn = min(math.exp(loud.max(initial=z[0])) * delay + _LAST_TURNS, _MOST_TURNS)
        turns = np.log(np.arange(_TURN_STEP, last_turn, _TURN_STEP) / delay)
        z = np.union1d(z[z < turns[-1]], turns)
    return z


def _crossings(curve: Curve, z: Floats, values: Floats) -> Floats:
    """Frequencies [rad/s] at which a curve over ln w goes through zero."""
    sign = np.sign(values)
    after = np.flatnonzero(sign[1:] * sign[:-1] < 0.0)
    exact = z[sign == 0.0]
    frequencies: Floats = np.exp(np.sort(np.concatenate((exact, roots(curve, z[after], z[after + 1])))))
    return frequencies


def _phase_margin(loop: Loop, crossovers: Floats) -> tuple[float, float, float, float]:
    """Phase margin, its crossover, delay margin and slope of the phase there."""
    if crossovers.size == 0:
        return math.inf, math.nan, math.inf, math.nan
    angles = np.angle(-loop(1j * crossovers))
    nearest = int(np.argmin(np.abs(angles)))
    slope = loop.logarithmic_derivative(1j * crossovers[nearest]).real
    delays = np.mod(angles, 2.0 * np.pi) / crossovers
    return float(angles[nearest]), float(crossovers[nearest]), float(delays.min()), float(slope)


def _phase_crossings(loop: Loop, z: Floats, response: Complexes) -> Floats:
    """Frequencies [rad/s] at which L(jw) crosses the negative real axis."""
    seen = np.isfinite(response) & (response != 0.0)
    z, response = z[seen], response[seen]
    sine = response.imag / np.abs(response)
    on_axis = np.abs(sine) < _LEVEL
    z, response, sine = z[~on_axis], response[~on_axis], sine[~on_axis]
    left_half = np.flatnonzero((response.real[1:] < 0.0) & (response.real[:-1] < 0.0) & (sine[1:] * sine[:-1] < 0.0))

    def curve(x: Floats) -> Floats:
        value = loop(1j * np.exp(x))
        share: Floats = value.imag / np.abs(value)
        return share

    return np.exp(roots(curve, z[left_half], z[left_half + 1]))


def _gain_margin(loop: Loop, phase_crossovers: Floats, at_infinity: float) -> tuple[float, float]:
    """The margin and where; with a delay the phase goes on crossing up to infinity, and abs(L) to its limit there."""
    with np.errstate(divide="ignore", over="ignore"):  # no number is large enough a gain for a loop next to nothing
        factors = 1.0 / np.abs(loop(1j * phase_crossovers))
    if loop.process.delay and 0.0 < at_infinity < math.inf:
        phase_crossovers, factors = np.append(phase_crossovers, math.inf), np.append(factors, 1.0 / at_infinity)
    if factors.size == 0:
        return math.inf, math.nan
    nearest = int(np.argmin(np.abs(np.log(factors))))
    return float(factors[nearest]), float(phase_crossovers[nearest])
