"""NOVA chips, compiled: the records that hold a chip and its axes, their pins, and the names of bits, taken from the maps."""

from __future__ import annotations

import numpy as np

from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.native import record

AXES = 4
REGISTERS = 32
SEGMENTS = 12
INPUT_PINS = 17
PIECES = 4
SYNC_SETS = 4
FIRST_GENERATION, MCX514_TYPE = 0, 1
NEVER = 1 << 60

# places in `reg`: the code of the command that writes it, the same on all chips as far as they share it
JK, DJ, AC, DC, SV, DV, TP, DP, CP, LP, RP, SP, SM, AO, LX, RX, MR0 = range(17)
HV, IV, TM, SP1, SP2, TX, HLN, HLV = range(0x14, 0x1C)
R, K, A, D, V, P, C, EP, COMP_PLUS, COMP_MINUS, L = JK, DJ, AC, DC, DV, TP, CP, RP, SP, SM, LX

ACCELERATING, CONSTANT, DECELERATING, AREA_D, RUNAWAY = 1, 0, -1, 2, 3
"""What a segment of a speed profile is. AREA_D: the acceleration reads 0 at the end of an S-curve; RUNAWAY: after the erratum."""

_PROFILE = [
    ("origin", "i8"), ("segments", "i8"), ("end", "i8"), ("brake", "i8"),
    ("from_clock", "i8", (SEGMENTS,)), ("from_pulse", "i8", (SEGMENTS,)), ("kind", "i8", (SEGMENTS,)),
    ("t", "f8", (SEGMENTS, 2)), ("p", "f8", (SEGMENTS, 2)), ("v", "f8", (SEGMENTS, 2)),
    ("a2", "f8", (SEGMENTS, 2)), ("j6", "f8", (SEGMENTS, 2)),
    ("cursor", "f8", (4, 2)), ("piece", "f8", (PIECES, 3, 2)), ("course", "f8", (PIECES, 3, 2)),
    ("sv", "f8", (2,)), ("dv", "f8", (2,)), ("up", "f8", (2,)), ("down", "f8", (2,)), ("up_jerk", "f8", (2,)),
    ("down_jerk", "f8", (2,)), ("finest", "f8", (2,)),
    ("curved", "i8"),
]  # fmt: skip
"""The speed profile of a drive in progress: pieces of a cubic in the clocks since `origin`. All floats are double-doubles (see
dd.py) in pulses and clocks. A segment: begins `t` clocks after the origin (whole: from_clock, the first clock at or after it), with
from_pulse + p pulses done, at speed v, with half its acceleration a2 and a sixth of its jerk j6; the last one lasts for ever.
end: clock after the origin at which the drive ends whatever its pulses; brake: the segment that begins the automatic deceleration.
cursor: t, p, v, a where the next segment would begin; piece: durations, accelerations and jerks of a change of speed that is
drafted, course: of one that is kept meanwhile. sv to down_jerk: the drive's speeds, accelerations and jerks; finest: the
acceleration below which the chip shows none (erratum); curved: S-curve."""

AXIS = record(
    [(name, "i8") for name in (
        "driving waiting held way sense fixed output done slow absolute "  # the drive in progress
        "total net "  # pulses ever, plus minus minus
        "moment shift since "  # of interpolated pulses since mean_count asked: sum of the clocks, net count, first clock
        "inputs level "  # pins now, and after the filters
        "phase factors fired finish "  # last phase seen; RR1 (MCX514), the same not yet seen by the sync actions; RR2 (MCX514)
        "timer timer_from dcc "  # clocks: the timer is up (0: stopped), it began; DCC ends
        "split split_on split_left split_rise split_fall "  # see split_pulse.py; rise, fall: at which `total`
        "sync triggered acted ports "  # SYNC sets: enabled, due, done at this clock; PIO levels last seen
        "home found pause seeks creeps go go_count "  # see home.py; go: direction of a drive that is asked for
        "holds compared "  # which comparisons hold now; RR3 (MCX304)
        "interpolates moves "  # 1: takes part in an interpolation, 2: as its main axis; its segment moves the axis
        "high "  # until when the pulse output is, in a scan
        "ahead due at "  # in a trace: pulses logged before they begin; when, and in which segment, the next one begins
        "pps rest "  # the same: speed and place of that segment, where its pulses come evenly, see pulses.py
        # the modes of WR1 to WR3 in plain terms
        "stops limits limit_slow alarm_stops inpos_waits soft_plus soft_minus soft_rp soft_instant "
        "manual asymmetric s_curve prevents swaps encoder exchanges filtered delay slow_delay"
    ).split()]
    + [("reg", "i8", (REGISTERS,)), ("mode", "i8", (16,)), ("wr", "i8", (4,)), ("pending", "i8", (INPUT_PINS,))]
    + [("pulse_until", "i8", (SYNC_SETS,))]
    + _PROFILE
)  # fmt: skip
"""One axis. done: pulses of this drive that have begun; output: how many it will make (fixed = 1). held: a drive command waits for
78h. slow: it brakes for a stop; of an axis that interpolates: 1 asks for that, 2 for an instant stop. waiting: all pulses are
out, INPOS is awaited. mode: registers 20h to 2Fh. pending: clocks at which filtered inputs follow; pulse_until: at which sync
pulses on PIO end. seeks: the home search looks after the limits; creeps: its drive runs at HV."""

LINE, ARC, PATTERN, HELIX = range(1, 5)
STAGES = 8  # of the pre-buffer; one more place holds the running segment

SEGMENT = record(
    [(name, "i8") for name in "kind axes vector fine slows longest turns mirror".split()]
    + [("axis", "i8", (AXES,)), ("finish", "i8", (AXES,)), ("centre", "i8", (2,))]
)  # fmt: skip
"""One segment of an interpolation, as its command captured it. Its `axes` axes have places 0, 1, ...: `axis` says which they are.
vector: how many of them constant vector speed looks at, 0: off; fine: 8 inner ticks a tick, where short-axis pulses are equalized,
else 1; slows: deceleration was enabled; longest: ticks of a line, of a helix the ticks in which the other axes make their pulses;
turns: of a helix, before the arc; mirror: -1 clockwise. finish: relative, of a bit pattern + in the low, - in the high 16 bits."""

ARC_STATE = record([(name, "i8") for name in "x y off octant passed target goal_x goal_y".split()])
"""A circle in progress, counter-clockwise (a clockwise one is mirrored in y). x, y: about the centre; off: x^2 + y^2 - radius^2;
octant: of the next tick; passed, target: octants entered, and how many it takes into the one of the finish point."""

INTERPOLATION = record(
    [(name, "i8") for name in (
        "enabled interrupt "  # 6Dh, 3Bh; an interrupt asks
        "main mask depth head waiting began continuous stepped speed slow ends "
        "due watch piece last closing left rotations turns zone "
        "writing stacked"  # bit patterns of the MCX312
    ).split()]
    + [(name, "i8", (AXES,)) for name in "step toward error inner loading".split()]
    + [("arc", ARC_STATE), ("probe", ARC_STATE), ("stack", "i8", (3, 4))]
    + [(name, "f8", (2,)) for name in "place begun finish".split()]
)  # fmt: skip
"""The interpolation in progress. main: its main axis, whose profile makes the ticks; mask: the axes that take part; head, waiting:
the running segment in `queue`, and how many wait behind it, `depth` at most; began: clock of the start; continuous: there has been
a second segment; stepped: ticks come by command; speed: DV of the present plan; slow: it brakes for a stop; ends: the plan ends at
SV. The next tick is prepared: due: its clock; place: where in the profile it is; step: which places of the segment make a pulse,
toward: in which direction, inner: their ways in inner ticks; last: the segment ends with it; closing: it has no pulses and ends it
all. watch: ticks until somebody looks at a counter; piece: segment of the profile; left: ticks of the segment still to prepare;
error: of the slower axes; turns: still to go; begun, finish: where in the profile the segment begins and ends (if it slows).
writing: WR2 to WR5 load the pattern `loading`; stack: sets that wait for 34h."""

STATE = record(
    [(name, "i8") for name in (
        "clock quiet stale variant axes errata has_l "
        "selected low high read_low read_high pages outputs4 outputs5 emg emg_seen total interrupt "
        "interpolating first unused"
    ).split()]
    + [("ip", INTERPOLATION), ("queue", SEGMENT, (STAGES + 1,)), ("ax", AXIS, (AXES,))]
)  # fmt: skip
"""One chip. quiet: the clock up to which nothing happens but pulses, if not stale: inputs or registers have changed since.
selected: axis bits; low, high: WR6, WR7; read_low, read_high: RR6, RR7; pages: axes whose RR3 shows page 1.
first: the high byte of WR0, waiting for the low one; unused: WR6 or WR7 was written after the last command."""

INPUTS = {
    name: 1 << k
    for k, name in enumerate(
        [
            "lmt_plus",
            "lmt_minus",
            "stop0",
            "stop1",
            "stop2",
            "inpos",
            "alarm",
            "eca",
            "ecb",
            *(f"pio{i}" for i in range(8)),
        ]
    )
}
LMT_PLUS, LMT_MINUS, STOP0, STOP1, STOP2, INPOS, ALARM, ECA, ECB = (1 << k for k in range(9))
PIO = 9
EMG = 1
COMMON_INPUTS = {"emg": EMG}
OUTPUTS = {
    name: 1 << k
    for k, name in enumerate(
        ["pls", "dir", "drive", "asnd", "cnst", "dsnd", "dcc", "split", *(f"out{i}" for i in range(8))]
    )
}
OUT = 1 << 8  # out0
PLS, DIR, DRIVE, ASND, CNST, DSND, DCC, SPLIT = (1 << k for k in range(8))
COMMON_OUTPUTS = {"int0": 1, "int1": 2}

# events, as in RR1 of the MCX514; and RR2: errors in the low byte, finishing status in the high one
D_STA, C_STA, C_END, D_END, H_END, TIMER, SPLTP, SPLTE = (MCX514_MAP.mask("RR1", name) for name in (
    "D-STA", "C-STA", "C-END", "D-END", "H-END", "TIMER", "SPLTP", "SPLTE"))  # fmt: skip
SPLIT_START = 1 << 16  # not in RR1
E_SLMT_PLUS, E_SLMT_MINUS, E_HLMT_PLUS, E_HLMT_MINUS, E_ALARM, E_EMG, E_HOME, E_CERR = (1 << k for k in range(8))
F_SYNC, F_STOP0, F_STOP1, F_STOP2, F_LMT_PLUS, F_LMT_MINUS, F_ALARM, F_EMG = (1 << k for k in range(8, 16))

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net".split()] + [("rate", "f8")])
