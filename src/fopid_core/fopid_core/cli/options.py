"""What the verbs of the command line share."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fopid_core.errors import InputError

if TYPE_CHECKING:
    from fopid_core.model.loop import Loop
    from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

# A process text may begin with a minus sign; what is no option of ours is taken as an argument.
ARGUMENTS = {"ignore_unknown_options": True, "help_option_names": ["-h", "--help"]}
BAD_INPUT = 2
PICTURES = (".png", ".svg", ".pdf", ".jpg")
"""Ends of the names of pictures, which say how these are drawn."""
CANNOT_BE_MET = 3


class Verbs(click.Group):
    """A group that answers its bare name with its help on stderr, and with the status of bad input."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the command line."""
        if not args:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(BAD_INPUT)
        return super().parse_args(ctx, args)


class NewFile(click.Path):
    """A file to be written at the end: whether it can be is said at the beginning, as what comes before takes minutes.

    Parameters
    ----------
    picture : bool
        Whether its name says how it is drawn.
    """

    def __init__(self, picture: bool = False) -> None:
        super().__init__(path_type=Path)
        self._picture = picture

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path, where a file can be written there."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if path.is_dir():
            self.fail(f"{str(path)!r}; allowed: a file, not a folder", param, ctx)
        if not path.parent.is_dir():
            self.fail(f"{str(path)!r}; allowed: in a folder that is there", param, ctx)
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            self.fail(f"{str(path)!r}; allowed: where you may write", param, ctx)
        if self._picture and path.suffix.lower() not in PICTURES:
            self.fail(f"{str(path)!r}; allowed: a name that ends in {', '.join(PICTURES)}", param, ctx)
        return path


as_json = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else.")
process_argument = click.argument("process")
gains_option = click.option("--gains", required=True, metavar="KP,KI,KD,LAM,MU", help="The controller's five numbers.")
plot_option = click.option("--plot", type=NewFile(picture=True), metavar="FILE", help="Draw it: png, svg or pdf.")

_WHAT_IS_DESIGNED = {
    "horizon": click.option("--horizon", type=float, metavar="S", help="Of the steps [s]; chosen when not given."),
    "ms_max": click.option(
        "--ms-max", type=float, metavar="X", help="Bound on max |S|; 1.6 when not given, inf for none."
    ),
    "mt_max": click.option("--mt-max", type=float, metavar="X", help="Bound on max |T|."),
    "noise_max": click.option("--noise-max", type=float, metavar="X", help="Bound on the gain from noise to control."),
    "u_max": click.option("--u-max", type=float, metavar="X", help="Bound on the control's peak; 20 over the gain."),
    "sample_time": click.option(
        "--sample-time", type=float, default=0.01, show_default=True, help="Of the controller as it runs [s]."
    ),
}


def design_options(*names: str) -> Decorator:
    """The options of these names, in this order: what is asked of a design is said once for all verbs."""

    def decorate(verb: Callable[..., Any]) -> Callable[..., Any]:
        for name in reversed(names):
            verb = _WHAT_IS_DESIGNED[name](verb)
        return verb

    return decorate


filter_option = click.option(
    "--filter",
    "slow",
    metavar="ORDER,TIME",
    help="Of the measurement, 1/(1+Ts) or 1/(1+Ts+(Ts)^2/2), as 2,0.1; none when not given.",
)
weights_option = click.option("--setpoint-weights", metavar="B,C", help="In the P and the D part; 1,1 when not given.")


def loop_options(verb: Callable[..., Any]) -> Callable[..., Any]:
    """The options of a loop that is given whole: gains, filter of the measurement, weights of the setpoint."""
    return gains_option(filter_option(weights_option(verb)))


def read_loop(process: str, gains: str, slow: str | None = None, setpoint_weights: str | None = None) -> Loop:
    """The loop from what was typed."""
    from fopid_core.model.fopid import read_gains
    from fopid_core.model.loop import Loop
    from fopid_core.model.process import read_process

    return Loop(read_process(process), read_gains(gains), read_filter(slow), read_weights(setpoint_weights))


def read_filter(text: str | None) -> MeasurementFilter:
    """The filter of the measurement from ``ORDER,TIME``; none when not given."""
    from fopid_core.model.two_degrees import MeasurementFilter

    order, time = _two("filter", text or "0,0", "ORDER,TIME, for instance 2,0.1")
    if order != int(order):
        raise InputError(f"filter order = {order:g}; allowed: 0, 1 or 2")
    return MeasurementFilter(int(order), time)


def read_weights(text: str | None) -> SetpointWeights:
    """The weights of the setpoint from ``B,C``; whole when not given."""
    from fopid_core.model.two_degrees import SetpointWeights

    return SetpointWeights(*_two("setpoint weights", text or "1,1", "B,C, each 0 to 1"))


def _two(name: str, text: str, allowed: str) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{name} {text!r}; allowed: {allowed}") from None
    if not (math.isfinite(first) and math.isfinite(second)):
        raise InputError(f"{name} {text!r}; allowed: {allowed}")
    return first, second
