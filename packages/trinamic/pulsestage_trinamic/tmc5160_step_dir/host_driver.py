"""Host driver of a STEP/DIR axis with a TMC5160: that of STEP/DIR axes, which switches the chip's power stage on first."""

from __future__ import annotations

from typing import Any

from pulsestage_trinamic.motor_field import PLACES_PER_FULL_STEP
from pulsestage_trinamic.tmc5160.host_driver.driver import (
    DEFAULT_CHOPCONF,
    ROTOR_SETTLING_TIME_S,
    compute_current_registers,
)
from pulsestage_trinamic.tmc5160.power_stage import FULL_SCALE_V
from stage.firmware.stepdir.driver import StepDirDriver


class StepDirTmc5160Driver(StepDirDriver):
    """Driver of one STEP/DIR axis with a TMC5160. It writes registers directly; firmware would use SPI."""

    axis: Any
    chip: Any

    def prepare(self) -> None:
        """Switch the power stage on if it is off, with microsteps and current of the axis' Drive and SpreadCycle."""
        chip, drive = self.chip, self.axis.drive
        if chip.read_register("CHOPCONF") & 15:
            return
        amplitude = min(drive.amplitude, FULL_SCALE_V / chip.rsense)
        mres = (PLACES_PER_FULL_STEP // drive.microsteps).bit_length() - 1
        registers = compute_current_registers(amplitude, chip.rsense) | {"CHOPCONF": DEFAULT_CHOPCONF | mres << 24}
        for name, value in registers.items():
            chip.write_register(name, value)
        self.axis.wait(ROTOR_SETTLING_TIME_S)
