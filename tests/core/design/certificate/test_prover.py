"""Certificates are true: stable loops are proved, others refuted, in agreement with two other ways to tell."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.data import paper_tables
from fopid_core.design.certificate.checker import check
from fopid_core.design.certificate.enclosure import Bounds
from fopid_core.design.certificate.family import Family
from fopid_core.design.certificate.prover import Certification, certify
from fopid_core.design.certificate.subdivision import Effort
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import stability

from ....share import share_of


def proved(process: str, gains: Fopid, bounds: Bounds | None = None, effort: Effort | None = None) -> Certification:
    found = certify(Family.of(read_process(process)), gains, bounds, effort)
    if found.document is not None:
        assert check(found.document) == ""
    return found


def test_the_loops_of_the_paper_are_certified_within_a_thousandth_of_their_peaks() -> None:
    tables = paper_tables()
    for row in [*tables["table3"], *tables["table4_to_7"]][::4]:
        gains = Fopid(*(row[name] for name in ("kp", "ki", "kd", "lam", "mu")))
        exact = margins(Loop(read_process(row["process"]), gains))
        within = proved(row["process"], gains, Bounds(exact.ms * 1.001, exact.mt * 1.001))
        assert within.certified is True, within.reason
        beyond = proved(row["process"], gains, Bounds(ms_max=exact.ms * 0.999))
        assert beyond.certified is False
        assert "max |S| is above" in beyond.reason


@pytest.mark.parametrize(
    ("process", "gains", "zeros"),
    [
        ("1/(s+1)^3", Fopid(8.1), 2),
        ("1/(s-1)", Fopid(0.5), 1),
        ("1/((s-1)(s-2)(s+1))", Fopid(0.1), 2),
        ("1/(s+1)*exp(-20s)", Fopid(3.0), 18),
        ("1/s^1.9", Fopid(1.0, 0.3, 0.0, 0.9), 2),
    ],
)
def test_an_unstable_loop_is_refuted_and_its_poles_are_counted(process: str, gains: Fopid, zeros: int) -> None:
    found = proved(process, gains)
    assert (found.certified, found.document) == (False, None)
    assert stability(Loop(read_process(process), gains)).unstable_poles == zeros
    assert f"{zeros} pole" in found.reason


@pytest.mark.parametrize(
    ("process", "gains", "certified"),
    [
        ("1/s", Fopid(0.0, 0.0), False),  # a pole at the origin
        ("(s+1)/(s+2)*exp(-s)", Fopid(0.9), True),  # neutral, its delayed gain below 1
        ("(s+1)/(s+2)*exp(-s)", Fopid(1.1), False),  # and above
        ("(s+1)/(s+2)*exp(-s)", Fopid(1.0, 0.0, 0.1), False),  # of advanced type
        ("1/(s^2+0.0002s+1)", Fopid(0.1, 0.0, 0.1), True),
        ("1/(s+1)^3", Fopid(8.0), None),  # on the border
        ("1/(s+1)^3", Fopid(8.0 * (1.0 - 1e-9)), True),
        ("1/(s+1)^3", Fopid(8.0 * (1.0 + 1e-9)), False),
        ("1/(s^0.5+1)", Fopid(1.0, 1.0, 0.0, 0.05), True),
        ("1/(10000000000s+1)/(s+1)", Fopid(1e9, 1.0), True),
    ],
)
def test_hard_cases_are_decided_or_said_to_be_undecided(process: str, gains: Fopid, certified: bool | None) -> None:
    found = proved(process, gains)
    assert found.certified is certified, found.reason
    assert certified is not None or found.reason.startswith("not known")


def test_spent_effort_is_no_answer() -> None:
    found = proved("P1", Fopid(1.0, 0.4, 0.5), effort=Effort(attempts=3))
    assert found.certified is None


def test_a_bound_that_is_met_with_equality_at_zero_frequency_is_not_known() -> None:
    assert proved("1/(s+1)", Fopid(1.0, 1.0), Bounds(mt_max=1.0)).certified is None


def random_loop(rng: np.random.Generator) -> tuple[Process, Fopid]:
    """Lags, resonances, fractional, integrating, unstable, with and without delay."""
    lags = "".join(f"({10.0 ** rng.uniform(-2, 2):.4g}s+1)" for _ in range(rng.integers(1, 4)))
    kinds = (
        lags,
        f"(s^2+{10.0 ** rng.uniform(-4, 0):.3g}s+1){lags}",
        f"({10.0 ** rng.uniform(-1, 1):.3g}s^{rng.uniform(0.3, 1.9):.3f}+1)",
        f"s{lags}",
        f"(s-{10.0 ** rng.uniform(-2, 0):.3g}){lags}",
    )
    kind = kinds[rng.integers(len(kinds))]
    zero = rng.choice(["1", f"({rng.uniform(-1, 1):.3g}s+1)"]) if kind != kinds[2] else "1"
    delay = rng.choice(["", f"*exp(-{10.0 ** rng.uniform(-2, 0.5):.3g}s)"])
    process = read_process(f"{zero}/({kind}){delay}")
    kp, ki, kd = 10.0 ** rng.uniform(-1.5, 1.2, 3) * rng.choice([1.0, 1.0, 1.0, 0.0], 3)
    return process, Fopid(kp, ki, kd, rng.uniform(0.2, 1.6), rng.uniform(0.2, 1.6))


def disagreements(count: int, seed: int) -> tuple[list[str], int]:
    """Loops on which certificate and stability test differ, and how many neither decided."""
    rng = np.random.default_rng(seed)
    differ, undecided = [], 0
    for _ in range(count):
        process, gains = random_loop(rng)
        found = certify(Family.of(process), gains, effort=Effort(attempts=4000))
        verdict = stability(Loop(process, gains))
        if found.certified is None:
            undecided += 1
        elif verdict.decided and found.certified is not verdict.stable:
            differ.append(f"{process} {gains}: {found.reason} / {verdict.reason}")
    return differ, undecided


def test_certificates_agree_with_the_stability_test() -> None:
    differ, undecided = disagreements(40, 0)
    assert (differ, undecided <= 2) == ([], True)


@pytest.mark.timeout(600)
@pytest.mark.slow
def test_certificates_agree_with_the_stability_test_on_ten_thousand_loops() -> None:
    loops = share_of(10_000)
    differ, undecided = disagreements(loops, 1)
    assert differ == []
    assert undecided < 0.05 * loops


def test_the_points_of_a_certificate_have_few_digits() -> None:
    found = proved("P1", Fopid(1.0, 0.4, 0.5), Bounds(ms_max=1.5))
    assert found.document is not None
    assert len(found.document) < 2000
