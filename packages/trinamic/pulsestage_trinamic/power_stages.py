"""Power stages of Trinamic for STEP/DIR axes, by entry points: `Stage("xyz", chips="stepdir", drives="tmc2209")`."""

from __future__ import annotations

from stage.drives.power_stages import PowerStage

MIN_STEP_LEVEL_TIME_S = 20e-9 + 1 / 12e6
"""Shortest time for which STEP is high or low: 20 ns and a clock."""
_MICROSTEPS = dict.fromkeys((1, 2, 4, 8, 16, 32, 64, 128, 256), "")

TMC2209 = PowerStage(
    "tmc2209", "Trinamic TMC2209", 2.8, 4.75, 29.0, _MICROSTEPS | {8: "LL", 16: "HH", 32: "HL", 64: "LH"}, ("MS1", "MS2"),
    step_high=MIN_STEP_LEVEL_TIME_S, step_low=MIN_STEP_LEVEL_TIME_S, dir_setup=20e-9, dir_hold=20e-9,
    current_divider=2.5 / 0.325, sense_resistor=0.11,
    internal_resistance=0.02, chip="pulsestage_trinamic.tmc2209:TMC2209",
    evidence={
        "max_current": "S: peak; 2 A RMS", "min_supply": "S", "max_supply": "S: data sheet rev. 1.09; up to 28 V in operation",
        "microsteps": "S: MS1 and MS2; the others by CHOPCONF.MRES",
        "step_high": "S: 20 ns and a clock of 12 MHz", "step_low": "S: as step_high",
        "dir_setup": "S", "dir_hold": "S", "enable_setup": "I: none is given", "counts_disabled": "I: the sequencer goes on",
        "current_divider": "S: 0.325 V full scale at 2.5 V", "sense_resistor": "I: that of common modules",
        "internal_resistance": "S: 20 mohm",
    },
)  # fmt: skip
TMC5160 = PowerStage(
    "tmc5160", "Trinamic TMC5160 with SD_MODE high", 10.0, 8.0, 60.0, _MICROSTEPS, step_high=MIN_STEP_LEVEL_TIME_S,
    step_low=MIN_STEP_LEVEL_TIME_S,
    dir_setup=20e-9, dir_hold=20e-9, chip="pulsestage_trinamic.tmc5160_step_dir:StepDirTMC5160",
    evidence={
        "max_current": "I: external transistors; 10 A with 33 mohm, and the chip's sense resistors set the limit",
        "min_supply": "S", "max_supply": "S: up to 55 V in operation, 60 V at most", "microsteps": "S: by CHOPCONF.MRES",
        "step_high": "I: as the TMC2209", "step_low": "I: as the TMC2209", "dir_setup": "S", "dir_hold": "S",
        "enable_setup": "I: none is given", "counts_disabled": "I: the sequencer goes on",
    },
)  # fmt: skip
