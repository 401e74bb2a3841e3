"""Many cases for one reader of ``targets``, or of texts and command lines; prints each that is answered badly::

    python -m tests.fuzzing.campaign csv --cases 100000

Where atheris is installed (``make fuzz`` sees to that), cases grow from those that reach new branches; without it they
are the seeds with random changes. Ends with 1 when there was a fault; one of a kind is kept in ``build/fuzz/NAME``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

MEMORY = 4 << 30
"""Address space of the process [bytes]."""
LARGEST = 60_000
"""Size of a case [bytes]."""
GENERATED = ("line", "asked")
ASKS = (*(8 * ("predict",)), *(4 * ("take",)), "process", "designs", "fronts")
KEPT = Path("build/fuzz")


class Tally:
    """Counts cases and keeps those that are answered badly."""

    def __init__(self, name: str, fault: Callable[[bytes], str], cases: int, seed: int) -> None:
        self._name, self._fault, self._cases, self._seed = name, fault, cases, seed
        self.done = self.faults = 0
        self._begun = time.process_time()
        self._slowest = (0.0, b"")
        self._kinds: Counter[str] = Counter()
        self._told: set[str] = set()

    def take(self, case: bytes, kind: str = "") -> None:
        """Try one case; ends the process after the last one."""
        begun = time.process_time()
        found = self._fault(case)
        self._slowest = max(self._slowest, (time.process_time() - begun, case))
        if found:
            self._keep(case, found)
        self.done += 1
        self._kinds[kind] += 1
        if self.done >= self._cases:
            self.end()

    def _keep(self, case: bytes, found: str) -> None:
        self.faults += 1
        kind = found[:60]
        if kind in self._told:  # one of a kind is enough to mend it
            return
        self._told.add(kind)
        file = KEPT / self._name / hashlib.sha256(case).hexdigest()[:16]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(case)
        print(f"{file}: {case[:2000]!r}\n    {found[:2000]}", flush=True)

    def end(self) -> None:
        """Say how it went, as text and as a line of ``build/fuzz/campaigns.jsonl``."""
        seconds, case = self._slowest
        told = {
            "target": self._name, "seed": self._seed, "cases": self.done, "faults": self.faults,
            "seconds": round(time.process_time() - self._begun, 1),
            "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            "slowest_s": round(seconds, 2), "slowest": case[:300].decode(errors="replace"), "kinds": dict(self._kinds),
        }  # fmt: skip
        KEPT.mkdir(parents=True, exist_ok=True)
        with (KEPT / "campaigns.jsonl").open("a") as file:
            file.write(json.dumps(told) + "\n")
        print(", ".join(f"{name} {value}" for name, value in told.items() if name != "kinds"), flush=True)
        os._exit(1 if self.faults else 0)  # a fuzzing engine has no other end


def changed(random: np.random.Generator, seeds: list[bytes]) -> bytes:
    """One of the seeds with some bytes lost, exchanged, doubled, or put in from another."""
    case = bytearray(seeds[random.integers(len(seeds))])
    for _ in range(1 + int(random.geometric(0.4))):
        at, size = int(random.integers(len(case) + 1)), int(random.geometric(0.2))
        other = seeds[random.integers(len(seeds))]
        start = int(random.integers(len(other) + 1))
        new = (b"", random.bytes(size), other[start : start + size], 9 * case[at : at + size])[random.integers(4)]
        case[at : at + size * int(random.integers(2))] = new
    return bytes(case[:LARGEST])


def _engine_and_targets(name: str) -> tuple[Any, Any]:
    """The fuzzing engine, where there is one, and the targets, told what they reach."""
    try:
        import atheris
    except ImportError:
        atheris = None
    if atheris is None or name in GENERATED:
        from . import targets

        return atheris, targets
    with atheris.instrument_imports(include=["fopid_core", "fopid_ros"]):
        from . import targets

        for target in filter(None, [targets.TARGETS.get(name)]):
            for seed in target.seeds():  # what is imported when it is needed is wanted now
                targets.fault(target, seed)
    return atheris, targets


def _run_generated(name: str, cases: int, seed: int, targets: Any) -> None:
    """Cases that are made whole, not changed from seeds."""
    from .lines import Fuzzer, Line, line_fault

    fuzzer = Fuzzer(seed)
    if name == "asked":
        tally = Tally(name, lambda case: targets.fault(targets.TARGETS["wishes"], case), cases, seed)
        while True:
            tally.take(fuzzer.asked(ASKS))
    tally = Tally(name, lambda case: line_fault(Line.of_bytes(case)), cases, seed)
    while True:
        line = fuzzer.line()
        tally.take(line.to_bytes(), " ".join(line.arguments[: 1 + (line.arguments[:1] == ("tune",))]))


def main() -> None:
    """Run the campaign that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    atheris, targets = _engine_and_targets(given.target)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    if given.target in GENERATED:
        _run_generated(given.target, given.cases, given.seed, targets)
    if given.target not in targets.TARGETS:
        parser.error(f"target = {given.target!r}; allowed: {', '.join((*targets.TARGETS, *GENERATED))}")
    target = targets.TARGETS[given.target]
    tally = Tally(given.target, lambda case: targets.fault(target, case), given.cases, given.seed)
    seeds = list(target.seeds())
    for seed in seeds:
        tally.take(seed)
    if atheris is None:
        random = np.random.default_rng(given.seed)
        while True:
            tally.take(changed(random, seeds))
    corpus = KEPT / f"{given.target}-corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        (corpus / hashlib.sha256(seed).hexdigest()[:16]).write_bytes(seed)
    more = [f"-seed={given.seed}"] if given.seed else []
    options = [f"-max_len={LARGEST}", "-rss_limit_mb=0", "-verbosity=0", f"-artifact_prefix={KEPT}/"]
    atheris.Setup([sys.argv[0], *options, *more, str(corpus)], tally.take)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
