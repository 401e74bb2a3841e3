"""Certificates for boxes: nothing in what is certified fails, and little of what holds is left out.

The oracle samples the parameters and evaluates the process as a formula: |S| and |T| on a fine grid of frequencies, and
the winding of 1 + L, vectorised and without anything of the prover.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fopid_core.design.certificate.checker import check
from fopid_core.design.certificate.enclosure import Bounds
from fopid_core.design.certificate.family_text import read_family
from fopid_core.design.certificate.prover import Certification, certify
from fopid_core.design.certificate.subdivision import Effort
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid

Sides = dict[str, tuple[float, float]]
Formula = Callable[..., Any]

BOXES: list[tuple[str, Formula, Sides, Fopid, Bounds]] = [
    ("K/(T*s+1)*exp(-L*s)", lambda s, K, T, L: (K * np.exp(-L * s), T * s + 1),
     {"K": (0.5, 2.5), "T": (0.8, 2.0), "L": (0.2, 0.6)}, Fopid(0.8, 0.5), Bounds(1.8)),
    ("K/(T*s+1)*exp(-L*s)", lambda s, K, T, L: (K * np.exp(-L * s), T * s + 1),
     {"K": (0.5, 3.0), "T": (1.0, 2.0), "L": (0.2, 0.8)}, Fopid(1.0, 0.6, 0.2), Bounds()),
    ("K/(T*s+1)^3", lambda s, K, T: (K, (T * s + 1) ** 3),
     {"K": (0.5, 3.0), "T": (0.5, 3.0)}, Fopid(1.0, 0.6, 0.5), Bounds(2.0)),
    ("K/(T*s^a+1)*exp(-0.1s)", lambda s, K, T, a: (K * np.exp(-0.1 * s), T * s**a + 1),
     {"K": (0.5, 2.0), "T": (0.8, 2.0), "a": (1.0, 1.6)}, Fopid(1.0, 0.8), Bounds(1.8)),
    ("K/(s^2+a1*s+a0)", lambda s, K, a1, a0: (K, s**2 + a1 * s + a0),
     {"K": (0.5, 4.0), "a1": (0.2, 2.0), "a0": (0.5, 2.0)}, Fopid(0.6, 0.5, 0.3, 0.9, 0.8), Bounds(2.0)),
    ("K/(s*(T*s+1))*exp(-L*s)", lambda s, K, T, L: (K * np.exp(-L * s), s * (T * s + 1)),
     {"K": (0.5, 2.0), "T": (0.2, 1.0), "L": (0.1, 0.5)}, Fopid(0.5, 0.02, 0.2), Bounds(2.0)),
    ("K/(T*s-1)", lambda s, K, T: (K, T * s - 1), {"K": (0.2, 3.0), "T": (0.5, 4.0)}, Fopid(3.0, 0.5), Bounds(2.0)),
    ("(b*s+1)/((s+1)*(T*s+1))", lambda s, b, T: (b * s + 1, (s + 1) * (T * s + 1)),
     {"b": (-1.5, 1.0), "T": (0.2, 3.0)}, Fopid(0.8, 0.5), Bounds(1.7)),
    ("9K/((s+1)*(s^2+2z*s+9))", lambda s, K, z: (9 * K, (s + 1) * (s**2 + 2 * z * s + 9)),
     {"K": (0.2, 2.0), "z": (0.2, 3.0)}, Fopid(0.5, 0.5, 0.2), Bounds(1.8, 1.2)),
    ("1/(s+1)^2*exp(-L*s)", lambda s, L: (np.exp(-L * s), (s + 1) ** 2 + 0 * L),
     {"L": (0.05, 2.0)}, Fopid(1.2, 0.8, 0.4, 1.05, 0.9), Bounds(2.0)),
]  # fmt: skip


def proved(which: int, attempts: int) -> Certification:
    source, _, sides, gains, bounds = BOXES[which]
    return certify(read_family(source, sides), gains, bounds, Effort(attempts, open_share=0.04))


def closed_cells(node: Any, cell: list[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """The cells that a certificate proves, read from its tree."""
    if node in ("open", "outside"):
        return []
    if len(node) == 1:
        return [cell]
    axis = int(node[1])
    low, high = cell[axis]
    middle = 0.5 * (low + high)
    halves = [[*cell[:axis], half, *cell[axis + 1 :]] for half in ((low, middle), (middle, high))]
    return closed_cells(node[2], halves[0]) + closed_cells(node[3], halves[1])


def holds(which: int, points: np.ndarray) -> np.ndarray:
    """Which rows of parameters, shape (n, p), give a stable loop within the bounds."""
    _, formula, _, gains, bounds = BOXES[which]
    w = np.geomspace(1e-4, 1e4, 700)
    s = 1j * w
    numerator, denominator = formula(s, *(column[:, None] for column in points.T))
    opened = s**gains.lam * denominator
    forward = (gains.kp * s**gains.lam + gains.ki + gains.kd * s ** (gains.lam + gains.mu)) * numerator
    closed = opened + forward
    # Without zeros to the right the phase turns by a right angle for each order of the function.
    order = np.log10(np.abs(opened[:, -1] / opened[:, -88])) / np.log10(w[-1] / w[-88])
    turn = np.unwrap(np.angle(closed), axis=1)
    good = np.abs(order / 2.0 - (turn[:, -1] - turn[:, 0]) / math.pi) < 0.3
    peaks = np.abs(opened / closed), np.abs(forward / closed)
    for bound, peak in zip((bounds.ms_max, bounds.mt_max), peaks, strict=True):
        if bound is not None:
            good &= peak.max(axis=1) <= bound
    return np.asarray(good)


def check_box(which: int, attempts: int, samples: int) -> None:
    found = proved(which, attempts)
    _, _, sides, _, _ = BOXES[which]
    assert found.document is not None, found.reason
    assert check(found.document) == ""
    rng = np.random.default_rng(which)
    cells = np.array(closed_cells(json.loads(found.document)["proof"], list(sides.values())))
    volumes = np.prod(cells[:, :, 1] - cells[:, :, 0], axis=1)
    chosen = cells[rng.choice(len(cells), samples, p=volumes / volumes.sum())]
    low, high = np.array(list(sides.values())).T
    whole = low + (high - low) * rng.random((min(samples, 20_000), len(low)))
    inside = chosen[:, :, 0] + (chosen[:, :, 1] - chosen[:, :, 0]) * rng.random(chosen.shape[:2])
    for part in np.array_split(inside, max(1, samples // 2000)):
        assert holds(which, part).all(), part[~holds(which, part)][:3]
    true = np.concatenate([holds(which, part) for part in np.array_split(whole, 20)]).mean()
    assert found.certified_share == pytest.approx(volumes.sum() / np.prod(high - low))
    assert found.certified_share >= 0.9 * true - 3.0 * math.sqrt(0.25 / len(whole))
    assert (found.certified is True) == (true == 1.0)


def test_a_box_is_certified_where_it_holds() -> None:
    check_box(9, 20_000, 500)


@pytest.mark.timeout(600)
@pytest.mark.long
@pytest.mark.parametrize("which", range(len(BOXES)))
def test_ten_boxes_are_certified_for_nine_tenths_of_what_holds_and_a_million_samples_agree(which: int) -> None:
    check_box(which, 40_000, 100_000)


def test_a_whole_box_is_certified() -> None:
    family = read_family("K/(T*s+1)*exp(-L*s)", {"K": (0.8, 1.2), "T": (0.8, 1.2), "L": (0.2, 0.3)})
    found = certify(family, Fopid(1.0, 1.0, 0.2), Bounds(2.0))
    assert (found.certified, found.certified_share) == (True, 1.0)
    assert found.reason.endswith("everywhere in the region")


@pytest.mark.parametrize(
    ("source", "name", "side"),
    [
        ("1/(s+1)*exp(-L*s)", "L", (0.0, 0.3)),
        ("(b*s+1)/(s+1)^2", "b", (-0.3, 0.3)),
        ("(1+b^2*s)/(s+1)^2", "b", (-1.0, 0.5)),
    ],
)
def test_a_side_may_begin_at_zero_or_reach_across_it(source: str, name: str, side: tuple[float, float]) -> None:
    found = certify(read_family(source, {name: side}), Fopid(0.5, 0.3), Bounds(2.0))
    assert (found.certified, found.reason) == (True, "stable, max |S| <= 2, everywhere in the region")


def test_names_may_stand_in_the_text_or_come_from_the_template() -> None:
    sides = {"K": (1.0, 2.0), "L": (0.1, 0.2)}
    written, implied = read_family("K/(3*s+1)*exp(-Ls)", sides), read_family("1.5/(3s+1)*exp(-0.2s)", sides)
    assert str(written.at((1.5, 0.2))) == str(implied.at((1.5, 0.2))) == "1.5/(3 s + 1) * exp(-0.2s)"
    assert str(read_family("P1", {"K": (2.0, 2.0), "L": (0.0, 1.0)}).at((0.5,))).startswith("2/(s^3")


@pytest.mark.parametrize(
    ("source", "sides", "said"),
    [
        ("K/(T*s+1)", {"K": (1.0, 2.0)}, "character 4: does not fit here; allowed: the names K"),
        ("K/(s+1)", {"K": (1.0, 2.0), "T": (1.0, 2.0)}, "has no such name; allowed: K"),
        ("1/(s+1)^3", {"T": (1.0, 2.0)}, "has no such name; allowed: K, L"),
        ("K/(s+1)", {"K": (2.0, 1.0)}, "the lower one first"),
        ("K*s^2/(s+1)", {"K": (1.0, 2.0)}, "not proper"),
        ("1/(s+1)*exp(L*s)", {"L": (1.0, 2.0)}, "future"),
        ("1/(s+1)*exp(-L*L*s)", {"L": (1.0, 2.0)}, "linear"),
        ("1/(s+1)^a", {"a": (1.0, 2.0)}, "whole number"),
    ],
)
def test_a_box_that_cannot_be_read_is_named(source: str, sides: Sides, said: str) -> None:
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        read_family(source, sides)
