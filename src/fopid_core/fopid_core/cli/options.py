"""What the verbs of the command line share."""

from __future__ import annotations

import click

# A process text may begin with a minus sign; what is no option of ours is taken as an argument.
ARGUMENTS = {"ignore_unknown_options": True, "help_option_names": ["-h", "--help"]}
CANNOT_BE_MET = 3

as_json = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, nothing else.")
process_argument = click.argument("process")
