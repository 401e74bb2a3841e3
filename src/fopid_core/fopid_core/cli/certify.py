"""The verb ``fopid certify``: prove a loop stable and within bounds, and check such a proof."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.cli.options import ARGUMENTS, CANNOT_BE_MET, NewFile, as_json, filter_option, read_filter
from fopid_core.cli.output import emit, write_file
from fopid_core.design.certificate import require_ball_arithmetic
from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.design.certificate.enclosure import Bounds
    from fopid_core.design.certificate.family import Family
    from fopid_core.design.certificate.prover import Certification

_MOST_PIECES = 100_000_000  # in a box, where the time ends the work
_OPEN_SHARE = 0.04


@click.command("certify", context_settings=ARGUMENTS)
@click.argument("process", required=False)
@click.option("--gains", metavar="KP,KI,KD,LAM,MU", help="The controller's five numbers.")
@filter_option
@click.option("--ms-max", type=float, metavar="X", help="Prove max |S| <= X, too.")
@click.option("--mt-max", type=float, metavar="X", help="Prove max |T| <= X, too.")
@click.option("--noise-max", type=float, metavar="X", help="Prove |C S| <= X, too, up to the Nyquist frequency.")
@click.option("--sample-time", type=float, default=0.01, show_default=True, help="That frequency is pi over this [s].")
@click.option("--box", multiple=True, metavar="NAME=LOW,HIGH", help="For all values of a parameter; may be repeated.")
@click.option("--confidence", type=float, metavar="P", help="PROCESS is a record: for all that it leaves possible.")
@click.option(
    "--region",
    type=click.Choice(["ellipsoid", "box"]),
    default="ellipsoid",
    show_default=True,
    help="What of a record: the covariance's ellipsoid, or the box about it.",
)
@click.option("--effort", type=float, default=60.0, show_default=True, metavar="S", help="Give up after this long [s].")
@click.option("--precision", type=int, default=128, show_default=True, metavar="BITS", help="Of the ball arithmetic.")
@click.option("--out", type=NewFile(), metavar="FILE", help="Write the certificate.")
@click.option("--check", "checked", type=click.Path(path_type=Path), metavar="FILE", help="Check one instead.")
@as_json
def certify_verb(
    process: str | None, gains: str | None, checked: Path | None, out: Path | None, as_json: bool, **options: Any
) -> None:
    """Prove with ball arithmetic that a loop is stable and within bounds, or that it is not.

    With --box the parameters of PROCESS are intervals: those it names, as in "K/(T*s+1)*exp(-L*s)", or without names
    those of its template (K, T, L; K, a1, a0, L; ...), or K, the steady-state gain, and L, the delay. With --confidence
    PROCESS is a csv file or a bag, and the proof is about all processes that it leaves possible.
    """
    require_ball_arithmetic()
    if checked is not None:
        accepted = _check(checked, as_json)
    elif process is None or gains is None:
        raise InputError("certify without PROCESS and --gains; allowed: these, or --check FILE")
    else:
        accepted = _certify(process, gains, out, as_json, options)
    if not accepted:
        click.get_current_context().exit(CANNOT_BE_MET)


def _certify(process: str, gains: str, out: Path | None, as_json: bool, options: dict[str, Any]) -> bool:
    from fopid_core.design.certificate.prover import certify
    from fopid_core.design.certificate.subdivision import Effort
    from fopid_core.model.fopid import read_gains

    if not options["effort"] > 0.0:
        raise InputError(f"effort = {options['effort']}; allowed: above 0 s")
    if not 53 <= options["precision"] <= 4096:
        raise InputError(f"precision = {options['precision']}; allowed: 53 to 4096 bits")
    family = _family(process, options)
    slow = read_filter(options["slow"])
    if not slow.is_idle:
        if options["noise_max"] is not None:
            raise InputError(f"noise-max = {options['noise_max']:g}; allowed: none where the measurement is filtered")
        family = family.behind(slow.denominator)
    effort = Effort(_MOST_PIECES if family.names else Effort.attempts, options["effort"], _OPEN_SHARE)
    found = certify(family, read_gains(gains), _bounds(options), effort, options["precision"])
    if out is not None and found.document is not None:
        write_file("out", out, found.document + "\n")
    rows = (
        certificate_rows(found)
        | (_shares(found, family.names) if family.names else {})
        | {"certificate": str(out) if out and found.document else None}
    )
    claims = {name: value for name, value in rows.pop("claims").items() if value is not None}
    emit(rows | {"claims": claims}, [("Certificate", rows), ("Claims", claims)], as_json)
    return found.certified is True


def _family(process: str, options: dict[str, Any]) -> Family:
    from fopid_core.design.certificate.family import Family
    from fopid_core.design.certificate.family_text import read_family, read_sides
    from fopid_core.model.process import read_process

    box, confidence = options["box"], options["confidence"]
    if box and confidence is not None:
        raise InputError("box and confidence; allowed: one of them")
    if confidence is not None:
        return _learnt(Path(process), options["region"], confidence)
    return read_family(process, read_sides(box)) if box else Family.of(read_process(process))


def _learnt(record: Path, region: str, confidence: float) -> Family:
    from fopid_core.design.certificate.ellipsoid import learnt_family
    from fopid_core.design.response_verification import to_design_for
    from fopid_core.study.records import read_record

    found = to_design_for(read_record(record), str(record))
    assert found.best is not None
    return learnt_family(found.best, region, confidence)


def _shares(found: Certification, names: tuple[str, ...]) -> dict[str, Any]:
    """How much of a box is proved, and where it fails."""
    point = None if found.counterexample is None else dict(zip(names, found.counterexample, strict=True))
    return {"certified_share": found.certified_share, "failed_share": found.failed_share, "counterexample": point}


def _bounds(options: dict[str, Any]) -> Bounds:
    from fopid_core.design.certificate.enclosure import Bounds

    for name, least in (("ms_max", 1.0), ("mt_max", 0.0), ("noise_max", 0.0), ("sample_time", 0.0)):
        value = options[name]
        if value is not None and not least < value < math.inf:
            raise InputError(f"{name.replace('_', '-')} = {value}; allowed: a finite number above {least:g}")
    band = math.pi / options["sample_time"] if options["noise_max"] is not None else None
    return Bounds(options["ms_max"], options["mt_max"], options["noise_max"], band)


def certificate_rows(found: Certification) -> dict[str, Any]:
    """What the command line says of a certification."""
    from fopid_core.design.certificate.prover import claims_of

    return {
        "certified": found.certified,
        "claims": claims_of(found.bounds),
        "reason": found.reason,
        "elapsed_s": found.elapsed,
    }


def _check(path: Path, as_json: bool) -> bool:
    from fopid_core.design.certificate.checker import check

    try:
        text = path.read_bytes().decode(errors="replace")
    except OSError as error:
        raise InputError(f"certificate {str(path)!r} cannot be read: {error.strerror}") from None
    objection = check(text)
    content = {} if objection else json.loads(text)
    told = {name: content[name] for name in ("gains", "claims", "parameters") if content}
    verdict = {"accepted": not objection, "reason": objection or "every piece is proved"}
    emit(verdict | told, [("Certificate", verdict), *_shown(told)], as_json)
    return not objection


def _shown(told: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    if not told:
        return []
    gains = dict(zip(("kp", "ki", "kd", "lam", "mu"), told["gains"], strict=True))
    box = {name: (low, high) for name, low, high in told["parameters"]}
    return [("Gains", gains), ("Claims", told["claims"]), *([("Box", box)] if box else [])]
