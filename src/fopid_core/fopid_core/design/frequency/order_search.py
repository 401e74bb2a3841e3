"""The designs of the whole plane of orders: one for every (lam, mu), measured in batches, the best by zooming in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.control_peak import first_control
from fopid_core.design.defaults import LEAST_PROPORTIONAL, PRACTICAL_ORDERS
from fopid_core.design.frequency.exact_gains import ControllerTarget, has_one_sign
from fopid_core.design.load_tail import LoadTail
from fopid_core.design.specification import FrequencySpecification
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

AXIS = np.linspace(0.05, 2.0, 40)  # an order of zero is no integral and no derivative
POINTS_PER_DECADE = 16
LINE = np.arange(-4, 5)
LINE_STEPS = ((0.0125, 40), (0.003, 20), (0.0008, 8))
"""Steps along a line, and how many of the lines are worth it."""
BEAM = 6
STEPS = tuple(0.0125 * 0.5**k for k in range(8))
NEAR = 3
"""From which of the steps on a design is sought again near one that is known."""
NEIGHBOURS = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])
INSIDE_DB = 2e-3
"""How far inside a bound a design must be [dB]: what the grid of frequencies does not show."""
FLAT = math.radians(5.0)
"""The phase counts as flat where it stays this close to its value at the crossover [rad]."""


@dataclass(frozen=True)
class Designs:
    """A batch of designs that meet eqs. (1) to (3), with what decides between them.

    Attributes
    ----------
    table : ndarray, shape (n, 11)
        Columns kp, ki, kd, lam, mu; the largest |T| and |S| on the bands of the bounds [dB] (-inf without a
        bound); ms; mt; the width of the flat phase [decades] (0 unless it is the criterion); and how far the design
        is from being admissible [dB].
    """

    table: Real

    @property
    def gains(self) -> Real:
        """Rows (kp, ki, kd, lam, mu), shape (n, 5)."""
        return self.table[:, :5]

    @property
    def orders(self) -> Real:
        """Rows (lam, mu), shape (n, 2)."""
        return self.table[:, 3:5]

    @property
    def t_db(self) -> Real:
        """Largest |T| on its band [dB], shape (n,)."""
        return self.table[:, 5]

    @property
    def s_db(self) -> Real:
        """Largest |S| on its band [dB], shape (n,)."""
        return self.table[:, 6]

    @property
    def ms(self) -> Real:
        """Largest |S|, shape (n,)."""
        return self.table[:, 7]

    @property
    def mt(self) -> Real:
        """Largest |T|, shape (n,)."""
        return self.table[:, 8]

    @property
    def flatness(self) -> Real:
        """Width of the flat phase [decades], shape (n,)."""
        return self.table[:, 9]

    @property
    def inadmissible(self) -> Real:
        """How far the gain is on the wrong side of 1 beyond the crossover, or control or a load's tail too large [dB].

        Shape (n,); 0 or less for a design whose only crossover is the wished one and which keeps both bounds.
        """
        return self.table[:, 10]

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Designs:
        """Some of the designs."""
        return Designs(self.table[rows])

    def joined(self, *others: Designs) -> Designs:
        """All batches as one."""
        return Designs(np.concatenate([self.table, *(other.table for other in others)]))

    def violation(self, specification: FrequencySpecification) -> Real:
        """How far each design is above the bound it breaks most [dB]; negative when it breaks none."""
        worst = np.full(len(self), -np.inf)
        for bound, db in ((specification.t_max, self.t_db), (specification.s_max, self.s_db)):
            if bound is not None:
                worst = np.maximum(worst, db - bound.db + INSIDE_DB)
        return worst


Merit = Callable[[Designs], Real]
"""What a search minimises over designs."""

INADMISSIBLE = 1e9
"""Merit of a design that is not admissible; more the further it is from being so, which leads to those that are."""


class OrderSearch:
    """The designs for one process and one specification, on one grid of frequencies.

    Parameters
    ----------
    process : Process
    specification : FrequencySpecification
    w : ndarray, shape (m,)
        Ascending frequencies at which the loop is looked at [rad/s].
    """

    def __init__(self, process: Process, specification: FrequencySpecification, w: Real) -> None:
        self.process, self.specification, self.w = process, specification, w
        self.evaluations = 0
        self._sorts_out_unstable = False
        self._target = ControllerTarget.of(process, specification.phase_margin, specification.crossover)
        self._load_tail = LoadTail(process, specification.crossover)
        self._p = process(1j * w)
        self._log_w = np.log(w)
        t_max, s_max = specification.t_max, specification.s_max
        self._t_band = slice(0) if t_max is None else self._at_and_above(t_max.frequency)
        self._s_band = slice(0) if s_max is None else self._up_to(s_max.frequency)

    def _at_and_above(self, w: float) -> slice:
        return slice(int(np.searchsorted(self.w, w)), None)

    def _up_to(self, w: float) -> slice:
        return slice(0, int(np.searchsorted(self.w, w, side="right")))

    def refined(self, more: Real) -> OrderSearch:
        """The same with more frequencies."""
        finer = OrderSearch(self.process, self.specification, np.union1d(self.w, more))
        finer.evaluations = self.evaluations
        return finer

    @cached_property
    def _survey(self) -> Designs:
        """The designs on a grid over the whole plane, stable or not."""
        return self.designs(np.stack([axis.ravel() for axis in np.meshgrid(AXIS, AXIS, indexing="ij")], axis=1))

    @cached_property
    def _stable_survey(self) -> Designs:
        return self._survey[stable_mask(self.process, self._survey.gains)] if len(self._survey) else self._survey

    def best(self, merit: Merit, enough: float = -math.inf) -> Designs | None:
        """The admissible design of lowest merit in the whole plane (bounds aside), or None without any.

        A design on the grid with a merit of ``enough`` or less will do.
        """
        merit = _admissible_first(merit)
        lowest = _lowest(self._survey, merit, 1)
        if len(lowest) and merit(lowest)[0] <= enough and self._first_stable(lowest) is not None:
            return lowest
        return self._lowest_stable(lambda: self._around(self._in_valleys(self._start, merit), merit, STEPS))

    def best_near(self, known: Designs, merit: Merit) -> Designs | None:
        """The admissible design of lowest merit near one that is known."""
        merit = _admissible_first(merit)
        return self._lowest_stable(lambda: self._around(self.measure(known.gains), merit, STEPS[NEAR:]))

    def _lowest_stable(self, search: Callable[[], Designs]) -> Designs | None:
        """The lowest design of a search if it is stable, as it nearly always is, else that of one among stable ones."""
        found = search()
        if len(found) and self._first_stable(found[:1]) is not None:
            return found[:1]
        self._sorts_out_unstable = True
        found = search()
        self._sorts_out_unstable = False
        return self._first_stable(found)

    @property
    def _start(self) -> Designs:
        return self._stable_survey if self._sorts_out_unstable else self._survey

    def _first_stable(self, designs: Designs) -> Designs | None:
        """The first design that is admissible and stable."""
        candidates = designs[designs.inadmissible <= 0.0]
        rows = (candidates[row : row + 1] for row in range(len(candidates)))
        return next((design for design in rows if stable_mask(self.process, design.gains)[0]), None)

    def designs(self, orders: Real) -> Designs:
        """The designs at those rows (lam, mu) that lie in it, with gains of one sign.

        A derivative of a higher order than the process is of relative degree leaves no margin for any delay.
        """
        self.evaluations += len(orders)
        highest = np.minimum([2.0, self.process.relative_degree], 2.0)
        lam, mu = orders[((orders > 0.0) & (orders <= highest)).all(axis=1)].T
        gains = self._target.gains(lam, mu)
        gains = gains[np.isfinite(gains).all(axis=1)]
        gains = gains[has_one_sign(gains)]
        if self._sorts_out_unstable and len(gains):
            gains = gains[stable_mask(self.process, gains)]
        return self.measure(gains)

    def _in_valleys(self, designs: Designs, merit: Merit) -> Designs:
        """The lowest merit near some designs: along every line of the grid, in both directions.

        The best designs often lie in a valley far narrower than the grid, which may run along either order.
        """
        return designs.joined(*(self._along_lines(designs, merit, moving) for moving in (0, 1)))

    def _around(self, designs: Designs, merit: Merit, steps: tuple[float, ...]) -> Designs:
        """The lowest merit around the best few designs, lowest first, by steps to neighbours, ever shorter."""
        beam = _lowest(designs, merit, BEAM)
        for step in steps:
            centres = np.round(beam.orders / step).astype(int)
            cells = np.unique((centres[:, None] + NEIGHBOURS).reshape(-1, 2), axis=0) * step
            beam = _lowest(beam.joined(self.designs(cells)), merit, BEAM)
        return beam

    def _along_lines(self, designs: Designs, merit: Merit, moving: int) -> Designs:
        """The lowest merit on each line along which one order moves (0: lam, 1: mu) and the other is kept."""
        for step, most in LINE_STEPS:
            lines = _lowest(_best_of_each(designs, merit, 1 - moving), merit, most)
            orders = np.repeat(lines.orders[:, None], len(LINE), axis=1)
            orders[:, :, moving] += step * LINE
            designs = lines.joined(self.designs(orders.reshape(-1, 2)))
        return designs

    def worst_frequencies(self, design: Designs) -> Real:
        """Where one design has its largest |S| and |T|, and its |L| is nearest to crossing 1 again [rad/s]."""
        loop = self._loop(design.gains)[0]
        s_gain = 1.0 / np.abs(1.0 + loop)
        t_gain, everywhere = np.abs(loop) * s_gain, slice(None)
        below = self._up_to(0.999 * self.specification.crossover)
        above = self._at_and_above(1.001 * self.specification.crossover)
        looked_at = (
            (everywhere, s_gain), (everywhere, t_gain), (self._t_band, t_gain), (self._s_band, s_gain),
            (above, np.abs(loop)), (below, 1.0 / np.abs(loop)),
        )  # fmt: skip
        return np.array([self.w[band][np.argmax(gain[band])] for band, gain in looked_at if len(self.w[band])])

    def measure(self, gains: Real) -> Designs:
        """What decides between the controllers with these rows (kp, ki, kd, lam, mu)."""
        loop = self._loop(gains)
        power = _power(loop)
        s_power = 1.0 / _power(1.0 + loop)
        t_power = power * s_power
        t_db, s_db = _worst_db(t_power[:, self._t_band]), _worst_db(s_power[:, self._s_band])
        ms, mt = (np.sqrt(values.max(axis=1, initial=1.0)) for values in (s_power, t_power))
        beyond = np.maximum(self._beyond_crossover(power), self._beyond_control(gains))
        beyond = np.maximum(beyond, np.maximum(self._beyond_load_tail(gains), self._beyond_practice(gains)))
        return Designs(np.column_stack([gains, t_db, s_db, ms, mt, self._flatness(loop), beyond]))

    def _loop(self, gains: Real) -> Complex:
        """L(j w), shape (n, frequencies)."""
        kp, ki, kd, lam, mu = gains.T[..., None]
        integral = ki * np.exp(-0.5j * np.pi * lam) * np.exp(-lam * self._log_w)
        derivative = kd * np.exp(0.5j * np.pi * mu) * np.exp(mu * self._log_w)
        return np.asarray(self._p * (kp + integral + derivative))

    def _beyond_crossover(self, power: Real) -> Real:
        """By how much |L| is above 1 after the crossover, or below 1 before it [dB]; negative where it is not."""
        below = self._up_to(0.999 * self.specification.crossover)
        above = self._at_and_above(1.001 * self.specification.crossover)
        return np.maximum(_worst_db(power[:, above]), _worst_db(1.0 / power[:, below]))

    def _beyond_control(self, gains: Real) -> Real:
        """By how much the control right after a setpoint step is above its bound [dB]; negative where it is not."""
        if math.isinf(self.specification.u_max):
            return np.full(len(gains), -np.inf)
        first = np.abs(first_control(gains, self.specification.sample_time))
        return np.asarray(20.0 * np.log10(first / self.specification.u_max))

    def _beyond_load_tail(self, gains: Real) -> Real:
        """By how much what a load has left in the end is above its bound [dB]; negative where it is not."""
        if math.isinf(self.specification.load_left_max):
            return np.full(len(gains), -np.inf)
        return np.asarray(20.0 * np.log10(self._load_tail.left(gains) / self.specification.load_left_max))

    def _beyond_practice(self, gains: Real) -> Real:
        """How far kp and orders are outside what a practitioner accepts, negative inside: dB in name only."""
        if not self.specification.practical:
            return np.full(len(gains), -np.inf)
        kp, _, kd, lam, mu = gains.T
        (lam_low, lam_high), (mu_low, mu_high) = PRACTICAL_ORDERS["lam"], PRACTICAL_ORDERS["mu"]
        without_derivative = np.where(kd, np.maximum(mu_low - mu, mu - mu_high), -np.inf)
        orders = np.maximum(np.maximum(lam_low - lam, lam - lam_high), without_derivative)
        return np.asarray(20.0 * np.maximum(orders, LEAST_PROPORTIONAL - np.abs(kp / self._target.c0)))

    def _flatness(self, loop: Complex) -> Real:
        """Decades around the crossover in which the phase stays within FLAT of the wished one."""
        if self.specification.criterion != "flatness":
            return np.zeros(len(loop))
        wished = np.exp(1j * (self.specification.phase_margin - math.pi))
        off = np.abs(np.angle(loop / wished)) - FLAT
        decades = np.log10(self.w / self.specification.crossover)
        return _reach(off, decades) + _reach(off[:, ::-1], -decades[::-1])


def frequency_grid(specification: FrequencySpecification, per_decade: int = POINTS_PER_DECADE) -> Real:
    """A logarithmic grid that reaches three decades past everything named, finer around the crossover [rad/s]."""
    named = [specification.crossover]
    named += [bound.frequency for bound in (specification.t_max, specification.s_max) if bound is not None]
    low, middle, high = (math.log10(w) for w in (min(named), specification.crossover, max(named)))
    far = np.arange(low - 3.0, high + 3.0, 5.0 / per_decade)
    near = np.arange(middle - 1.3, middle + 1.3, 1.0 / per_decade)
    beside = specification.crossover * np.array([0.9, 0.97, 0.99, 1.01, 1.03, 1.1])  # where it may cross again at once
    return np.union1d(10.0 ** np.concatenate([far, near]), [*named, *beside])


def _power(values: Complex) -> Real:
    """|values|^2, without the root that abs() takes."""
    return values.real**2 + values.imag**2


def _worst_db(power: Real) -> Real:
    return 10.0 * np.log10(power.max(axis=1)) if power.shape[1] else np.full(len(power), -np.inf)


def _reach(off: Real, decades: Real) -> Real:
    """How far above zero the first sign change of ``off`` (n, m) lies, between points by a straight line."""
    outside = (off > 0.0) & (decades > 0.0)
    first = np.where(outside.any(axis=1), outside.argmax(axis=1), len(decades) - 1)
    rows = np.arange(len(off))
    before, after = off[rows, first - 1], off[rows, first]
    moved = before - after
    share = np.clip(np.divide(before, moved, out=np.ones_like(before), where=moved != 0.0), 0.0, 1.0)
    return np.asarray(decades[first - 1] + share * (decades[first] - decades[first - 1]))


def _lowest(designs: Designs, merit: Merit, most: int) -> Designs:
    return designs[np.argsort(merit(designs), kind="stable")[:most]]


def _admissible_first(merit: Merit) -> Merit:
    def ranked(designs: Designs) -> Real:
        return np.where(designs.inadmissible > 0.0, INADMISSIBLE + designs.inadmissible, merit(designs))

    return ranked


def _best_of_each(designs: Designs, merit: Merit, kept: int) -> Designs:
    """The lowest merit for each different value of one order (0: lam, 1: mu)."""
    ordered = _lowest(designs, merit, len(designs))
    _, first = np.unique(ordered.orders[:, kept], return_index=True)
    return ordered[first]
