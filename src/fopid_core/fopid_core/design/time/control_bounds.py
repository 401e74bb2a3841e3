"""What the control after a unit setpoint step leaves to the bounds on its size and on its moves, in a search.

Behind a delay nothing comes back until it ends, so that the control up to there is known without a transform. Where it
grows until then it has a kink there, most likely its peak, which no even grid of instants shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fopid_core.design.control_peak import first_control, open_control, open_move
from fopid_core.design.time.bands import least_in_bands
from fopid_core.design.time.search_response import ResponseGrid
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.verification import SMOOTH_TICKS

Real = NDArray[np.float64]

BANDS = 12
"""A largest value counts as one for each of so many bands of instants."""
SAFE_CONTROL, SAFE_AT_REST = 1e-3, 0.5
"""Share of a bound that is kept clear of, since the grid of instants shows the control less exactly; and of what the
bound leaves above the control that holds the setpoint, which every controller with integral action comes to."""
SMOOTHED = 4
"""First instants at which the control signal of a search is not to be believed."""


class ControlBounds:
    """The bounds on the control of many controllers.

    Parameters
    ----------
    grid : ResponseGrid
    specification : TimeSpecification
    delay : float
        Of the process [s].
    drawn_in : tuple of float
        Shares of the bounds on size and moves that are kept clear of besides.
    """

    def __init__(
        self, grid: ResponseGrid, specification: TimeSpecification, delay: float, drawn_in: tuple[float, float]
    ) -> None:
        self._grid, self._bounds = grid, specification
        size, self._safe_move = drawn_in[0], SAFE_CONTROL + drawn_in[1]
        room = 1.0 - grid.control_at_rest / specification.u_max
        self._safe_size = size + (min(SAFE_CONTROL, SAFE_AT_REST * room) if room > 0.0 else SAFE_CONTROL)
        smooth = SMOOTH_TICKS * specification.sample_time
        self._ends = np.array([smooth, delay] if delay > smooth else [])
        """Between these instants a control that nothing comes back to is known; it is largest at one of them."""
        self._open = np.flatnonzero(grid.time <= delay) if len(self._ends) else np.zeros(0, dtype=np.intp)

    def running(self, gains: Real) -> Real:
        """The control on the grid, shape (n, instants), its first instant that of the controller as it runs."""
        controls = self._grid.controls(gains)
        controls[:, 1:SMOOTHED] = controls[:, SMOOTHED : SMOOTHED + 1]
        controls[:, 0] = self._first(gains)
        return controls

    def largest(self, gains: Real) -> Real:
        """Peak of the control, shape (n,), of the controller as it runs."""
        sizes = np.concatenate([self._first(gains)[:, None], self._known(gains), self._later(gains)], axis=1)
        return np.asarray(np.abs(sizes).max(axis=1))

    def later_breaks(self, gains: Real) -> bool:
        """Whether the control of one controller comes too near its bound after its first instants."""
        later = np.concatenate([self._known(gains[None]), self._later(gains[None])], axis=1)
        return bool(np.abs(later).max() > self._bounds.u_max * (1.0 - self._safe_size))

    def size_slack(self, gains: Real, watch: bool) -> list[Real]:
        """What is left to the bound on its size: of the first control, and if ``watch`` of all later ones."""
        u_max = self._bounds.u_max
        blocks = [1.0 - np.abs(self._first(gains))[:, None] / u_max]
        if watch:
            blocks.append(1.0 - np.abs(self._known(gains)) / u_max)
            later = least_in_bands(-np.abs(self._later(gains)) / u_max, self._grid.time[SMOOTHED:], BANDS)
            blocks.append(1.0 - self._safe_size + later)
        return blocks

    def move_slack(self, gains: Real) -> list[Real]:
        """The same of the bound on its moves per second."""
        rate_max, time = self._bounds.rate_max, self._grid.time
        first = 1.0 - np.abs(self._first(gains)) / (rate_max * self._bounds.sample_time)
        known = 1.0 - np.abs(open_move(gains, self._ends)) / rate_max
        moves = np.diff(self._later(gains), axis=1) / (time[1] * rate_max)
        later = 1.0 - self._safe_move + least_in_bands(-np.abs(moves), time[SMOOTHED + 1 :], BANDS)
        return [first[:, None], known, later]

    def _first(self, gains: Real) -> Real:
        return first_control(gains, self._bounds.sample_time)

    def _known(self, gains: Real) -> Real:
        """Where nothing comes back and it may be largest, shape (n, 2), or (n, 0) without a delay."""
        return open_control(gains, self._ends)

    def _later(self, gains: Real) -> Real:
        """On the grid from where it is to be believed, shape (n, instants)."""
        controls = self._grid.controls(gains)
        if len(self._open):
            controls[:, self._open] = open_control(gains, np.maximum(self._grid.time[self._open], self._ends[0]))
        return controls[:, SMOOTHED:]
