"""A certificate of a box or a ball that somebody changed and sealed anew is accepted only where it is still true.

Changed are numbers, whole subtrees of the proof, parameters, terms of the process and frequencies; what is accepted is
tried on members drawn from the cells that it says are proved, in floating point and without code of the checker.
"""

from __future__ import annotations

import copy
import json
import os
import random
from typing import Any

import numpy as np
import pytest

from fopid_core.design.certificate.checker import check
from fopid_core.design.certificate.ellipsoid import ellipsoid_family
from fopid_core.design.certificate.enclosure import Bounds
from fopid_core.design.certificate.family import Family
from fopid_core.design.certificate.family_text import read_family
from fopid_core.design.certificate.prover import certify
from fopid_core.design.certificate.subdivision import Effort
from fopid_core.model.fopid import Fopid

from .test_checker import corrupted, holds, sealed

CASES = int(os.environ.get("FOPID_CORRUPTIONS", "600"))
MEMBERS = 3
REGIONS: tuple[tuple[Family, Fopid, Bounds], ...] = (
    (read_family("K/(T*s+1)*exp(-L*s)", {"K": (0.5, 2.5), "T": (0.8, 2.0), "L": (0.0, 0.6)}), Fopid(0.8, 0.5),
     Bounds(1.8)),
    (ellipsoid_family("foptd", {"K": 2.0, "T": 3.0, "L": 0.5}, np.diag([0.4, 0.3, 0.01])), Fopid(1.0, 0.35),
     Bounds(1.5)),
    (read_family("K/(T*s-1)", {"K": (0.2, 3.0), "T": (0.5, 4.0)}), Fopid(3.0, 0.5), Bounds(2.0)),
    (read_family("K/(T*s^a+1)*exp(-0.1s)", {"K": (0.5, 2.0), "T": (0.8, 2.0), "a": (1.0, 1.6)}), Fopid(1.0, 0.8),
     Bounds(1.8)),
)  # fmt: skip


def certificate(which: int) -> dict[str, Any]:
    family, gains, bounds = REGIONS[which]
    document = certify(family, gains, bounds, Effort(2500, open_share=0.3)).document
    assert document is not None
    content: dict[str, Any] = json.loads(document)
    return content


def nodes(node: Any, path: tuple[Any, ...] = ("proof",)) -> list[tuple[Any, ...]]:
    """The ways to every cell of a proof."""
    inner = [] if isinstance(node, str) or len(node) < 4 else [*nodes(node[2], (*path, 2)), *nodes(node[3], (*path, 3))]
    return [path, *inner]


def at(content: dict[str, Any], path: tuple[Any, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


def restructured(content: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    """A cell put in another's place, closed, called outside, cut elsewhere, or of other pieces; or another region."""
    changed = copy.deepcopy(content)
    paths = nodes(changed["proof"])
    path, other = chance.choice(paths), chance.choice(paths)
    cell = at(changed, path)
    what = chance.randrange(9)
    if what == 0:
        at(changed, path[:-1])[path[-1]] = copy.deepcopy(at(changed, other))
    elif what == 1:
        at(changed, path[:-1])[path[-1]] = chance.choice(["outside", "open"])
    elif what == 2 and not isinstance(cell, str):
        del cell[1:]
    elif what == 3 and not isinstance(cell, str) and len(cell) == 4:
        cell[2], cell[3] = cell[3], cell[2]
    elif what == 4 and not isinstance(cell, str) and len(cell) == 4:
        cell[1] = float(chance.randrange(len(changed["parameters"])))
    elif what == 5:
        side = chance.choice(changed["parameters"])
        side[chance.randint(1, 2)] += chance.choice([-1.0, -0.1, 0.1, 1.0])
    elif what == 6:
        changed["region"] = "ball" if changed["region"] == "box" else "box"
    elif what == 7 and not isinstance(cell, str) and cell[0]:
        run = chance.choice(cell[0])
        del run[chance.randrange(len(run))]
    else:
        changed["claims"]["share"] = min(1.0, changed["claims"]["share"] * chance.choice([0.5, 1.0001, 2.0]))
    return changed


def closed_cells(node: Any, cell: list[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    if isinstance(node, str):
        return []
    if len(node) == 1:
        return [cell]
    axis = int(node[1])
    low, high = cell[axis]
    halves = (low, 0.5 * (low + high)), (0.5 * (low + high), high)
    parts = [closed_cells(child, [*cell[:axis], half, *cell[axis + 1 :]])
             for child, half in zip(node[2:], halves, strict=True)]  # fmt: skip
    return parts[0] + parts[1]


def member(content: dict[str, Any], point: np.ndarray) -> dict[str, Any]:
    """The certificate's claims for one process of its family, as ``holds`` reads them."""

    def linear(form: list[float]) -> list[float]:
        return [form[0] + float(np.dot(form[1:], point))]

    def size(polynomial: list[list[float]]) -> list[list[float]]:
        return [[sum(row[0] * float(np.prod(point ** np.array(row[1:]))) for row in polynomial)]]

    process = {
        part: [[size(coefficient), linear(order), linear(delay)] for coefficient, order, delay in rows]
        for part, rows in content["process"].items()
    }
    return content | {"process": process}


def false_members(content: dict[str, Any], chance: random.Random) -> list[np.ndarray]:
    cells = closed_cells(content["proof"], [(low, high) for _, low, high in content["parameters"]])
    points = [np.array([chance.uniform(*side) for side in chance.choice(cells)]) for _ in range(MEMBERS)]
    return [x for x in points if (content["region"] == "box" or x @ x <= 1.0) and not holds(member(content, x))]


def accepted_but_false(which: int, count: int, seed: int) -> tuple[list[Any], int]:
    chance, content = random.Random(seed), certificate(which)
    assert check(sealed(content)) == ""
    assert false_members(content, chance) == []
    wrong, accepted = [], 0
    for i in range(count):
        changed = (corrupted if i % 3 == 0 else restructured)(content, chance)
        if check(sealed(changed)) == "":
            accepted += 1
            wrong += [(changed, x) for x in false_members(changed, chance)]
    return wrong, accepted


def test_a_few_changes_of_a_region_are_accepted_only_where_true() -> None:
    wrong, accepted = accepted_but_false(2, 40, 0)
    assert wrong == []
    assert 0 < accepted < 40


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("which", range(len(REGIONS)))
def test_changes_of_regions_are_accepted_only_where_true(which: int) -> None:
    wrong, accepted = accepted_but_false(which, CASES // len(REGIONS), 1)
    assert wrong == []
    assert 0 < accepted < CASES // len(REGIONS)
