"""An experiment: a process, a controller, and phases in which something changes.

Read from YAML by ``read_experiment``; ``demo_experiment`` makes one for any process.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml

from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import TEST_BENCH, Process, read_process
from fopid_core.model.stability import stability
from fopid_core.runtime.plant import PlantSettings

TRIGGERS = ("lockstep", "realtime")
MAX_SAMPLES = 10_000_000


@dataclass(frozen=True)
class TuneCall:
    """What the tuner is asked at the start of a phase; zero or empty leaves it to the tuner."""

    method: str = "frequency"
    phase_margin_deg: float = 0.0
    crossover: float = 0.0
    index: str = ""
    ms_max: float = 0.0
    u_max: float = 0.0
    horizon: float = 0.0
    via: str = ""
    rule: str = ""


@dataclass(frozen=True)
class Phase:
    """One stretch of the experiment.

    Attributes
    ----------
    name : str
    duration : float
        [s]
    setpoint, disturbance : float, optional
        New value at the start; None leaves it.
    gain_factor : float, optional
        The plant's new gain factor.
    tune : TuneCall, optional
        A tuning, done and applied before the phase starts.
    """

    name: str
    duration: float
    setpoint: float | None = None
    disturbance: float | None = None
    gain_factor: float | None = None
    tune: TuneCall | None = None

    def __post_init__(self) -> None:
        if not 0 < self.duration < math.inf:
            raise InputError(f"duration = {self.duration} of phase {self.name!r}; allowed: above 0 s")
        for name in ("setpoint", "disturbance", "gain_factor"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"{name} = {value} of phase {self.name!r}; allowed: a finite number")


@dataclass(frozen=True)
class Experiment:
    """What is run.

    Attributes
    ----------
    process : str
        As on the command line.
    phases : tuple of Phase
    sample_time : float
        [s]
    trigger : str
        ``lockstep`` or ``realtime``.
    gains : mapping
        kp, ki, kd, lam, mu at the start.
    plant, controller : mapping
        Further parameters of the two nodes.
    """

    process: str
    phases: tuple[Phase, ...]
    name: str = "experiment"
    sample_time: float = 0.01
    trigger: str = "lockstep"
    gains: Mapping[str, float] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)
    controller: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _made(PlantSettings, "plant", process=read_process(self.process), sample_time=self.sample_time, **self.plant)
        _made(Fopid, "gains", **{"kp": 0.0, **self.gains})
        if self.trigger not in TRIGGERS:
            raise InputError(f"trigger = {self.trigger!r}; allowed: {', '.join(TRIGGERS)}")
        if not self.phases:
            raise InputError("phases = []; allowed: at least one phase")
        if self.duration / self.sample_time > MAX_SAMPLES:
            raise InputError(f"duration of {self.duration:g} s; allowed: {MAX_SAMPLES:,} samples at most")

    @property
    def duration(self) -> float:
        """Of all phases together [s]."""
        return sum(phase.duration for phase in self.phases)

    def to_yaml(self) -> str:
        """The text ``read_experiment`` reads back."""
        content = _without_nothing(asdict(self))
        return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)


def _made(kind: type, where: str, **values: Any) -> Any:
    """An instance, to see whether these values do."""
    known = [f.name for f in fields(kind)]
    for key in values:
        if key not in known:
            raise InputError(f"{where} has the key {key!r}; allowed: {', '.join(known)}")
    return kind(**values)


def _without_nothing(value: Any) -> Any:
    if isinstance(value, Mapping):
        kept = {key: _without_nothing(item) for key, item in value.items()}
        return {key: item for key, item in kept.items() if item is not None and item != "" and item != {}}
    return [_without_nothing(item) for item in value] if isinstance(value, (list, tuple)) else value


def read_experiment(path: Path) -> Experiment:
    """Read an experiment file.

    Raises
    ------
    InputError
        Naming the file and the key that cannot be used.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"experiment {str(path)!r} cannot be read: {' '.join(str(error).split())}") from None
    try:
        return parse_experiment(content)
    except InputError as error:
        raise InputError(f"experiment {str(path)!r}: {error}") from None


def parse_experiment(content: Any) -> Experiment:
    """An experiment from the plain data of its file."""
    top = _checked(content, Experiment, "the experiment")
    phases = top.get("phases")
    if not isinstance(phases, list):
        raise InputError("phases; allowed: a list")
    return Experiment(**{**top, "phases": tuple(_phase(item, number) for number, item in enumerate(phases, 1))})


def _phase(content: Any, number: int) -> Phase:
    values = _checked(content, Phase, f"phase {number}")
    if "tune" in values:
        values["tune"] = TuneCall(**_checked(values["tune"], TuneCall, f"tune of phase {number}"))
    return Phase(**values)


_KINDS: dict[str, tuple[type, ...]] = {
    "str": (str,), "float": (float, int), "float | None": (float, int),
    "Mapping[str, float]": (dict,), "Mapping[str, Any]": (dict,),
}  # fmt: skip


def _checked(content: Any, kind: type, where: str) -> dict[str, Any]:
    """A mapping whose keys and kinds of value are those of a dataclass."""
    if not isinstance(content, dict):
        raise InputError(f"{where} = {content!r}; allowed: keys with values")
    known = {f.name: f for f in fields(kind)}
    for key, value in content.items():
        if key not in known:
            raise InputError(f"{where} has the key {key!r}; allowed: {', '.join(known)}")
        kinds = _KINDS.get(str(known[key].type))
        if kinds and (not isinstance(value, kinds) or isinstance(value, bool)):
            raise InputError(f"{where}, {key} = {value!r}; allowed: a {' or '.join(k.__name__ for k in kinds)}")
    missing = [name for name in ("process", "phases", "name", "duration") if name in known and name not in content]
    if (missing and kind is not Experiment) or "process" in missing:
        raise InputError(f"{where} lacks the key {missing[0]!r}")
    return dict(content)


SAMPLES_PER_PHASE = 3000
PAPER_SPECIFICATIONS = {"P1": (80.0, 0.3), "P2": (80.0, 1.0), "P3": (80.0, 0.1), "P4": (80.0, 1.0)}
"""Phase margin [deg] and crossover [rad/s] of the paper's Table 3."""


def demo_experiment(source: str, trigger: str = "lockstep") -> Experiment:
    """Step, tune by frequency, step, disturb, tune in time, step: for any process.

    Parameters
    ----------
    source : str
        P1 ... P4 (with the specification of the paper's Table 3) or a transfer function in s.
    """
    process = read_process(source)
    PlantSettings(process)  # says what cannot be simulated before anything else is tried
    natural = natural_crossover(process, PHASE_MARGIN)
    degrees, crossover = PAPER_SPECIFICATIONS.get(source.strip(), (0.0, 0.0))  # 0: the tuner chooses
    stretch = _round_up(8.0 / min(crossover or 0.5 * natural, natural) + 5.0 * process.delay)
    sample_time = _round_up(stretch / SAMPLES_PER_PHASE)
    gains = starting_gains(process, natural)
    dc = process.steady_state_gain
    load = -0.3 / abs(dc) if math.isfinite(dc) and dc != 0.0 else -0.05
    frequency = TuneCall("frequency", phase_margin_deg=degrees, crossover=crossover)
    in_time = TuneCall("time", index="itae", ms_max=1.6)
    return Experiment(
        process=source.strip() if source.strip() in TEST_BENCH else str(process),
        name="demo",
        sample_time=sample_time,
        trigger=trigger,
        gains=dict(zip(("kp", "ki", "kd", "lam", "mu"), gains.gains, strict=True)),
        plant={"delay_model": "exact"},
        phases=(
            Phase("starting gains", stretch, setpoint=1.0, disturbance=0.0),
            Phase("tuned by frequency", stretch, setpoint=2.0, tune=frequency),
            Phase("load disturbance", stretch, disturbance=load),
            Phase("tuned in time", stretch, setpoint=3.0, tune=in_time),
            Phase("load taken away", stretch, disturbance=0.0),
        ),
    )


def starting_gains(process: Process, natural: float) -> Fopid:
    """A plain PI as one guesses it by hand: modest first, then stronger, then with the other sign."""
    size = abs(complex(process(1j * natural)))
    likely = math.copysign(1.0, process.steady_state_gain) if math.isfinite(process.steady_state_gain) else 1.0
    for sign in (likely, -likely):
        for share in (0.3, 0.1, 1.0, 2.0):
            kp = _digits(sign * share / size)
            for weaker in (0.5, 0.1):
                guess = Fopid(kp, ki=_digits(kp * weaker * natural))
                if stability(Loop(process, guess)).stable:
                    return guess
    raise InputError(f"process {process}: no stable PI to start with; allowed: a process that a PI can hold")


def _digits(value: float) -> float:
    return float(f"{value:.2g}")


def _round_up(value: float) -> float:
    """The next round number."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(float(f"{m * power:.6g}") for m in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if m * power >= value * (1 - 1e-9))


def run_folder(name: str) -> Path:
    """A new folder's name for a run that starts now."""
    return Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
