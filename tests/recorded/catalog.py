"""All files of recorded behavior and their scenes."""

from recorded import (
    board_devices,
    chip_programs,
    drivers,
    environments,
    hidden_machines,
    obstructed_procedures,
    procedures,
    stage_equipment,
    stages,
)

PHYSICS = {
    **procedures.FILES, **obstructed_procedures.FILES, **drivers.FILES, **stages.FILES, **stage_equipment.FILES,
    **board_devices.FILES, **environments.FILES, **hidden_machines.FILES,
}  # fmt: skip
"""Files that depend on MuJoCo's version: contacts differ between versions by more than rounding."""
FILES = {**chip_programs.FILES, **PHYSICS}
