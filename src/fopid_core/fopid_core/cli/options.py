"""What the verbs of the command line share."""

from __future__ import annotations

import click

# A process text may begin with a minus sign; what is no option of ours is taken as an argument.
ARGUMENTS = {"ignore_unknown_options": True, "help_option_names": ["-h", "--help"]}
BAD_INPUT = 2
CANNOT_BE_MET = 3


class Verbs(click.Group):
    """A group that answers its bare name with its help on stderr, and with the status of bad input."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the command line."""
        if not args:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(BAD_INPUT)
        return super().parse_args(ctx, args)


as_json = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else.")
process_argument = click.argument("process")
