"""Margins and certificates share no code: each exact Ms and Mt is proved, and one part in half a million less refuted.

``FOPID_LOOPS=10000 python -m pytest -m slow tests/core/design/certificate/test_agreement.py`` runs that many loops.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator

import pytest

from fopid_core.design.certificate.enclosure import Bounds
from fopid_core.design.certificate.family import Family
from fopid_core.design.certificate.prover import certify
from fopid_core.design.certificate.subdivision import Effort
from fopid_core.model.margins import margins
from fopid_core.model.stability import stability

from ....share import share_of
from ...model.random_loops import Generator, RandomLoop

LOOPS = int(os.environ.get("FOPID_LOOPS") or share_of(220))
BESIDE = 2e-6
"""Twice the error that a peak may have."""
EFFORT = Effort(3000)


def disagreements(case: RandomLoop) -> Iterator[str]:
    """Where a proof says otherwise than the numbers; nothing where either does not know."""
    loop = case.loop
    family, verdict = Family.of(loop.process), stability(loop)
    proved = certify(family, loop.controller, effort=EFFORT)
    if verdict.decided and proved.certified not in (None, verdict.stable):
        yield f"{case}: {verdict.reason}; proved: {proved.reason}"
    if not (verdict.decided and verdict.stable):
        return
    found = margins(loop)
    for name, peak in (("ms_max", found.ms), ("mt_max", found.mt)):
        if math.isfinite(peak):
            above, below = (
                certify(family, loop.controller, Bounds(**{name: peak * factor}), EFFORT).certified
                for factor in (1.0 + BESIDE, 1.0 - BESIDE)
            )
            if above is False or below is True:
                yield f"{case}: {name} {peak!r}; {BESIDE:g} more proved: {above}, less: {below}"


def test_peaks_and_stability_agree_with_proofs() -> None:
    assert not [text for case in Generator(7).loops(5) for text in disagreements(case)]


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_peaks_and_stability_of_all_kinds_of_loops_agree_with_proofs() -> None:
    assert not [text for case in Generator(4242).loops(LOOPS) for text in disagreements(case)]
