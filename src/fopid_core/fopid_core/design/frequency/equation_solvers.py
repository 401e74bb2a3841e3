"""The two published ways to eqs. (1) to (5), for comparison: five equations, and constrained optimisation.

Both begin from one point and may end anywhere or nowhere; ``frequency_tuning`` sees the whole plane of orders.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, minimize, root

from fopid_core.design.specification import FrequencySpecification, require
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process

Real = NDArray[np.float64]

LOWEST, HIGHEST = (1e-6, 1e-6, 0.0, 0.01, 0.01), (500.0, 500.0, 500.0, 2.0, 2.0)
SOLVED = 1e-6
"""Residual up to which an equation counts as met (angles in rad, gains in dB)."""


@dataclass(frozen=True)
class Residuals:
    """What is left of eqs. (1) to (5) at a controller.

    Attributes
    ----------
    phase_margin : float
        Above the wished one [rad], eq. (1).
    gain_db : float
        |L| at the crossover [dB], eq. (2).
    slope : float
        Crossover times the slope of the phase there [rad], eq. (3).
    t_db, s_db : float
        |T| and |S| above their bounds at the bounds' frequencies [dB], eqs. (4) and (5).
    """

    phase_margin: float
    gain_db: float
    slope: float
    t_db: float
    s_db: float

    def vector(self) -> Real:
        """The residuals as numbers, large where the solver has left what can be computed."""
        values = np.array(list(self.named().values()))
        return np.asarray(np.nan_to_num(values, nan=1e3, posinf=1e3, neginf=-1e3))

    def named(self) -> dict[str, float]:
        """The residuals in words."""
        return {
            "phase margin [rad]": self.phase_margin,
            "gain at the crossover [dB]": self.gain_db,
            "phase slope times crossover [rad]": self.slope,
            "|T| above its bound [dB]": self.t_db,
            "|S| above its bound [dB]": self.s_db,
        }


@dataclass(frozen=True)
class EquationDesign:
    """Where a solver ended: a controller if its numbers are in range, and what is left of the equations."""

    controller: Fopid | None
    residuals: Residuals
    unmet: tuple[str, ...]
    evaluations: int


def solve_equations(process: Process, specification: FrequencySpecification) -> EquationDesign:
    """The paper's way, section 3.3: five equations in five unknowns by Powell's hybrid method, bounds as equalities.

    Examples
    --------
    >>> from fopid_core.design.specification import Bound
    >>> from fopid_core.model.process import read_process
    >>> specification = FrequencySpecification(1.4, 0.3, Bound(-40.0, 10.0), Bound(-40.0, 0.01))
    >>> len(solve_equations(read_process("P1"), specification).unmet) > 0  # no exact solution exists
    True
    """
    residuals = _residuals_of(process, specification)

    def left(x: Real) -> Real:
        return residuals(x).vector()

    solution = root(left, _start(process, specification), method="hybr")
    return _design(solution.x, residuals(solution.x), int(solution.nfev), one_sided=False)


def optimise_constrained(process: Process, specification: FrequencySpecification) -> EquationDesign:
    """The way of Monje et al. (2008): |L| at the crossover is minimised in dB, the rest are constraints (SLSQP)."""
    residuals = _residuals_of(process, specification)

    def equal(x: Real) -> Real:
        left = residuals(x)
        return np.array([left.phase_margin, left.slope])

    def at_most(x: Real) -> Real:
        left = residuals(x)
        return -np.array([left.t_db, left.s_db])

    def squared_gain(x: Real) -> float:
        return residuals(x).gain_db ** 2

    solution = minimize(
        squared_gain,
        _start(process, specification),
        bounds=list(zip(LOWEST, HIGHEST, strict=True)),
        constraints=[NonlinearConstraint(equal, 0.0, 0.0), NonlinearConstraint(at_most, 0.0, np.inf)],
        method="SLSQP",
        options={"maxiter": 300},
    )
    return _design(solution.x, residuals(solution.x), int(solution.nfev), one_sided=True)


def _start(process: Process, specification: FrequencySpecification) -> Real:
    """Plain PID with gain 1 at the crossover."""
    w = specification.crossover
    size = 1.0 / abs(complex(process(1j * w)))
    return np.array([0.8 * size, 0.5 * size * w, 0.3 * size / w, 1.0, 1.0])


def _residuals_of(process: Process, specification: FrequencySpecification) -> Callable[[Real], Residuals]:
    t_max, s_max = specification.t_max, specification.s_max
    for name, bound in (("t_max", t_max), ("s_max", s_max)):
        require(bound is not None, name, bound, "a bound, for these five equations")
    assert t_max is not None
    assert s_max is not None
    s = 1j * np.array([specification.crossover, t_max.frequency, s_max.frequency])
    log_s, p, slope_of_p = np.log(s), process(s), process.logarithmic_derivative(s[:1])[0]
    wished = np.exp(1j * (specification.phase_margin - math.pi))

    @np.errstate(all="ignore")
    def residuals(x: Real) -> Residuals:
        kp, ki, kd, lam, mu = x
        integral, derivative = ki * np.exp(-lam * log_s), kd * np.exp(mu * log_s)
        controller = kp + integral + derivative
        loop = p * controller
        # d arg L / dw = Re[L'(s) / L(s)], and w times that is Im[s L'(s) / L(s)] at s = jw
        slope = (mu * derivative[0] - lam * integral[0]) / controller[0] + s[0] * slope_of_p
        return Residuals(
            phase_margin=float(np.angle(loop[0] / wished)),
            gain_db=_db(loop[0]),
            slope=float(slope.imag),
            t_db=_db(loop[1] / (1.0 + loop[1])) - t_max.db,
            s_db=_db(1.0 / (1.0 + loop[2])) - s_max.db,
        )

    return residuals


def _db(value: complex) -> float:
    return float(20.0 * np.log10(np.abs(value)))


def _design(x: Real, left: Residuals, evaluations: int, one_sided: bool) -> EquationDesign:
    in_range = bool(np.all(np.isfinite(x)) and 0.0 <= x[3] <= 2.0 and 0.0 <= x[4] <= 2.0)
    values = left.named()
    broken = [
        f"{name}: {value:.3g} off"
        for name, value in values.items()
        if not (value if one_sided and "bound" in name else abs(value)) <= SOLVED
    ]
    if not in_range:
        broken.append(f"orders lam = {x[3]:.4g}, mu = {x[4]:.4g}; allowed: 0 to 2")
    controller = Fopid(*(float(number) for number in x)) if in_range else None
    return EquationDesign(controller, left, tuple(broken), evaluations)
