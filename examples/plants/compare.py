"""The comparison of the gallery: ``python examples/plants/compare.py [PLANT ...] [--out docs/plants.md]``.

Each plant in virtual time: with the gains it began with, with PI and PID by published rules from an open-loop step
test, with what ``~/autotune`` makes of it, and with the best known; all judged on the plant itself, by the true output.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from best_known import FILE, settings_of
from foreign_plants.gallery import GALLERY
from judging import Judgement, judge
from step_test import SLOWER, Pid, amigo, simc, step_test
from virtual_loop import TooLongError, VirtualLoop

from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_ros.tuner.learning.autotune import Autotuner, AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria

TIE = 1.02
"""Figures so close to each other are one: they come from one run of a noisy plant."""
HEAD = (
    "| plant | gains | IAE setpoint | IAE load | overshoot % | settling s | total variation | tuning took s | safe |\n"
    "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |"
)
BEGIN = "<!-- made by examples/plants/compare.py -->"


@dataclass(frozen=True)
class Row:
    """Gains on a plant.

    Attributes
    ----------
    label : str
    seen : Judgement
    lasted : float
        How long the tuning took [s]; NaN where there was none.
    note : str
        What became of it.
    """

    label: str
    seen: Judgement
    lasted: float = math.nan
    note: str = ""

    def line(self, name: str) -> str:
        """Of the table."""
        seen = self.seen
        numbers = (seen.setpoint, seen.load, seen.overshoot_pct, seen.settling, seen.variation, self.lasted)
        told = " | ".join(f"{value:.3g}" if math.isfinite(value) else "-" for value in numbers)
        return f"| {name} | {self.label} | {told} | {'yes' if seen.safe else '**no**'} |"


def rows(name: str) -> Iterator[Row]:
    """All that is compared on a plant but the best known, autotuning last."""
    exhibit = GALLERY[name]
    yield Row("start", judge(name, {}))
    test = step_test(exhibit)
    for rule in ("SIMC PI", "SIMC PID"):
        yield from _simc(name, rule)
    for label, pid in amigo(test, exhibit.sample_time).items():
        yield Row(label, _judged(name, pid, test.safe), test.lasted)
    yield autotuned(name)


def best_known(name: str) -> Iterator[Row]:
    """With what ``best_known.py`` has found."""
    for label, numbers in (json.loads(FILE.read_text()) if FILE.exists() else {}).get(name, {}).items():
        yield Row(f"best {label} known", judge(name, settings_of(numbers)))


def _simc(name: str, rule: str) -> Iterator[Row]:
    """As the rule says; slower where the plant does not come to rest with that."""
    exhibit = GALLERY[name]
    test = step_test(exhibit)
    for slower in SLOWER:
        found = simc(test, exhibit.sample_time, slower)
        if rule not in found:
            return
        seen = _judged(name, found[rule], test.safe)
        if seen.calm:
            break
    yield Row(rule if slower == 1.0 else f"{rule}, {slower:g} delays", seen, test.lasted)


def _judged(name: str, pid: Pid, safe: bool) -> Judgement:
    seen = judge(name, {"gains": Fopid(pid.kp, pid.ki, pid.kd), "derivative_filter_time": pid.filter_time})
    return Judgement(**{**vars(seen), "safe": seen.safe and safe})


def autotuned(name: str, seed: int = 1) -> Row:
    """With what the tuner makes of it; as it began, where that refuses."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.run(0.5 * exhibit.horizon)
    criteria = AcceptanceCriteria(
        TuningRequest(read_process("P1"), timeout=600.0), RobustLimits(2.5, math.radians(30.0)), 2.0, compare=True
    )
    request, began = AutotuneRequest(ExperimentSettings(), "all", criteria, False), loop.time
    try:
        outcome = Autotuner(loop, loop, request, loop).run()  # type: ignore[arg-type]
        success, message = outcome.success, outcome.message
    except (InputError, TooLongError) as error:
        success, message = False, str(error)
    low, high = exhibit.unsafe
    seen = judge(name, loop.tuned_settings())
    safe = seen.safe and low < min(loop.trace.true) and max(loop.trace.true) < high
    return Row(
        "autotune" if success else "autotune (kept the start)", Judgement(**{**vars(seen), "safe": safe}),
        loop.time - began, f"{loop.gains()}: {message}" if success else message,
    )  # fmt: skip


def verdict(compared: list[Row]) -> tuple[str, bool]:
    """Who won on a plant; and whether autotuning was as good as the rules at no more movement of the control."""
    start = compared[0]
    ours = next(row for row in compared if row.label.startswith("autotune"))
    rules = [row for row in compared if row.label.startswith(("SIMC", "AMIGO")) and row.seen.calm]
    not_worse = ours.seen.load <= TIE * start.seen.load and ours.seen.setpoint <= TIE * start.seen.setpoint
    told = "" if not_worse else "; worse than the start"
    field = [row for row in compared if "known" not in row.label and row.seen.calm]
    winner = min(field, key=lambda row: row.seen.load, default=start).label
    if not rules:
        return f"{winner} (no rule holds the plant){told}", not_worse
    best = min(rules, key=lambda row: row.seen.load)
    level = ours.seen.load <= TIE * best.seen.load
    calm = [row for row in rules if row.seen.variation <= TIE * ours.seen.variation]
    quiet = min((row.seen.load for row in calm), default=math.inf)
    movement = ours.seen.variation / best.seen.variation
    beside = f"load IAE {ours.seen.load / best.seen.load:.2f} and movement {movement:.2f}"
    said = f"{winner}; autotune beside {best.label}: {beside}"
    if not level and ours.seen.load <= TIE * quiet and "kept" not in ours.label:
        said += ", the best at no more movement"
    return said + told, not_worse and level and ours.seen.variation <= TIE * best.seen.variation


def compared(name: str) -> tuple[str, list[Row], float]:
    """A plant's rows, and the processor time they took [s]."""
    began = time.process_time()
    return name, list(rows(name)), time.process_time() - began


def table(found: Mapping[str, list[Row]]) -> str:
    """The page's part that is made."""
    lines = [BEGIN, "", HEAD]
    for name, seen in found.items():
        lines += [row.line(name) for row in seen]
    lines += ["", "Who had the least load IAE of those that a tuning ends with, and what autotuning made of it:", ""]
    verdicts = {name: verdict(seen) for name, seen in found.items()}
    for name, seen in found.items():
        note = next(row.note for row in seen if row.label.startswith("autotune"))
        lines.append(f"- {name}: {verdicts[name][0]}. {note[:400]}")
    good = sum(met for _, met in verdicts.values())
    asked = "Load IAE no larger than the best rule's at no more movement, and not worse than the start"
    lines += ["", f"{asked}: {good} of {len(found)}."]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Compare and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("plants", nargs="*", default=list(GALLERY))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    found: dict[str, Any] = {}
    with ProcessPoolExecutor(given.workers) as pool:
        for name, seen, took in pool.map(compared, given.plants):
            found[name] = seen
            print(
                *(row.line(name) for row in seen),
                f"{verdict(seen)[0]}, {took:.0f} s of processor\n",
                sep="\n",
                flush=True,
            )
    for name, seen in found.items():
        seen.extend(best_known(name))
    if given.out:
        head = given.out.read_text().split(BEGIN)[0] if given.out.exists() else ""
        given.out.write_text(head + table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
