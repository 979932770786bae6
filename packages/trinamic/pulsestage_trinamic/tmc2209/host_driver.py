"""Host driver of a TMC2209 axis: that of STEP/DIR axes, which selects microsteps that MS1 and MS2 do not have."""

from __future__ import annotations

from pulsestage_trinamic.motor_field import PLACES_PER_FULL_STEP
from pulsestage_trinamic.tmc2209 import state
from pulsestage_trinamic.tmc2209.lint import MRES
from stage.firmware.stepdir.driver import StepDirDriver


class Tmc2209Driver(StepDirDriver):
    """Driver of one STEP/DIR axis with a TMC2209. It writes registers directly; firmware would use the UART."""

    def prepare(self) -> None:
        """Let the chip make as many microsteps of a step as the axis' Drive has, by MRES if MS1 and MS2 cannot select them."""
        chip, microsteps = self.chip, self.axis.drive.microsteps
        if self.axis.drive.power_stage.microsteps.get(microsteps) != "" or chip.microsteps == microsteps:
            return
        mres = (PLACES_PER_FULL_STEP // microsteps).bit_length() - 1
        chip.write_register("GCONF", chip.read_register("GCONF") | state.MSTEP_REG_SELECT)
        chip.write_register("CHOPCONF", chip.read_register("CHOPCONF") & ~MRES | mres << 24)
