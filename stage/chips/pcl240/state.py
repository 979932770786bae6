"""State of a PCL-240 chip as a record for compiled code, its pins and register bits, and the begin and end of a run.

A run lasts from a start command to the stop.
"""

from __future__ import annotations

import numpy as np

from stage.chips.core_interface import WIRE_BIT
from stage.chips.pcl240.maps import PCL240MS_MAP as MAP
from stage.native import greatest, hot, least, record

REGISTERS = len(MAP.registers)
_REGISTER_INDICES = {r.name: k for k, r in enumerate(MAP.registers)}
R10, R12, R13, R14, R15, R17 = (_REGISTER_INDICES[name] for name in ("R10", "R12", "R13", "R14", "R15", "R17"))
"""Indices in `reg`: R0 to R7 under their own numbers, then R10 to R17 (octal numbers)."""
COUNTER_MASK = MAP.register("R0").mask

# The bits of the bytes of address 0, of the status byte and of registers. The MS has all that the others have.
GROUP = MAP.mask("operate", "group")
INT_AT_STOP, START, STOP, RAMP, SPEED = MAP.masks("operate", "int_at_stop", "start", "stop", "ramp", "speed")
FL, FH1, FH2 = (MAP.field("operate", "speed").find_code(name) for name in ("FL", "FH1", "FH2"))
MINUS, PRESET, SD, ORIGIN, AUTOMATIC, POSITION = MAP.masks(
    "control", "minus", "preset", "sd", "origin", "automatic", "position"
)
REGISTER, SECOND_EIGHT, COLLECTIVE = MAP.masks("select", "register", "extension", "collective")
INDEPENDENT, EXTENSION, EXTERNAL, OTS_LEVEL = MAP.masks("output", "independent", "extension", "external", "ots")
OUTPUT_BITS = MAP.word("output").used & ~GROUP
S_NO_INT, S_OPERATING, S_FKEEP, S_LT, S_ZERO, S_SD, S_ORG, S_INS = MAP.masks(
    "status", "no_int", "operating", "fkeep", "lt", "zero", "sd", "org", "ins"
)
LINEAR, UNCORRECTED, SPAN = MAP.masks("R14", "linear", "uncorrected", "span")  # SPAN of R15, too
EZ_RETURN, EZ_FROM_FL, ORG_POSITIVE = MAP.masks("R13", "ez_return", "ez_from_fl", "org_logic")
EZ_POSITIVE = MAP.mask("R12", "ez_logic")
EZ_COUNT = MAP.bit("R13", "ez_count")  # of R17, too
MAX_EZ_COUNT = MAP.mask("R13", "ez_count") >> EZ_COUNT
EZ_SIGNAL = MAP.mask("R17", "ez")

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("phase", "i8"),  # phase of the pulse period: grows by `speed` per clock; at 8192 R7 the next pulse begins
        ("speed", "i8"),  # present speed, speed steps
        ("ramp_clocks", "i8"),  # clocks since the last step of a linear ramp, since the start of an S-curve ramp
        ("ramp_direction", "i8"),  # 1 up, -1 down, 0 none
        ("running", "i8"),  # a run is in progress
        ("finishing", "i8"),  # the run has ended except for the pulse in progress
        ("armed", "i8"),  # a start command acts: 08h was written after the last stop
        ("pout_low", "i8"),  # POUT is low: a pulse is in progress
        # operating-mode command
        ("uses_ramps", "i8"),  # high-speed run, with ramps
        ("speed_select", "i8"),  # selected speed register: FL, FH1, FH2
        ("stopping", "i8"),  # a decelerating stop was commanded
        ("int_at_stop", "i8"),  # /INT at stop
        ("irq", "i8"),  # /INT is pending
        # control-mode command
        ("origin_return", "i8"),  # origin return
        ("sd_enable", "i8"),  # SD slows a high-speed run
        ("preset", "i8"),  # stop when R0 reaches 0
        ("minus", "i8"),  # direction: 1 minus
        ("automatic_ramp_down", "i8"),  # automatic ramp-down point
        ("counts_position", "i8"),  # R10 counts output pulses
        # register select, output mode, bytes that wait
        ("selected_register", "i8"),  # selected register, an index in `reg`
        ("output_mode", "i8"),  # bits of the output mode
        ("collective", "i8"),  # transfers of all bytes at once
        ("high_byte", "i8"),  # bits 23..16, which wait for the lowest byte
        ("middle_byte", "i8"),  # bits 15..8, which wait for the lowest byte
        ("read_latch", "i8"),  # the register at the last read of its high byte
        # pins, pulses
        ("inputs", "i8"),  # INPUTS, and above them R7 of the leader, see SYNI
        ("active_inputs", "i8"),  # INPUTS that are active: R12 and R13 can invert EZ and ORG
        ("last_inputs", "i8"),  # `active_inputs` at the last clock
        ("multiplier", "i8"),  # R7; that of the leader if SYNI is connected
        ("total", "i8"),  # pulses since power-up
        ("net", "i8"),  # net pulses since power-up
        # the S-curve ramp in progress, as it started
        ("curved_ramp", "i8"),  # the ramp is an S-curve
        ("ramp_goal", "i8"),  # speed steps
        ("ramp_steps", "i8"),  # number of its steps
        ("ramp_step", "i8"),  # number of steps taken
        ("twice_span", "i8"),  # 2 S of ramp.py, speed steps
        ("ramp_rate", "i8"),  # clocks per speed step in its linear part
        ("rate_register", "i8"),  # register of the rate, an index in `reg`: a host may revise it
        ("fdown_end", "i8"),  # after a ramp down: the clock at which FDOWN falls; else 0
        ("next_step_time", "i8"),  # `ramp_clocks` of its next step
        # the clock up to which only pulses happen if no input changes and nobody writes; 0: unknown
        ("quiet_until", "i8"),
        # automatic ramp-down and FH correction of this run
        ("speed_rising", "i8"),  # the speed was below its goal at the last clock
        ("rise_pulses", "i8"),  # pulses output while the speed was rising
        ("automatic_off", "i8"),  # the automatic ramp-down point is off for this run
        ("ramp_down_due", "i8"),  # the automatic ramp-down point has been reached
        ("corrected_speed", "i8"),  # corrected FH, speed steps
        ("corrected_select", "i8"),  # the speed register that it replaces
        # origin return with EZ of this run
        ("passed_org", "i8"),  # ORG has been asserted
        ("counts_ez", "i8"),  # edges of EZ are counted
        ("ez_left", "i8"),  # number of EZ edges that remain
        ("ez_started", "i8"),  # the first EZ edge has been counted
        # the variant: chips of the family differ by data alone
        ("extended", "i8"),  # MK and MS
        ("s_curves", "i8"),  # MS; it has the EZ monitor, too
        ("reg", "i8", (REGISTERS,)),  # R0 to R7, R10 to R17
        ("writable_bits", "i8", (REGISTERS,)),  # writable bits of each register
        ("offset_sign_bit", "i8"),  # sign bit of R6 as an offset
    ]
)
"""State of one PCL-240."""

EL_PLUS, EL_MINUS, SD_PLUS, SD_MINUS, ORG, INS, EXTP, EZ = (1 << k for k in range(8))
INPUTS = {
    "el_plus": EL_PLUS,
    "el_minus": EL_MINUS,
    "sd_plus": SD_PLUS,
    "sd_minus": SD_MINUS,
    "org": ORG,
    "ins": INS,
    "extp": EXTP,
    "ez": EZ,
}
OTS, POUT, PDIR, HOLD, FDOWN, FKEEP, FUP, LT, ZERO, IRQ = (1 << k for k in range(10))
OUTPUTS = {
    "ots": OTS,
    "pout": POUT,
    "pdir": PDIR,
    "hold": HOLD,
    "fdown": FDOWN,
    "fkeep": FKEEP,
    "fup": FUP,
    "lt": LT,
    "zero": ZERO,
    "irq": IRQ,
}
SYNI_SHIFT = WIRE_BIT
"""From this bit on `inputs` holds R7 of the leader plus 1; 0 while SYNI is not connected."""
ALL_INPUTS = (1 << SYNI_SHIFT) - 1
PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record(
    [
        ("clock", "i8"),  # from here on
        ("inputs", "i8"),  # INPUTS
        ("seen", "i8"),  # INPUTS as the chip reads them
        ("outputs", "i8"),  # OUTPUTS
        ("speed", "i8"),  # speed steps; 0 at rest
        ("counter", "i8"),  # R0
        ("net", "i8"),  # pulses ever, plus minus minus
        ("rate", "f8"),  # pulses a clock
    ]
)
"""State of a chip from one of its changes on, for journals and recordings."""


@hot
def reset_chip(chip):
    """Reset the chip as /RESET does: everything to 0 except `armed`. The clock, the input pins and the pulse totals stay."""
    chip.phase = chip.speed = chip.ramp_clocks = chip.ramp_direction = chip.running = chip.finishing = chip.pout_low = 0
    chip.armed = 1
    chip.uses_ramps = chip.speed_select = chip.stopping = chip.int_at_stop = chip.irq = 0
    chip.origin_return = chip.sd_enable = chip.preset = chip.minus = chip.automatic_ramp_down = chip.counts_position = 0
    chip.selected_register = chip.output_mode = chip.collective = 0
    chip.high_byte = chip.middle_byte = chip.read_latch = 0
    clear_run_state(chip)
    for k in range(REGISTERS):
        chip.reg[k] = 0
    update_active_inputs(chip)


@hot
def update_active_inputs(chip):
    """Update `active_inputs` and `multiplier` after a change of the pins, of R7, or of the bits that invert pins."""
    turned = (ORG if chip.reg[R13] & ORG_POSITIVE else 0) | (EZ if chip.reg[R12] & EZ_POSITIVE else 0)
    chip.active_inputs = (chip.inputs & ALL_INPUTS) ^ turned
    chip.multiplier = (chip.inputs >> SYNI_SHIFT) - 1 if chip.inputs >> SYNI_SHIFT else chip.reg[7]
    chip.phase = least(chip.phase, greatest(8192 * chip.multiplier - 1, 0))


@hot
def clear_run_state(chip):
    """Clear the state that a run of the PCL-240 does not take over from the run before it."""
    chip.phase = chip.ramp_clocks = chip.ramp_direction = chip.curved_ramp = chip.fdown_end = 0
    chip.speed_rising = chip.rise_pulses = chip.automatic_off = 0
    chip.ramp_down_due = chip.corrected_speed = chip.corrected_select = 0
    chip.passed_org = chip.counts_ez = chip.ez_left = chip.ez_started = 0


@hot
def end_run(chip):
    """End the run of the PCL-240: status bit 6 falls, and /INT is asserted if the command asks for it."""
    chip.finishing = 0
    if chip.int_at_stop:
        chip.irq = 1


@hot
def stop_run(chip):
    """Stop the run of the PCL-240. A pulse in progress is completed first."""
    chip.running = chip.armed = chip.stopping = chip.ez_started = 0
    if chip.pout_low:
        chip.finishing = 1
    else:
        end_run(chip)
