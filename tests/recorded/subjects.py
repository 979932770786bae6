"""All files of recorded behaviour and their scenes."""

from recorded import recorded_chips, recorded_cli

PHYSICS = {**recorded_cli.FILES}
"""What depends on MuJoCo's version."""
FILES = {**recorded_chips.FILES, **PHYSICS}
