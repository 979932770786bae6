"""What a command of another package is made of: see package_commands.py. Everything here is public.

add_command     a subcommand with help, examples and --json
tell, wrote     what the command says with --json, and which files it has written
number, TIME    types of options: a whole number, and seconds with a unit
"""

from stage.cli.arguments.options import command as add_command
from stage.cli.arguments.options import number
from stage.cli.facts import tell, wrote
from stage.cli.quantities import TIME

__all__ = ["TIME", "add_command", "number", "tell", "wrote"]
