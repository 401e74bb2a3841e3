"""How often gains are held to what a record shows without a model: sound ones refused, bad ones stopped.

    python -m tests.core.design.response_verification_campaign [--records 60] [--seed 0]

Records as in the campaign of the frequency response, and each kind with a step of a load as well. On each, what
`identify` learns where it accepts that, and models that are wrong on purpose: a third of the true gain, the lags
without their delay, one lag with delay whatever the process is. For each, loops with PI and PID that are sound on it
(max |S| at most 1.8); the true process says which of them are sound (2.2) and which are bad (3, or unstable).
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.response_verification import held_to_record
from fopid_core.design.robust_verification import behind_hold
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER

from .identification.frequency_response_campaign import KINDS, NOISES, Sample, record

ON_MODEL, SOUND, MS_MAX, BAD = 1.8, 2.2, 2.5, 3.0
"""max |S| of the loops on the model, of a sound one, what gains are held to, and of a bad one."""
LOOPS, TRIES = 6, 40
LEARNT = "learnt"


def ms(process: Process, gains: Fopid, hold: float) -> float:
    """max |S| behind a hold; infinite for an unstable loop."""
    (held,) = behind_hold((process,), hold)
    loop = Loop(held, gains)
    return margins(loop, jitter=False).ms if stability(loop).stable else math.inf


def loops(process: Process, hold: float, rng: np.random.Generator) -> Iterator[Fopid]:
    """PI and PID loops that are sound on a process."""
    w = np.geomspace(1e-3, 1.0, 400) * math.pi / hold
    response = np.asarray(process(1j * w))
    late = np.unwrap(np.angle(response / np.sign(response[0].real or 1.0)))
    made = 0
    for _ in range(TRIES):
        at = int(np.argmax(late <= -rng.uniform(0.5, 2.6)))
        kp = rng.uniform(0.2, 1.2) / abs(response[at])
        kd = kp / w[at] * float(rng.choice([0.0, rng.uniform(0.0, 0.4)]))
        gains = Fopid(kp, kp * w[at] * rng.uniform(0.1, 0.5), kd)
        if ms(process, gains, hold) <= ON_MODEL:
            yield gains
            made += 1
        if made == LOOPS:
            return


def models(signals: Record, true: Sample, *, identified: bool) -> Iterator[tuple[str, Any]]:
    """What is learnt, and what is wrong on purpose, with the name of each."""
    found = identify(signals) if identified else None
    if found is not None and found.success:
        yield LEARNT, found.best
    top, bottom = true.numerator, true.denominator
    yield (
        "gain",
        SimpleNamespace(
            fit_pct=95.0, process=read_process(replace(true, numerator=[c / 3.0 for c in top]).text), loads=()
        ),
    )
    if true.delay:
        yield "delay", SimpleNamespace(fit_pct=95.0, process=read_process(replace(true, delay=0.0).text), loads=())
    if identified and len(bottom) > 2:
        simple = identify(signals, "foptd")
        if simple.best is not None:
            yield "one lag", simple.best


def with_load(signals: Record, true: Sample, size: float) -> Record:
    """An open-loop record beside the answer to a step of a load in its middle."""
    from .identification.recorded import open_loop

    felt = size * (np.arange(signals.time.size) >= signals.time.size // 2)
    answer = open_loop(true.text, felt, signals.sample_time).measurement
    return replace(signals, measurement=signals.measurement + answer)


def judged(signals: Record, true: Sample, seed: int, *, identified: bool = True) -> Counter[tuple[str, str]]:
    """How many loops of each model are sound, bad or between, and how many of each were stopped."""
    rng, h, counts = np.random.default_rng(seed), signals.sample_time, Counter[tuple[str, str]]()
    process = read_process(true.text)
    for name, model in models(signals, true, identified=identified):
        doubt, judge = held_to_record(signals, model, MS_MAX)
        counts[name, "records"] += 1
        counts[name, "contradicted"] += bool(doubt)
        for gains in loops(model.process, h, rng):
            truth = ms(process, gains, h)
            kind = "sound" if truth <= SOUND else "bad" if truth >= BAD else "between"
            counts[name, kind] += 1
            counts[name, f"{kind} stopped"] += bool(judge(gains, NO_FILTER))
    return counts


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    counts = Counter[tuple[str, str]]()
    for seed in range(asked.seed, asked.seed + asked.records):
        signals, true = record(KINDS[seed % 4], NOISES[seed // 4 % 4], seed)
        if KINDS[seed % 4] == "prbs" and seed // 16 % 2:
            signals = with_load(signals, true, 1.0)
        counts += judged(signals, true, seed)
    print("| model | records | contradicted | sound loops | stopped | bad loops | stopped |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name in (LEARNT, "gain", "delay", "one lag"):
        row = ("records", "contradicted", "sound", "sound stopped", "bad", "bad stopped")
        print(f"| {name} | " + " | ".join(str(counts[name, each]) for each in row) + " |", flush=True)


if __name__ == "__main__":
    main()
