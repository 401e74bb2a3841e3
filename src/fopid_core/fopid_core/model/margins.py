"""How far the loop is from trouble: margins, sensitivity peaks, the slope of the phase."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fopid_core.model.loop import Loop
from fopid_core.model.winding import right_half_plane_zeros


@dataclass(frozen=True)
class Margins:
    """The open loop L(jw) seen from -1.

    Attributes
    ----------
    phase_margin : float
        Angle [rad] from -1 to L(jw) where \\|L\\| = 1, in (-pi, pi]; of several the smallest in absolute value,
        infinite without a crossover.
    crossover : float
        Where it was taken [rad/s]; NaN without a crossover.
    gain_margin : float
        Factor on the loop gain that takes L(jw) through -1; of several the one nearest to 1, infinite when
        there is none.
    phase_crossover : float
        Where it was taken [rad/s].
    delay_margin : float
        The additional delay [s] that takes L(jw) through -1.
    jitter_margin : float
        The largest varying additional delay [s] for which \\|T(jw)\\| w < 1 / jitter_margin still proves a stable loop
        stable (Kao and Lincoln 2004).
    ms, ms_frequency, mt, mt_frequency : float
        Largest \\|S(jw)\\| and \\|T(jw)\\| and where [rad/s]; 0 or infinity when it is the limit there.
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


def margins(loop: Loop) -> Margins:
    """Margins of a loop. FIRST VERSION: interface is final."""
    z = _grid(loop)
    w = np.exp(z)
    gain, angle = _polar(loop, w)
    crossovers = [_root(loop, z[i], z[i + 1], 0) for i in np.flatnonzero(np.sign(gain[1:]) != np.sign(gain[:-1]))]
    turned = np.sin(angle)
    near = np.cos(angle) < 0
    changes = (np.sign(turned[1:]) != np.sign(turned[:-1])) & near[1:] & near[:-1]
    phase_crossovers = [_root(loop, z[i], z[i + 1], 1) for i in np.flatnonzero(changes)]
    wc = np.array(crossovers)
    pm, cross, delay, slope = math.inf, math.nan, math.inf, math.nan
    if wc.size:
        values = loop(1j * wc)
        pms = np.angle(-values)
        i = int(np.argmin(np.abs(pms)))
        pm, cross = float(pms[i]), float(wc[i])
        delay = float(np.min(np.mod(pms, 2 * np.pi) / wc))
        slope = float(loop.logarithmic_derivative(1j * cross).real)
    gm, pc = math.inf, math.nan
    if phase_crossovers:
        wp = np.array(phase_crossovers)
        gains = 1.0 / np.abs(loop(1j * wp))
        i = int(np.argmin(np.abs(np.log(gains))))
        gm, pc = float(gains[i]), float(wp[i])
    s_abs, t_abs = np.abs(loop.sensitivity(1j * w)), np.abs(loop.complementary_sensitivity(1j * w))
    ms, msw = _peak(lambda x: float(np.abs(loop.sensitivity(1j * math.exp(x)))), z, s_abs)
    mt, mtw = _peak(lambda x: float(np.abs(loop.complementary_sensitivity(1j * math.exp(x)))), z, t_abs)
    jitter = float(1.0 / np.max(w * t_abs))
    return Margins(pm, cross, gm, pc, delay, jitter, ms, msw, mt, mtw, slope, tuple(crossovers), tuple(phase_crossovers))


def _grid(loop: Loop) -> NDArray[np.float64]:
    zeros = right_half_plane_zeros(loop.characteristic)
    own = right_half_plane_zeros(loop.process.denominator)
    low = max(min(zeros.log_frequency[0], own.log_frequency[0]), -40.0) - 3.0
    high = min(max(zeros.log_frequency[-1], own.log_frequency[-1]), 40.0) + 5.0
    grids = [np.linspace(low, high, 1500), zeros.log_frequency, own.log_frequency]
    if loop.process.delay:
        top = min(np.exp(high), 1000.0 / loop.process.delay)
        grids.append(np.log(np.linspace(0.05, top * loop.process.delay, 2000) / loop.process.delay))
    z = np.unique(np.concatenate(grids))
    return z[(z >= low) & (z <= high)]


def _polar(loop: Loop, w: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    value = loop(1j * w)
    return np.log(np.abs(value)), np.angle(value)


def _root(loop: Loop, a: float, b: float, part: int) -> float:
    from scipy.optimize import brentq

    def f(z: float) -> float:
        value = complex(loop(1j * math.exp(z)))
        return math.log(abs(value)) if part == 0 else value.imag / abs(value)

    return math.exp(brentq(f, a, b, xtol=1e-13))


def _peak(f, z, values) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    from scipy.optimize import minimize_scalar

    i = int(np.argmax(values))
    if i in (0, len(z) - 1):
        return float(values[i]), float(0.0 if i == 0 else np.inf)
    r = minimize_scalar(lambda x: -f(x), bounds=(z[i - 1], z[i + 1]), method="bounded", options={"xatol": 1e-10})
    return float(-r.fun), math.exp(r.x)
