"""Subdivision of frequency, and of a box of parameters, until every piece is proved or shown to fail.

A cell of the parameters inherits what was proved for the cell it is a part of: only frequencies that are still open are
looked at again. The largest open cell comes first.
"""

from __future__ import annotations

import heapq
import itertools
import math
import time
from dataclasses import dataclass, field
from fractions import Fraction

from fopid_core.design.certificate.enclosure import Attempt, Cell, CellEnclosure, LoopEnclosure
from fopid_core.design.certificate.family import BALL

CLOSED, SPLIT, OPEN, OUTSIDE, FAILED = "closed", "split", "open", "outside", "failed"
_FIRST_RATIO = math.exp(1.5)
_NARROWEST = 1e-12  # of a piece: its ends differ by this share
_LADDER = (*(1.5**k for k in range(20)), *(10.0**k for k in range(4, 20)), *(10.0**k for k in range(20, 301, 10)))
_LOWEST_LOOK, _HIGHEST_LOOK = 1e-3, 1e3  # [rad/s], where an end of the axis cannot be proved for a whole cell
_MOST_VOTES = 10.0
_FLAT_ANGLE = 3.14


@dataclass(frozen=True)
class Piece:
    """An interval of frequency that is proved, and a direction whose half-plane f keeps to on it."""

    low: float
    high: float
    direction: complex


@dataclass
class Node:
    """A cell of the parameters and how far its proof is.

    Attributes
    ----------
    cell : Cell
    inherited : list of Piece
        Proved for a larger cell.
    todo : list of (low, high)
        Frequencies still open; 0 and inf for the ends.
    own : list of Piece
    state : str
        ``open``, ``closed``, ``split``, ``outside`` (of the ball), or ``failed``: unstable or a bound broken all over.
    zeros : int
        Of f in the right half-plane, where the pieces cover all frequencies.
    broken : list of (frequency, function)
        Bounds broken in the middle of the cell, for certain.
    """

    cell: Cell
    inherited: list[Piece]
    todo: list[tuple[float, float]]
    own: list[Piece] = field(default_factory=list)
    state: str = OPEN
    zeros: int = 0
    broken: list[tuple[float, int]] = field(default_factory=list)
    axis: int = 0
    children: tuple[Node, ...] = ()
    votes: list[float] = field(default_factory=list)

    @property
    def volume(self) -> Fraction:
        """Of the cell; 1 without parameters."""
        return math.prod((high - low for low, high in self.cell), start=Fraction(1))

    @property
    def middle(self) -> tuple[float, ...]:
        """Of the cell."""
        return tuple(float((low + high) / 2) for low, high in self.cell)


@dataclass(frozen=True)
class Subdivision:
    """The outcome.

    Attributes
    ----------
    root : Node
    closed, failed, open : float
        Shares of the box (or of the ball, its border included) that are proved to hold, proved to fail, and open.
    counterexample : Node or None
        A cell whose middle fails for certain.
    attempts : int
        Pieces looked at.
    """

    root: Node
    closed: float
    failed: float
    open: float
    counterexample: Node | None
    attempts: int


@dataclass(frozen=True)
class Effort:
    """When to give up.

    Attributes
    ----------
    attempts : int
        Pieces looked at.
    seconds : float
    open_share : float
        Of what did not fail: so much may stay open, once something has failed.
    """

    attempts: int = 20_000
    seconds: float = math.inf
    open_share: float = 0.0


class Subdivider:
    """Proves a loop piece by piece."""

    def __init__(self, loop: LoopEnclosure, effort: Effort) -> None:
        self._loop, self._effort = loop, effort
        self._band = loop.bounds.noise_band or math.inf
        self._deadline = time.monotonic() + effort.seconds
        self._attempts = 0

    def run(self) -> Subdivision:
        """Subdivide until all is decided or the effort is spent."""
        family = self._loop.family
        cell = tuple((Fraction(repr(low)), Fraction(repr(high))) for low, high in family.sides)
        root = Node(cell, [], [(0.0, math.inf)])
        total = root.volume
        volumes = dict.fromkeys((CLOSED, FAILED, OUTSIDE), Fraction(0))
        counterexample: Node | None = None
        heap: list[tuple[Fraction, int, Node]] = [(-total, 0, root)]
        pushed = 0
        while heap and not self._spent():
            left = total - sum(volumes.values())
            if counterexample and left <= Fraction(self._effort.open_share) * (left + volumes[CLOSED]):
                break
            _, _, node = heapq.heappop(heap)
            self._work(node)
            member = family.region != BALL or sum(x * x for x in node.middle) <= 1.0
            if counterexample is None and member and (node.broken or node.zeros):
                counterexample = node
            if node.state in volumes:
                volumes[node.state] += node.volume
                continue
            if not cell:
                break
            self._split(node, root)
            for child in node.children:
                pushed += 1
                heapq.heappush(heap, (-child.volume, pushed, child))
        inside = max(float(total - volumes[OUTSIDE]), 1e-300)
        closed, failed = float(volumes[CLOSED]) / inside, float(volumes[FAILED]) / inside
        return Subdivision(root, closed, failed, max(1.0 - closed - failed, 0.0) if volumes[CLOSED] + volumes[FAILED]
                           < total - volumes[OUTSIDE] else 0.0, counterexample, self._attempts)  # fmt: skip

    def _spent(self) -> bool:
        return self._attempts >= self._effort.attempts or time.monotonic() >= self._deadline

    def _split(self, node: Node, root: Node) -> None:
        """In two halves, across the parameter that spoils most; one that is narrow already gives way to others."""
        votes = node.votes if any(node.votes) else [1.0] * len(node.cell)
        widths = [float((b - a) / (d - c)) for (a, b), (c, d) in zip(node.cell, root.cell, strict=True)]
        node.axis = max(range(len(widths)), key=lambda i: votes[i] * widths[i])
        low, high = node.cell[node.axis]
        halves = ((low, (low + high) / 2), ((low + high) / 2, high))
        cells = [(*node.cell[: node.axis], half, *node.cell[node.axis + 1 :]) for half in halves]
        node.state = SPLIT
        node.children = tuple(Node(cell, [*node.inherited, *node.own], list(node.todo)) for cell in cells)

    def _work(self, node: Node) -> None:
        if self._loop.family.region == BALL and _nearest(node.cell) > 1:
            node.state = OUTSIDE
            return
        over = self._loop.over(node.cell)
        stack, left = list(reversed(node.todo)), []
        node.votes = [0.0] * len(node.cell)
        while stack:
            low, high = stack.pop()
            if self._spent() or node.broken:
                left.append((low, high))
            elif low < self._band < high < math.inf:
                stack += [(self._band, high), (low, self._band)]
            elif low == 0.0 or high == math.inf:
                stack += self._ends(over, node, low, high, left)
            else:
                stack += self._piece(over, node, low, high, left)
        node.todo = left
        if not left:
            self._close(over, node)
        elif any(over.broken_all_over(frequency, which) for frequency, which in node.broken):
            node.state = FAILED

    def _ends(
        self, over: CellEnclosure, node: Node, low: float, high: float, left: list[tuple[float, float]]
    ) -> list[tuple[float, float]]:
        """The piece at the origin and the one to infinity; what is between them is left to do."""
        first, last = low, high
        if low == 0.0:
            tries = [w for w in (min(high, 1.0) / x for x in _LADDER) if w > 1e-300]
            first = next((w for w in tries if self._closes(over.origin(w), node, 0.0, w)), 0.0)
        if high == math.inf:
            tries = [w for w in (max(low, first, 1.0) * x for x in _LADDER) if w < 1e300]
            last = next((w for w in tries if self._closes(over.tail(w), node, w, math.inf)), math.inf)
        inner_low = first or min(_LOWEST_LOOK, high)
        inner_high = last if last < math.inf else max(_HIGHEST_LOOK, low)
        if low == 0.0 and first == 0.0:
            left.append((0.0, inner_low))
        if high == math.inf and last == math.inf:
            left.append((inner_high, math.inf))
        return _cut(inner_low, inner_high) if inner_low < inner_high else []

    def _closes(self, attempt: Attempt, node: Node, low: float, high: float) -> bool:
        self._attempts += 1
        if attempt.closed:
            node.own.append(Piece(low, high, attempt.direction))
        return attempt.closed

    def _piece(
        self, over: CellEnclosure, node: Node, low: float, high: float, left: list[tuple[float, float]]
    ) -> list[tuple[float, float]]:
        attempt = over.attempt(low, high)
        if self._closes(attempt, node, low, high):
            return []
        if attempt.broken is not None:
            node.broken.append((math.sqrt(low) * math.sqrt(high), attempt.broken))
            left.insert(0, (low, high))  # where it is worst the parts of the cell are looked at first
        for i, drift in enumerate(attempt.drifts[1:]):
            node.votes[i] += min(drift, _MOST_VOTES)
        by_frequency, *by_parameters = attempt.drifts or (math.inf,)
        middle = _between(low, high)
        if attempt.broken is not None:
            return []
        if middle is None or (by_parameters and not by_frequency > max(by_parameters)):
            left.append((low, high))
            return []
        return [(middle, high), (low, middle)]

    def _close(self, over: CellEnclosure, node: Node) -> None:
        """Count the zeros: the pieces cover all frequencies."""
        chain = sorted([*node.inherited, *node.own], key=lambda piece: piece.low)
        top = over.top_order() * math.pi / 2.0
        sign = 1.0 if (chain[-1].direction * complex(math.cos(top), -math.sin(top))).real > 0 else -1.0
        directions = [piece.direction for piece in chain[:-1]] + [sign * complex(math.cos(top), math.sin(top))]
        angles = [_angle(b * a.conjugate()) for a, b in itertools.pairwise(directions)]
        if max(map(abs, angles), default=0.0) > _FLAT_ANGLE:
            return
        node.zeros = round((top - sum(angles)) / math.pi)
        node.state = CLOSED if node.zeros == 0 else FAILED


def _nearest(cell: Cell) -> Fraction:
    return sum((max(low, -high, Fraction(0)) ** 2 for low, high in cell), start=Fraction(0))


def _angle(value: complex) -> float:
    return math.atan2(value.imag, value.real)


def _between(low: float, high: float) -> float | None:
    """About the geometric mean, in few digits; None when there is no room."""
    if high - low <= _NARROWEST * high:
        return None
    middle = math.sqrt(low) * math.sqrt(high)
    ratio = high / low - 1.0
    digits = max(2, 2 - math.floor(math.log10(ratio))) if ratio < 10.0 else 2
    rounded = float(f"{middle:.{digits}g}")
    return rounded if low < rounded < high else middle


def _cut(low: float, high: float) -> list[tuple[float, float]]:
    """A chain of intervals, the last first."""
    count = max(1, math.ceil(math.log(high / low) / math.log(_FIRST_RATIO)))
    step = (math.log(high) - math.log(low)) / count
    points = [low, *(float(f"{low * math.exp(step * k):.3g}") for k in range(1, count)), high]
    return list(reversed(list(itertools.pairwise(points))))
