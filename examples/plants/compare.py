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
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

from best_known import FILE, settings_of
from foreign_plants.gallery import DRAWN, GALLERY, known_plants
from judging import Judgements, judge
from step_test import SLOWER, Pid, amigo, simc, step_test
from virtual_loop import TooLongError, VirtualLoop

from fopid_core.design.robust_verification import RobustLimits
from fopid_core.design.specification import TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_ros.tuner.learning.autotune import Autotuner
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ExperimentSettings
from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria

HEAD = (
    "| plant | gains | IAE setpoint | IAE load | its own | overshoot % | settling s | total variation | tuning took s "
    "| safe |\n| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |"
)
SUMMARY = (
    "| plant | best rule | load IAE, over the rule's | movement, over the rule's | aim met |\n"
    "| --- | --- | ---: | ---: | --- |"
)
OWN = (
    "The same by what the load's step does by itself: the output beside that of a run with the same noise and without\n"
    "the step. What noise makes of a loop counts as movement of the control already."
)
SHORT = {
    ("load",): "more error, but no rule that moves as little leaves less",
    ("variation",): "less error for more movement",
    ("load", "variation"): "more error and movement",
}
BEGIN = "<!-- made by examples/plants/compare.py -->"


@dataclass(frozen=True)
class Row:
    """Gains on a plant.

    Attributes
    ----------
    label : str
    seen : Judgements
    lasted : float
        How long the tuning took [s]; NaN where there was none.
    note : str
        What became of it.
    """

    label: str
    seen: Judgements
    lasted: float = math.nan
    note: str = ""

    def line(self, name: str) -> str:
        """Of the table."""
        told = " | ".join(
            self._told(figure)
            for figure in ("setpoint", "load", "load_effect", "overshoot_pct", "settling", "variation")
        )
        lasted = f"{self.lasted:.3g}" if math.isfinite(self.lasted) else "-"
        return f"| {name} | {self.label} | {told} | {lasted} | {'yes' if self.seen.safe else '**no**'} |"

    def _told(self, figure: str) -> str:
        """The mean over the runs, with what it changes by from run to run where it is one of those that decide."""
        mean = self.seen.settling if figure == "settling" else self.seen.mean(figure)
        if not math.isfinite(mean):
            return "-"
        scatter = f" ± {self.seen.scatter(figure):.2g}" if figure not in ("overshoot_pct", "settling") else ""
        return f"{mean:.3g}{scatter}"


def rows(name: str, seed: int = 1, until_known: bool = True) -> Iterator[Row]:
    """All that is compared on a plant but the best known, autotuning last."""
    exhibit = GALLERY[name]
    yield Row("start", judge(name, {}, load_effect=True))
    test = step_test(exhibit)
    for rule in ("SIMC PI", "SIMC PID"):
        yield from _simc(name, rule)
    for label, pid in amigo(test, exhibit.sample_time).items():
        yield Row(label, _judged(name, pid, test.safe), test.lasted)
    yield autotuned(name, seed, until_known)


def best_known(name: str) -> Iterator[Row]:
    """With what ``best_known.py`` has found."""
    for label, numbers in (json.loads(FILE.read_text()) if FILE.exists() else {}).get(name, {}).items():
        yield Row(f"best {label} known", judge(name, settings_of(numbers), load_effect=True))


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


def _judged(name: str, pid: Pid, safe: bool) -> Judgements:
    settings = {"gains": Fopid(pid.kp, pid.ki, pid.kd), "derivative_filter_time": pid.filter_time}
    return _also(judge(name, settings, load_effect=True), safe)


def _also(seen: Judgements, safe: bool) -> Judgements:
    """Safe only if what came before was safe as well."""
    return Judgements(tuple(replace(run, safe=run.safe and safe) for run in seen.runs))


def autotuned(name: str, seed: int = 1, until_known: bool = True) -> Row:
    """With what the tuner makes of it; as it began, where that refuses."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.run(0.5 * exhibit.horizon)
    criteria = AcceptanceCriteria(
        TuningRequest(read_process("P1"), timeout=600.0), RobustLimits(2.5, math.radians(30.0)), 2.0, compare=True
    )
    request, began = AutotuneRequest(ExperimentSettings(until_known=until_known), "all", criteria, False), loop.time
    try:
        outcome = Autotuner(loop, loop, request, loop).run()  # type: ignore[arg-type]
        success, message = outcome.success, outcome.message
    except (InputError, TooLongError) as error:
        success, message = False, str(error)
    low, high = exhibit.unsafe
    seen = judge(name, loop.tuned_settings(), load_effect=True)
    safe = low < min(loop.trace.true) and max(loop.trace.true) < high
    return Row(
        "autotune" if success else "autotune (kept the start)", _also(seen, safe),
        loop.time - began, f"{loop.gains()}: {message}" if success else message,
    )  # fmt: skip


@dataclass(frozen=True)
class Verdict:
    """Autotuning beside the rule with the least load IAE on a plant.

    Attributes
    ----------
    least : str
        Whose load IAE is the least of those that a tuning ends with.
    rule : str
        That rule; empty where none holds the plant.
    load, variation : str
        Autotuning's over the rule's.
    against : tuple of str
        What speaks against autotuning whatever the rules do.
    more : tuple of str
        Of load and variation, what is more than that rule's.
    dominated : bool
        Whether a rule that moves the control no more leaves less after a load, or the start was kept.
    """

    least: str
    rule: str
    load: str
    variation: str
    against: tuple[str, ...]
    more: tuple[str, ...]
    dominated: bool

    @property
    def met(self) -> bool:
        """Whether it is as good as the rules at no more movement of the control, and no worse than the start."""
        return not (self.against or self.more)

    def __str__(self) -> str:
        beside = f"; autotune beside {self.rule}: load {self.load}, variation {self.variation}"
        return "; ".join((f"{self.least}{beside if self.rule else ' (no rule holds the plant)'}", *self.against))

    def line(self, name: str) -> str:
        """Of the first table."""
        met = "yes" if self.met else "**no**" if self.dominated or self.against else f"no: {SHORT[self.more]}"
        beside = (self.rule, self.load, self.variation) if self.rule else ("none holds it", "", "")
        return f"| {name} | {' | '.join(beside)} | {'; '.join((met, *self.against))} |"


def verdict(compared: list[Row], error: str = "load") -> Verdict:
    """Who won on a plant by that error; and whether autotuning was as good at no more movement of the control."""
    start = compared[0]
    ours = next(row for row in compared if row.label.startswith("autotune"))
    rules = [row for row in compared if row.label.startswith(("SIMC", "AMIGO")) and row.seen.calm]
    worse = [figure for figure in ("setpoint", error) if ours.seen.exceeds(start.seen, figure)]
    against = (
        (f"worse than the start: {' and '.join(worse).replace('load_effect', 'what a load does')}",) if worse else ()
    )
    against += () if ours.seen.safe else ("unsafe",)
    field = [row for row in compared if "known" not in row.label and row.seen.calm]
    least = min(field, key=lambda row: row.seen.mean(error), default=start).label
    if not rules:
        return Verdict(least, "", "", "", against, (), False)
    best = min(rules, key=lambda row: row.seen.mean(error))
    load, variation = (_beside(ours.seen, best.seen, figure) for figure in (error, "variation"))
    more = tuple(of for figure, of in ((error, "load"), ("variation",) * 2) if ours.seen.exceeds(best.seen, figure))
    quieter = [row for row in rules if not row.seen.exceeds(ours.seen, "variation")]
    dominated = "kept" in ours.label or any(ours.seen.exceeds(row.seen, error) for row in quieter)
    return Verdict(least, best.label, load, variation, against, more, dominated)


def _beside(ours: Judgements, other: Judgements, figure: str) -> str:
    """A figure as a ratio; a tie is called one."""
    ratio = f"{ours.mean(figure) / other.mean(figure):.2f}"
    apart = ours.exceeds(other, figure) or other.exceeds(ours, figure)
    return ratio if apart else f"{ratio} (a tie)"


def compared(name: str, seed: int = 1, until_known: bool = True) -> tuple[str, list[Row], float]:
    """A plant's rows, and the processor time they took [s]."""
    began = time.process_time()
    return name, list(rows(name, seed, until_known)), time.process_time() - began


def table(found: Mapping[str, list[Row]]) -> str:
    """The page's part that is made."""
    lines = [BEGIN]
    for error, told in (("load", ()), ("load_effect", ("", OWN))):
        verdicts = {name: verdict(seen, error) for name, seen in found.items()}
        good = sum(each.met for each in verdicts.values())
        lines += [*told, "", SUMMARY, *(each.line(name) for name, each in verdicts.items())]
        lines += ["", f"The aim is met on {good} of {len(found)}."]
    lines += ["", "## Every figure", "", HEAD]
    for name, seen in found.items():
        lines += [row.line(name) for row in seen]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Compare and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("plants", nargs="*", default=known_plants())
    parser.add_argument("--drawn", type=int, metavar="COUNT", help="so many plants that nobody chose, instead")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seed", type=int, default=1, help="of the sensor's noise while autotuning")
    parser.add_argument("--whole", action="store_true", help="experiments do not end once enough is known")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if given.drawn:
        given.plants = [f"{DRAWN}{number}" for number in range(given.drawn)]
    found: dict[str, Any] = {}
    with ProcessPoolExecutor(given.workers) as pool:
        for name, seen, took in pool.map(compared, given.plants, repeat(given.seed), repeat(not given.whole)):
            found[name] = seen
            print(
                *(row.line(name) for row in seen),
                f"{verdict(seen)}, {took:.0f} s of processor\n",
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
