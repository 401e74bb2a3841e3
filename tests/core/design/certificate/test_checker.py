"""The checker accepts what the prover proves and nothing else: not a changed file, not a false claim in a new seal."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fopid_core.design.certificate import checker
from fopid_core.design.certificate.checker import check
from fopid_core.design.certificate.enclosure import Bounds
from fopid_core.design.certificate.family import Family
from fopid_core.design.certificate.prover import certify
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process

from ....share import share_of

LOOPS = (
    ("P1", Fopid(2.9692, 0.8028, 1.3394, 1.0138, 0.6074), Bounds(2.2, 1.7, 60.0, 300.0)),
    ("P2", Fopid(0.4, 0.5, 0.3), Bounds(1.6, 1.2)),
    ("2/(3s+1)*exp(-0.7s)", Fopid(1.0, 0.4, 0.2, 0.95, 0.8), Bounds(2.0, 1.5)),
    ("1/(0.8s^2.2+0.5s^0.9+1)", Fopid(1.0, 0.5, 0.8), Bounds(ms_max=3.0)),
    ("1/(s-1)", Fopid(3.0, 1.0), Bounds(ms_max=1.3)),
)


def certificate(which: int = 0) -> dict[str, Any]:
    process, gains, bounds = LOOPS[which]
    found = certify(Family.of(read_process(process)), gains, bounds)
    assert found.certified is True, found.reason
    assert found.document is not None
    content: dict[str, Any] = json.loads(found.document)
    return content


def sealed(content: dict[str, Any]) -> str:
    """With a digest that fits, as somebody would write it who wants to deceive."""
    rest = json.loads(json.dumps({k: v for k, v in content.items() if k != "digest"}), parse_int=float)
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return json.dumps(rest | {"digest": hashlib.sha256(canonical.encode()).hexdigest()})


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The ways to every number and text."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return [place for key, item in items for place in places(item, (*path, key))]
    return [path]


def corrupted(content: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    """One field changed, removed or doubled."""
    changed = copy.deepcopy(content)
    path = chance.choice([place for place in places(changed) if place != ("digest",)])
    parent = changed
    for key in path[:-1]:
        parent = parent[key]
    old = parent[path[-1]]
    what = chance.random()
    if what < 0.1 and isinstance(parent, list):
        del parent[path[-1]]
    elif what < 0.15 and isinstance(parent, list):
        parent.insert(path[-1], old)
    elif isinstance(old, bool) or old is None or isinstance(old, str):
        parent[path[-1]] = chance.choice([None, False, 1.0, "box", -1.0, 1e-3])
    else:
        factor = chance.choice([-1.0, 0.0, 0.5, 2.0, 10.0, 0.1, 1.0 + 10.0 ** -chance.randint(1, 9)])
        parent[path[-1]] = old * factor if old else chance.choice([1.0, -1.0, 1e-6])
    return changed


def holds(content: dict[str, Any]) -> bool:
    """Whether the claims are true, by floating point and another count of zeros: the phase of 1 + L on a fine grid."""
    kp, ki, kd, lam, mu = content["gains"]
    claims = content["claims"]

    def value(rows: list[Any], s: Any) -> Any:
        return sum(row[0][0][0] * s ** row[1][0] * np.exp(-row[2][0] * s) for row in rows)

    w = np.geomspace(1e-9, 1e9, 90_001)
    s = 1j * w
    with np.errstate(all="ignore"):
        controller = kp + ki * s**-lam + kd * s**mu
        numerator, denominator = (value(content["process"][part], s) for part in ("numerator", "denominator"))
        forward = controller * numerator
        f = denominator + forward
        # Where the delay turns by more than the grid resolves, the loop gain is small: 1 + L then turns by little.
        turned = np.unwrap(np.angle(denominator)) + np.unwrap(np.angle(f / denominator))
        # Zeros to the right: the phase at high frequency less that which f has there without any.
        decade = w.size // 18
        rises = np.log10(np.abs(f[-1]) / np.abs(f[-1 - decade]))
        falls = np.log10(np.abs(f[decade]) / np.abs(f[0]))
        zeros = (rises - falls) / 2.0 - (turned[-1] - turned[0]) / math.pi
        peaks = np.abs(denominator / f), np.abs(forward / f), np.abs(controller * denominator / f)
    band = w <= (claims["noise_band"] or math.inf)
    bounds = (claims["ms_max"], claims["mt_max"], claims["noise_max"])
    within = all(b is None or np.max(p[band] if i == 2 else p) <= b * (1 + 1e-9)
                 for i, (b, p) in enumerate(zip(bounds, peaks, strict=True)))  # fmt: skip
    return bool(abs(zeros) < 0.05 and within)


@pytest.mark.parametrize("which", range(len(LOOPS)))
def test_a_certificate_is_accepted_however_its_json_is_written(which: int) -> None:
    content = certificate(which)
    assert check(json.dumps(content, indent=2)) == ""
    assert check(json.dumps(dict(reversed(content.items())))) == ""
    assert holds(content)


def test_every_changed_file_is_rejected() -> None:
    chance = random.Random(0)
    content = certificate()
    for _ in range(2000):
        changed = corrupted(content, chance)
        if changed != content:
            assert check(json.dumps(changed)), changed


def test_a_changed_file_with_a_new_seal_is_accepted_only_where_it_is_true() -> None:
    chance = random.Random(1)
    content = certificate()
    assert accepted_but_false(content, chance, 30) == []


def accepted_but_false(content: dict[str, Any], chance: random.Random, count: int) -> list[dict[str, Any]]:
    changes = [corrupted(content, chance) for _ in range(count)]
    accepted = [changed for changed in changes if check(sealed(changed)) == ""]
    return [changed for changed in accepted if not holds(changed)]


@pytest.mark.timeout(600)
@pytest.mark.slow
def test_ten_thousand_corruptions_are_rejected_and_with_a_new_seal_only_true_ones_pass() -> None:
    chance = random.Random(2)
    contents = [certificate(which) for which in range(len(LOOPS))]
    for _ in range(share_of(10_000)):
        content = chance.choice(contents)
        changed = corrupted(content, chance)
        assert changed == content or check(json.dumps(changed)), changed
    for content in contents:
        assert accepted_but_false(content, chance, share_of(2000)) == []


@pytest.mark.parametrize(
    "change",
    [
        {"gains": [9.0, 0.0, 0.0, 1.0, 1.0]},
        {"claims": {"ms_max": 2.1}},
        {"claims": {"mt_max": 1.5}},
        {"claims": {"noise_max": 30.0}},
        {"claims": {"noise_band": None}},
        {"claims": {"stable": False}},
        {"claims": {"share": 1.1}},
        {"precision": 20.0},
        {"region": "ball of another kind"},
        {"proof": "open"},
        {"proof": "outside"},
        {"proof": [[]]},
        {"proof": [[[0.0, 1.0]]]},
        {"proof": [[[0.0, "inf"]]]},
        {"more": 1.0},
    ],
)
def test_a_false_or_empty_proof_is_rejected_whatever_its_seal(change: dict[str, Any]) -> None:
    content = certificate()
    for name, value in change.items():
        content[name] = content[name] | value if isinstance(value, dict) else value
    assert check(sealed(content))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "1",
        '{"format": "fopid certificate 1"}',
        '{"a": NaN}',
        "[" * 100_000,
        "\x00",
        '{"a": 1e999}',
    ],
)
def test_what_is_no_certificate_is_rejected_without_a_traceback(text: str) -> None:
    assert check(text)


def test_a_field_that_is_given_twice_is_rejected() -> None:
    text = json.dumps(certificate())
    assert check(text.replace('"gains"', '"gains": [0.0, 0.0, 0.0, 1.0, 1.0], "gains"', 1))


def test_the_checker_is_short_and_stands_on_nothing_of_ours() -> None:
    source = Path(checker.__file__).read_text(encoding="utf-8")
    assert len(source.splitlines()) < 300
    assert "fopid_core" not in source
