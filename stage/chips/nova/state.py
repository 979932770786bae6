"""NOVA chips, compiled: the records that hold a chip and its axes, their pins, and the names of bits, taken from the maps."""

from __future__ import annotations

import numpy as np

from stage.chips.nova.registers.mcx300 import MCX312_MAP
from stage.chips.nova.registers.mcx514 import MCX512_MAP, MCX514_MAP
from stage.chips.register_map import RegisterMap
from stage.native import record

AXES = 4
REGISTERS = 32
MAX_PIECES = 12
INPUT_PINS = 23
DRAFTED = 4
SYNC_SETS = 4
FIRST_GENERATION, MCX514_TYPE = 0, 1
NEVER = 1 << 60
MAIN = 2  # of `interpolates`: the main axis
MASTER, SLAVE = 1, 2  # MLT of IPM: this chip's role in an interpolation of several


def _places(map_: RegisterMap, names: str) -> tuple[int, ...]:
    return tuple(map_.register(name).number for name in names.split())


# places in `reg`: the code of the command that writes it, the same on all chips as far as they share it
JK, DJ, AC, DC, SV, DV, TP, DP, CP, LP, RP, SP, SM, AO, LX, RX, MR0 = _places(
    MCX514_MAP, "JK DJ AC DC SV DV TP DP CP LP RP SP SM AO LX RX MR0"
)
HV, IV, TM, SP1, SP2, TX, HLN, HLV = _places(MCX514_MAP, "HV IV TM SP1 SP2 TX HLN HLV")
R, K, A, D, V, P, C, EP, COMP_PLUS, COMP_MINUS, L = _places(MCX312_MAP, "R K A D V P C EP CP CM L")
MODES = 16
MODE_FIRST = MCX514_MAP.register("MRM").number
# places in `mode`: the same, counted from 20h
MRM, P1M, P2M, H1M, H2M, FLM, S0M, IPM = (
    k - MODE_FIRST for k in _places(MCX514_MAP, "MRM P1M P2M H1M H2M FLM S0M IPM")
)
P3M = MCX512_MAP.register("P3M").number - MODE_FIRST
HM, EM = H1M, MRM  # of the older chips; of EM the word in WR6, HM has that in WR7

ACCELERATING, CONSTANT, DECELERATING, AREA_D, RUNAWAY = 1, 0, -1, 2, 3
"""What a piece of a speed profile is. AREA_D: the acceleration reads 0 at the end of an S-curve; RUNAWAY: after the erratum."""
NO_PHASE = -9
"""`phase` of an axis whose drive has no piece yet, or none any more."""

_PROFILE = [  # of the drive in progress: pieces of a cubic in the clocks since `origin`
    ("origin", "i8"),  # clock
    ("pieces", "i8"),  # how many there are
    ("end", "i8"),  # clocks after the origin at which the drive ends whatever its pulses
    ("brake", "i8"),  # the piece that begins the automatic deceleration
    # pieces; the last one lasts for ever
    ("from_clock", "i8", (MAX_PIECES,)),  # the first whole clock at or after `t`
    ("from_pulse", "i8", (MAX_PIECES,)),  # pulses done where it begins, whole ones
    ("kind", "i8", (MAX_PIECES,)),  # ACCELERATING ...
    ("t", "f8", (MAX_PIECES, 2)),  # clocks after the origin at which it begins
    ("p", "f8", (MAX_PIECES, 2)),  # pulses done where it begins, beyond `from_pulse`
    ("v", "f8", (MAX_PIECES, 2)),  # speed there, pulses a clock
    ("a2", "f8", (MAX_PIECES, 2)),  # half its acceleration
    ("j6", "f8", (MAX_PIECES, 2)),  # a sixth of its jerk
    # planner
    ("cursor", "f8", (4, 2)),  # t, p, v, a where the next piece would begin
    ("piece", "f8", (DRAFTED, 3, 2)),  # durations, accelerations, jerks of a change of speed that is drafted
    ("course", "f8", (DRAFTED, 3, 2)),  # the same of one that is kept meanwhile
    ("sv", "f8", (2,)),  # initial speed, pulses a clock
    ("dv", "f8", (2,)),  # drive speed
    ("up", "f8", (2,)),  # acceleration, pulses a clock2
    ("down", "f8", (2,)),  # deceleration
    ("up_jerk", "f8", (2,)),  # pulses a clock3
    ("down_jerk", "f8", (2,)),
    ("finest", "f8", (2,)),  # acceleration below which the chip shows none (erratum)
    ("curved", "i8"),  # S-curve
]
"""All floats are double-doubles (see double_double.py) in pulses and clocks."""

AXIS = record(
    [
        # the drive in progress
        ("driving", "i8"),  # there is one
        ("waiting", "i8"),  # all pulses are out, INPOS is awaited
        ("held", "i8"),  # a drive command waits for DFREE, START_FREE
        ("way", "i8"),  # direction, 1 or -1
        ("sense", "i8"),  # -1: the sign of TP is inverted, else 1
        ("fixed", "i8"),  # it makes `output` pulses; else it goes on
        ("output", "i8"),  # pulses it will make
        ("done", "i8"),  # pulses of it that have begun
        ("slow", "i8"),  # it brakes for a stop; of an axis that interpolates: 1 decelerating stop, 2 instant stop
        ("absolute", "i8"),  # to an absolute position
        ("total", "i8"),  # pulses ever
        ("net", "i8"),  # the same, plus minus minus
        ("net_at_reset", "i8"),  # where A and B of the pulse output begin a period
        # interpolated pulses since the last drive_input
        ("moment", "i8"),  # sum of their clocks, each with its sign
        ("shift", "i8"),  # plus minus minus
        ("since", "i8"),  # clock of the first
        ("inputs", "i8"),  # INPUTS now
        ("level", "i8"),  # INPUTS after the filters
        ("turned", "i8"),  # INPUTS that the chip reads as active high: the level bits of WR1, WR2
        ("active", "i8"),  # INPUTS as the chip reads them: `level`, turned
        ("phase", "i8"),  # kind of the piece seen last
        ("factors", "i8"),  # RR1 of the MCX514, and SPLIT_START
        ("fired", "i8"),  # those that the sync actions have not seen
        ("causes", "i8"),  # RR2 of the MCX514
        ("timer", "i8"),  # the clock at which it is up; 0: stopped
        ("timer_from", "i8"),  # the clock at which it began
        ("dcc", "i8"),  # the clock at which DCC ends
        # split pulses, see split_pulse.py
        ("split", "i8"),  # they run
        ("split_on", "i8"),  # the output is on
        ("split_left", "i8"),  # how many to come
        ("split_rise", "i8"),  # `total` at which the next begins
        ("split_fall", "i8"),  # `total` at which it ends
        # SYNC sets, bit 0 for SYNC0
        ("sync", "i8"),  # enabled
        ("triggered", "i8"),  # due
        ("acted", "i8"),  # done at this clock
        ("ports", "i8"),  # PIO levels seen last
        ("exp", "i8"),  # levels of EXP+, EXP- seen last, see external.py
        ("exp_drives", "i8"),  # which of them keeps a continuous drive on
        # home search, see home.py
        ("home", "i8"),  # its state; 0: none
        ("found", "i8"),  # what it met: LIMIT, SIGNAL of home.py
        ("pause", "i8"),  # the clock at which the timer between steps is up
        ("seeks", "i8"),  # it looks after the limits
        ("creeps", "i8"),  # its drive runs at HV
        ("go", "i8"),  # direction of the commanded drive
        ("go_count", "i8"),  # pulses of it
        # comparisons
        ("holds", "i8"),  # which hold now
        ("compared", "i8"),  # RR3 of the older chips
        # interpolation
        ("interpolates", "i8"),  # 1: takes part, 2: as the main axis
        ("moves", "i8"),  # the segment moves the axis
        # scan and trace
        ("high", "i8"),  # the clock at which a pulse goes off that the plan in force does not tell, see pulse_output.py
        ("ahead", "i8"),  # pulses logged before they begin
        ("due", "i8"),  # the clock at which the next pulse begins
        ("at", "i8"),  # the piece in which it does
        ("pps", "i8"),  # speed of that piece where its pulses come evenly, see trace.py
        ("rest", "i8"),  # and the place in it
        # WR1 to WR3 in plain terms
        ("stops", "i8"),  # which of STOP0 to STOP2 stop, bit 0 for STOP0
        ("limits", "i8"),  # LMT+, LMT- stop
        ("limit_slow", "i8"),  # they decelerate
        ("alarm_stops", "i8"),
        ("inpos_waits", "i8"),
        ("soft_plus", "i8"),  # the software limit + stops
        ("soft_minus", "i8"),
        ("soft_rp", "i8"),  # software limits look at RP, EP
        ("soft_instant", "i8"),  # they stop at once
        ("manual", "i8"),  # deceleration begins at DP
        ("asymmetric", "i8"),  # deceleration has registers of its own
        ("s_curve", "i8"),
        ("prevents", "i8"),  # triangle prevention
        ("clears", "i8"),  # STOP2 clears EP
        ("swaps", "i8"),  # LMT+ and LMT- are exchanged
        ("encoder", "i8"),  # 0 x4, 1 x2, 2 x1, 3 up / down
        ("exchanges", "i8"),  # the encoder counts the other way round
        # the shaft of its encoder, see encoder.py: at shaft + shaft_rate * (clock - seen)
        ("seen", "i8"),
        ("edge", "i8"),  # the edge that it has passed last
        ("shaft", "f8"),  # edges
        ("shaft_rate", "f8"),  # edges a clock
        ("filtered", "i8"),  # INPUTS that have a filter
        ("delay", "i8"),  # clocks of the filters ...
        ("slow_delay", "i8"),  # ... and of those of STOP2, ECA, ECB
        ("reg", "i8", (REGISTERS,)),  # by place, see above
        ("mode", "i8", (MODES,)),  # mode registers 20h to 2Fh
        ("wr", "i8", (4,)),  # WR1 to WR3 under their own number
        ("pending", "i8", (INPUT_PINS,)),  # clocks at which filtered inputs follow
        ("pulse_until", "i8", (SYNC_SETS,)),  # clocks at which sync pulses on PIO end
        *_PROFILE,
    ]
)
"""One axis."""

LINE, ARC, PATTERN, HELIX = range(1, 5)
STAGES = 8  # of the pre-buffer; one more place holds the running segment

SEGMENT = record(
    [
        ("kind", "i8"),  # LINE, ARC, PATTERN, HELIX
        ("axes", "i8"),  # how many take part; they have places 0, 1 ...
        ("vector", "i8"),  # how many of them constant vector speed looks at, 0: off
        ("fine", "i8"),  # inner ticks a tick: 8 where short-axis pulses are equalized, else 1
        ("slows", "i8"),  # deceleration was enabled
        ("longest", "i8"),  # ticks of a line; of a helix those in which the other axes make their pulses
        ("turns", "i8"),  # of a helix, before the arc
        ("mirror", "i8"),  # -1 clockwise
        ("axis", "i8", (AXES,)),  # which axis has a place
        (
            "finish",
            "i8",
            (AXES,),
        ),  # relative finish point, pulses; of a bit pattern + in the low, - in the high 16 bits
        ("centre", "i8", (2,)),  # relative, pulses
    ]
)
"""One segment of an interpolation, as its command captured it."""

ARC_STATE = record(
    [
        ("x", "i8"),  # pulses from the centre
        ("y", "i8"),
        ("off", "i8"),  # x^2 + y^2 - radius^2
        ("octant", "i8"),  # of the next tick
        ("passed", "i8"),  # octants entered
        ("target", "i8"),  # how many it takes into the one of the finish point
        ("goal_x", "i8"),  # finish point, pulses from the centre
        ("goal_y", "i8"),
    ]
)
"""A circle in progress, counter-clockwise; a clockwise one is mirrored in y."""

INTERPOLATION = record(
    [
        ("enabled", "i8"),  # deceleration at the end: 6Dh, 3Bh
        ("interrupt", "i8"),  # it asserts the interrupt
        ("main", "i8"),  # its main axis, whose profile makes the ticks
        ("mask", "i8"),  # axes that take part, bit 0 for X
        ("depth", "i8"),  # segments that can wait
        ("head", "i8"),  # the running segment in `queue`
        ("waiting", "i8"),  # segments behind it
        ("began", "i8"),  # clock of the start
        ("continuous", "i8"),  # there has been a second segment
        ("stepped", "i8"),  # ticks come by command, or from the master
        ("speed", "i8"),  # DV of the present plan
        ("slow", "i8"),  # it brakes for a stop
        ("ends", "i8"),  # the plan ends at SV
        # the next tick, prepared
        ("due", "i8"),  # its clock
        ("watch", "i8"),  # ticks until a counter is compared
        ("piece", "i8"),  # piece of the profile
        ("last", "i8"),  # the segment ends with it
        ("closing", "i8"),  # it has no pulses and ends it all
        ("left", "i8"),  # ticks of the segment still to prepare
        ("rotations", "i8"),  # turns that a helix has made
        ("turns", "i8"),  # turns still to go
        ("zone", "i8"),  # octant, for RR0
        # several chips, see multichip.py
        ("role", "i8"),  # MASTER, SLAVE; 0: by itself
        ("waits", "i8"),  # for the start of all
        ("fixed", "i8"),  # its maximum finish point is TX
        ("errors", "i8"),  # of RR2 as it began, a byte an axis
        ("beat", "i8"),  # of a slave: clock of the last tick
        ("gap", "i8"),  # clocks between the last two
        # bit patterns of the MCX312
        ("writing", "i8"),  # WR2 to WR5 load `loading`
        ("stacked", "i8"),  # sets that wait for 34h
        ("step", "i8", (AXES,)),  # which places of the segment make a pulse
        ("toward", "i8", (AXES,)),  # in which direction, 1 or -1
        ("error", "i8", (AXES,)),  # of the slower axes
        ("inner", "i8", (AXES,)),  # ways in inner ticks
        ("loading", "i8", (6,)),  # the bit pattern that is being written
        ("arc", ARC_STATE),  # the running circle
        ("probe", ARC_STATE),  # one that looks ahead
        ("stack", "i8", (3, 6)),  # the sets that wait
        ("place", "f8", (2,)),  # where in the profile the next tick is, pulses
        ("begun", "f8", (2,)),  # where the segment begins
        ("ends_at", "f8", (2,)),  # where it ends, if it slows
    ]
)
"""The interpolation in progress."""

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("quiet", "i8"),  # the clock up to which nothing happens but pulses, if not stale
        ("stale", "i8"),  # inputs or registers have changed since `quiet` was found
        ("variant", "i8"),  # FIRST_GENERATION, MCX514_TYPE
        ("axes", "i8"),  # how many it has
        ("errata", "i8"),  # as sold, with the S-curve failure
        ("has_l", "i8"),  # MCX312, MCX314As: register L, interpolation
        ("extended", "i8"),  # MCX314As: EM, STOP3, lines of three axes
        ("selected", "i8"),  # axis bits, bit 0 for X
        ("low", "i8"),  # WR6
        ("high", "i8"),  # WR7
        ("read_low", "i8"),  # RR6
        ("read_high", "i8"),  # RR7
        ("pages", "i8"),  # axes whose RR3 shows page 1
        ("outputs4", "i8"),  # WR4
        ("outputs5", "i8"),  # WR5
        ("emg", "i8"),  # the pin EMG
        ("emergency", "i8"),  # the same after its filter
        ("emg_pending", "i8"),  # the clock at which it follows the pin
        ("total", "i8"),  # pulses ever, all axes
        ("interpolating", "i8"),  # an interpolation is on
        ("first", "i8"),  # high byte of WR0, waits for the low one
        ("unused", "i8"),  # WR6 or WR7 was written after the last command
        ("fed", "i8"),  # axes that have an encoder, bit 0 for X
        # the wires to other chips, see multichip.py
        ("heard", "i8"),  # what is on them
        ("beats", "i8"),  # ticks that it has ever sent as a master
        ("fails", "i8"),  # it tells the others of an error
        ("failed", "i8"),  # MCERR
        ("ip", INTERPOLATION),
        ("queue", SEGMENT, (STAGES + 1,)),  # the running segment and those that wait, in a ring
        ("ax", AXIS, (AXES,)),
    ]
)
"""One chip."""

_SIGNALS = ("lmt_plus", "lmt_minus", "stop0", "stop1", "stop2", "inpos", "alarm", "eca", "ecb")
INPUTS = {name: 1 << k for k, name in enumerate((*_SIGNALS, *(f"pio{i}" for i in range(8))))}
LMT_PLUS, LMT_MINUS, STOP0, STOP1, STOP2, INPOS, ALARM, ECA, ECB = (1 << k for k in range(9))
PIO = 9
EXP = PIO + 4  # EXP+, then EXP-
INPUTS_300 = {name: 1 << k for k, name in enumerate(_SIGNALS)} | {"exp_plus": 1 << EXP, "exp_minus": 2 << EXP}
"""Of the chips before the MCX514."""
STOP3 = 1 << PIO
INPUTS_314 = INPUTS_300 | {"stop3": STOP3}
INPUTS_512 = INPUTS | {f"pio{i}": 1 << PIO + i for i in range(8, 14)}  # PIO8 to PIO13
EMG_FILTER = 1 << INPUT_PINS  # of `filtered`, of X
EMG = 1
COMMON_INPUTS = {"emg": EMG}
OUTPUTS = {
    name: 1 << k
    for k, name in enumerate(
        ["pls", "dir", "drive", "asnd", "cnst", "dsnd", "dcc", "split", *(f"out{i}" for i in range(8))]
    )
}
OUT = 1 << 8  # out0
OUTPUTS_512 = OUTPUTS | {f"out{i}": OUT << i for i in range(8, 14)}
PLS, DIR, DRIVE, ASND, CNST, DSND, DCC, SPLIT = (1 << k for k in range(8))
COMMON_OUTPUTS = {"int0": 1, "int1": 2}

# events, as in RR1 of the MCX514; and RR2: errors in the low byte, finishing status in the high one
D_STA, C_STA, C_END, D_END, H_END, TIMER, SPLTP, SPLTE = (MCX514_MAP.mask("RR1", name) for name in (
    "D-STA", "C-STA", "C-END", "D-END", "H-END", "TIMER", "SPLTP", "SPLTE"))  # fmt: skip
SPLIT_START = 1 << 16  # not in RR1
E_SLMT_PLUS, E_SLMT_MINUS, E_HLMT_PLUS, E_HLMT_MINUS, E_ALARM, E_EMG, E_HOME, E_CERR = MCX514_MAP.masks(
    "RR2", "SLMT+", "SLMT-", "HLMT+", "HLMT-", "ALARM", "EMG", "HOME", "CERR"
)
F_SYNC, F_STOP0, F_STOP1, F_STOP2, F_LMT_PLUS, F_LMT_MINUS, F_ALARM, F_EMG = MCX514_MAP.masks(
    "RR2", "SYNC", "STOP0", "STOP1", "STOP2", "LMT+", "LMT-", "END-ALARM", "END-EMG"
)
F_STOP3 = F_SYNC  # of the MCX314As, which has no such cause

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record(
    [
        ("clock", "i8"),  # from here on
        ("inputs", "i8"),  # INPUTS
        ("outputs", "i8"),  # OUTPUTS
        ("counter", "i8"),  # LP
        ("net", "i8"),  # pulses ever, plus minus minus
        ("rate", "f8"),  # pulses a clock
    ]
)
"""An axis from one of its changes on, for recordings."""
