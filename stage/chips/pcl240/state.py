"""PCL-240 family, compiled: the record that holds a chip, its pins and register bits, and how a run ends."""

from __future__ import annotations

import numpy as np

from stage.chips.cores import WIRE_BIT
from stage.chips.pcl240.maps import PCL240MS_MAP as MAP
from stage.native import greatest, hot, least, record

REGISTERS = len(MAP.registers)
_PLACES = {r.name: k for k, r in enumerate(MAP.registers)}
R10, R12, R13, R14, R15, R17 = (_PLACES[name] for name in ("R10", "R12", "R13", "R14", "R15", "R17"))
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
EZ_RETURN, EZ_FROM_FL, ORG_POSITIVE = MAP.masks("R13", "ez_return", "ez_from_fl", "org_logic")
EZ_POSITIVE = MAP.mask("R12", "ez_logic")
EZ_COUNT = MAP.bit("R13", "ez_count")  # of R17, too
MAX_EZ_COUNT = MAP.mask("R13", "ez_count") >> EZ_COUNT
EZ_SIGNAL = MAP.mask("R17", "ez")

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("phase", "i8"),  # of the pulse period: grows by `speed` a clock up to 8192 R7, where the next pulse begins
        ("speed", "i8"),  # speed steps
        ("timer", "i8"),  # clocks since the last step of a linear ramp, since the start of an S-curve ramp
        ("ramp", "i8"),  # 1 up, -1 down, 0 none
        ("running", "i8"),  # a run is on
        ("finishing", "i8"),  # the run is over, but for the pulse in progress
        ("armed", "i8"),  # a start acts: 08h came after the last stop
        ("low", "i8"),  # POUT is low: a pulse is in progress
        # operating-mode command
        ("ramps", "i8"),  # high speed, with ramps
        ("select", "i8"),  # speed register: FL, FH1, FH2
        ("decel", "i8"),  # a decelerating stop was commanded
        ("int_at_stop", "i8"),  # /INT at stop
        ("irq", "i8"),  # /INT is pending
        # control-mode command
        ("origin", "i8"),  # origin return
        ("sd_enable", "i8"),  # SD slows a high-speed run
        ("preset", "i8"),  # stop when R0 reaches 0
        ("minus", "i8"),  # direction: 1 minus
        ("automatic", "i8"),  # automatic ramp-down point
        ("position", "i8"),  # R10 counts output pulses
        # register select, output mode, bytes that wait
        ("selected", "i8"),  # place in `reg`
        ("output", "i8"),  # bits of the output mode
        ("collective", "i8"),  # transfers of all bytes at once
        ("high", "i8"),  # bits 23..16, wait for the lowest byte
        ("middle", "i8"),  # bits 15..8, wait for the lowest byte
        ("latch", "i8"),  # the register as the high byte's read found it
        # pins, pulses
        ("inputs", "i8"),  # INPUTS now, and what SYNI brings
        ("seen", "i8"),  # INPUTS as the chip reads them: R12 and R13 turn EZ and ORG round
        ("sampled", "i8"),  # the same at the last clock
        ("multiplier", "i8"),  # R7, of the leader where SYNI is connected
        ("total", "i8"),  # pulses begun ever
        ("net", "i8"),  # the same, plus minus minus
        # the S-curve ramp in progress, as it started
        ("curved", "i8"),  # there is one
        ("goal", "i8"),  # speed steps
        ("steps", "i8"),  # steps of it in all
        ("step", "i8"),  # steps taken
        ("twice_span", "i8"),  # 2 S of ramp.py, speed steps
        ("rate", "i8"),  # clocks per speed step of its middle
        ("rate_place", "i8"),  # place in `reg` of the rate, which may be revised
        ("fall", "i8"),  # after a ramp down: the clock at which FDOWN falls; 0 once it cannot be up any more
        ("next", "i8"),  # `timer` of its next step
        (
            "quiet",
            "i8",
        ),  # the clock up to which nothing happens but pulses, while inputs stay and nobody writes; 0: not known
        # automatic ramp-down and FH correction of this run
        ("rising", "i8"),  # step 3 of the last clock found goal > speed
        ("risen", "i8"),  # pulses output while the speed rose
        ("manual", "i8"),  # the automatic point is off for this run
        ("down", "i8"),  # the automatic point has come
        ("top", "i8"),  # corrected FH, speed steps ...
        ("top_select", "i8"),  # ... in place of this speed register
        # origin return with EZ of this run
        ("homing", "i8"),  # ORG was seen
        ("counting", "i8"),  # EZ edges count
        ("ez_left", "i8"),  # EZ edges to let pass
        ("ez_running", "i8"),  # the first EZ edge has come
        # what this variant has beyond the 240K: variants differ by data alone
        ("extended", "i8"),  # MK and MS
        ("s_curves", "i8"),  # MS; it has the EZ monitor, too
        ("reg", "i8", (REGISTERS,)),  # R0 to R7, R10 to R17
        ("mask", "i8", (REGISTERS,)),  # what can be written to each
        ("top_bit", "i8"),  # the sign of R6 as an offset
    ]
)
"""One chip."""

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
SYNI = WIRE_BIT
"""Above this bit the word of inputs has what SYNI brings: R7 of the leader plus 1; 0 while it is not connected."""
ALL_INPUTS = (1 << SYNI) - 1
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
"""A chip from one of its changes on, for recordings."""


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
    read_pins(c)


@hot
def read_pins(c):
    """Pins, R7, or the bits that say how pins are read, may have changed: what the chip makes of them from now on."""
    turned = (ORG if c.reg[R13] & ORG_POSITIVE else 0) | (EZ if c.reg[R12] & EZ_POSITIVE else 0)
    c.seen = (c.inputs & ALL_INPUTS) ^ turned
    c.multiplier = (c.inputs >> SYNI) - 1 if c.inputs >> SYNI else c.reg[7]
    c.phase = least(c.phase, greatest(8192 * c.multiplier - 1, 0))


@hot
def begin(c):
    """Clear what one run does not take over from the last."""
    c.phase = c.timer = c.ramp = c.curved = c.fall = 0
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
