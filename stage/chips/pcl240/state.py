"""PCL-240 family, compiled: the record that holds a chip, its pins and register bits, and how a run ends."""

from __future__ import annotations

import numpy as np

from stage.chips.pcl240.maps import PCL240MS_MAP as MAP
from stage.native import hot, record

REGISTERS = len(MAP.registers)
_PLACES = {r.name: k for k, r in enumerate(MAP.registers)}
R10, R13, R14, R15, R17 = (_PLACES[name] for name in ("R10", "R13", "R14", "R15", "R17"))
"""Places in `reg`: R0 to R7, then R10 to R17 (octal numbers). R0 to R7 are at home under their own number."""
COUNTER_MASK = MAP.register("R0").mask

# The bits of the bytes of address 0, of the status byte and of registers. The MS has all that the others have.
GROUP = MAP.mask("operate", "group")
INT_AT_STOP, START, STOP, RAMP, SPEED = MAP.masks("operate", "int_at_stop", "start", "stop", "ramp", "speed")
FL, FH1, FH2 = (MAP.field("operate", "speed").code(name) for name in ("FL", "FH1", "FH2"))
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
EZ_RETURN, EZ_FROM_FL = MAP.masks("R13", "ez_return", "ez_from_fl")
EZ_COUNT = MAP.bit("R13", "ez_count")  # of R17, too
EZ_MOST = MAP.mask("R13", "ez_count") >> EZ_COUNT
EZ_SIGNAL = MAP.mask("R17", "ez")

STATE = record(
    [
        (name, "i8")
        for name in (
            "clock phase speed timer ramp running finishing armed low "  # low: POUT is low, a pulse is in progress
            "ramps select decel int_at_stop irq "  # operating-mode command
            "origin sd_enable preset minus automatic position "  # control-mode command
            "selected output collective high middle latch "  # register select, output mode; collective bytes
            "inputs sampled total net "  # pins now and at the last tick; pulses begun ever, and + minus -
            "curved goal steps step twice_span rate next "  # the S-curve ramp in progress
            "quiet "  # the clock up to which nothing happens but pulses
            "rising risen manual down top top_select "  # automatic ramp-down and FH correction of this run
            "homing counting ez_left ez_running "  # origin return with EZ of this run
            "extended s_curves"  # what this variant has
        ).split()
    ]
    + [("reg", "i8", (REGISTERS,)), ("mask", "i8", (REGISTERS,)), ("top_bit", "i8")]
)
"""One chip. `mask` holds what can be written to each register, `extended` and `s_curves` what the chip has beyond the
240K: variants differ by data alone.

curved, goal, steps, twice_span, rate: of the S-curve ramp as it started; step: how many it has taken.
quiet: holds while the inputs stay as they are and nobody writes; 0 where it is not known.
timer: ticks since the last step of a linear ramp, since the start of an S-curve ramp. next: the `timer` of its next step.
risen: pulses output while the speed rose; rising: step 3 of the last tick found goal > speed; down: the automatic point
has come; manual: the automatic point is off for this run; top: corrected FH in place of register `top_select`.
homing: ORG was seen in a return with EZ; counting: EZ edges count; ez_running: the first has, `ez_left` are to come.
top_bit: the sign of R6 as an offset."""

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
PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs speed counter net".split()] + [("rate", "f8")])


@hot
def reset(c):
    """The /RESET pin: everything 0 except `armed`; the clock, the input pins and the pulse totals go on."""
    c.phase = c.speed = c.timer = c.ramp = c.running = c.finishing = c.low = 0
    c.armed = 1
    c.ramps = c.select = c.decel = c.int_at_stop = c.irq = 0
    c.origin = c.sd_enable = c.preset = c.minus = c.automatic = c.position = 0
    c.selected = c.output = c.collective = c.high = c.middle = c.latch = 0
    begin(c)
    for k in range(REGISTERS):
        c.reg[k] = 0


@hot
def begin(c):
    """What one run does not know of the last."""
    c.phase = c.timer = c.ramp = c.curved = 0
    c.rising = c.risen = c.manual = c.down = c.top = c.top_select = 0
    c.homing = c.counting = c.ez_left = c.ez_running = 0


@hot
def end(c):
    """The operation is over: b6 falls, /INT if asked for."""
    c.finishing = 0
    if c.int_at_stop:
        c.irq = 1


@hot
def stop(c):
    """Stop; a pulse in progress is completed first."""
    c.running = c.armed = c.decel = c.ez_running = 0
    if c.low:
        c.finishing = 1
    else:
        end(c)
