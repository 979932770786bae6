"""State of the NOVA chips as records for compiled code: chip, axes, interpolation; their pins, and bits named after the maps."""

from __future__ import annotations

import numpy as np

from stage.chips.nova.registers.mcx300 import MCX312_MAP
from stage.chips.nova.registers.mcx514 import MCX512_MAP, MCX514_MAP
from stage.chips.register_map import RegisterMap
from stage.native import record

MAX_CHIP_AXES = 4
REGISTERS = 32
MAX_PIECES = 12
INPUT_PINS = 23
MAX_DRAFTED_PIECES = 4
SYNC_SETS = 4
FIRST_GENERATION, MCX514_TYPE = 0, 1
NEVER = 1 << 60
MAIN = 2  # value of `interpolates`: the main axis
MASTER, SLAVE = 1, 2  # MLT of IPM: this chip's role in an interpolation of several


def _find_register_numbers(map_: RegisterMap, names: str) -> tuple[int, ...]:
    """Return the numbers of registers by their names, separated by spaces."""
    return tuple(map_.register(name).number for name in names.split())


# indices in `reg`: the code of the command that writes the register; chips that share a register share its code
JK, DJ, AC, DC, SV, DV, TP, DP, CP, LP, RP, SP, SM, AO, LX, RX, MR0 = _find_register_numbers(
    MCX514_MAP, "JK DJ AC DC SV DV TP DP CP LP RP SP SM AO LX RX MR0"
)
HV, IV, TM, SP1, SP2, TX, HLN, HLV = _find_register_numbers(MCX514_MAP, "HV IV TM SP1 SP2 TX HLN HLV")
R, K, A, D, V, P, C, EP, COMP_PLUS, COMP_MINUS, L = _find_register_numbers(MCX312_MAP, "R K A D V P C EP CP CM L")
MODE_REGISTER_COUNT = 16
MODE_FIRST = MCX514_MAP.register("MRM").number
# indices in `mode`: the code of the command that writes the mode register, minus 20h
MRM, P1M, P2M, H1M, H2M, FLM, S0M, IPM = (
    k - MODE_FIRST for k in _find_register_numbers(MCX514_MAP, "MRM P1M P2M H1M H2M FLM S0M IPM")
)
P3M = MCX512_MAP.register("P3M").number - MODE_FIRST
HM, EM = H1M, MRM  # of the older chips; EM holds the word in WR6, HM the word in WR7

ACCELERATING, CONSTANT, DECELERATING, AREA_D, RUNAWAY = 1, 0, -1, 2, 3
"""Phases of a speed profile. AREA_D: the acceleration reads 0 at the end of an S-curve; RUNAWAY: no end (erratum)."""
NO_PHASE = -9
"""`phase` of an axis without a drive."""

_PROFILE = [  # of the drive in progress: pieces, each a cubic polynomial of the clocks since `origin`
    ("origin", "i8"),  # clock
    ("pieces", "i8"),  # number of pieces
    ("end_time", "i8"),  # clocks after the origin at which the drive ends, whatever number of pulses it has made
    ("brake_piece", "i8"),  # number of the piece that begins the automatic deceleration
    # pieces; the last one lasts for ever
    ("from_clock", "i8", (MAX_PIECES,)),  # the first whole clock at or after `t`
    ("from_pulse", "i8", (MAX_PIECES,)),  # whole pulses that the drive has made where it begins
    ("piece_phase", "i8", (MAX_PIECES,)),  # ACCELERATING ...
    ("t", "f8", (MAX_PIECES, 2)),  # clocks after the origin at which it begins
    ("p", "f8", (MAX_PIECES, 2)),  # the rest of the pulses where it begins: a fraction beyond `from_pulse`
    ("v", "f8", (MAX_PIECES, 2)),  # speed where it begins, pulses per clock
    ("a2", "f8", (MAX_PIECES, 2)),  # half of its acceleration
    ("j6", "f8", (MAX_PIECES, 2)),  # a sixth of its jerk
    # planner
    ("cursor", "f8", (4, 2)),  # time, place, speed and acceleration at the end of the plan so far
    # durations, accelerations, jerks of a drafted change of speed
    ("drafted_pieces", "f8", (MAX_DRAFTED_PIECES, 3, 2)),
    ("stored_draft", "f8", (MAX_DRAFTED_PIECES, 3, 2)),  # the same of a draft that waits while others are tried
    ("sv", "f8", (2,)),  # initial speed, pulses per clock
    ("dv", "f8", (2,)),  # drive speed
    ("acceleration", "f8", (2,)),  # acceleration, pulses per clock squared
    ("deceleration", "f8", (2,)),  # deceleration
    ("acceleration_jerk", "f8", (2,)),  # jerk of the acceleration, pulses per clock cubed
    ("deceleration_jerk", "f8", (2,)),
    ("min_visible_acceleration", "f8", (2,)),  # acceleration below which the chip reads 0 (erratum)
    ("curved", "i8"),  # S-curve
]
"""All floats are double-doubles (see double_double.py) in pulses and clocks."""

AXIS = record(
    [
        # the drive in progress
        ("driving", "i8"),  # a drive is in progress
        ("awaits_inpos", "i8"),  # all pulses are made, and the drive waits for INPOS
        ("start_hold", "i8"),  # bit 0: drive start hold; above it the drive command that waits for its end
        ("direction", "i8"),  # direction, 1 or -1
        ("pulse_sign", "i8"),  # -1: the sign of TP is inverted, else 1
        ("fixed", "i8"),  # the drive makes `output_pulses` and ends; else it has no end
        ("output_pulses", "i8"),  # number of pulses of the drive
        ("pulses_done", "i8"),  # pulses of the drive that have begun
        ("stopping", "i8"),  # the drive brakes for a stop; during interpolation: 1 decelerating stop, 2 instant stop
        ("absolute", "i8"),  # the drive goes to an absolute position
        ("total", "i8"),  # pulses since power-up
        ("net", "i8"),  # net pulses since power-up
        ("net_at_reset", "i8"),  # `net` at the last reset, where A and B of the pulse output begin a period
        # interpolated pulses since the last drive_input
        ("pulse_clock_sum", "i8"),  # sum of their clocks, negative for pulses in - direction
        ("recent_net", "i8"),  # their net number
        ("first_pulse_clock", "i8"),  # clock of the first of them
        ("inputs", "i8"),  # INPUTS now
        ("filtered_inputs", "i8"),  # INPUTS after the filters
        ("active_high_inputs", "i8"),  # INPUTS that are active high, by the level bits of WR1 and WR2
        ("active_inputs", "i8"),  # INPUTS that are active: `filtered_inputs`, inverted where they are active high
        ("phase", "i8"),  # phase of the speed profile at the last check
        ("events", "i8"),  # RR1 of the MCX514, and SPLIT_START
        ("new_events", "i8"),  # events since the last check of the synchronous actions
        ("stop_causes", "i8"),  # errors and finishing status, as RR2 of the MCX514
        ("timer_end", "i8"),  # the clock at which the timer expires; 0: stopped
        ("timer_start", "i8"),  # the clock at which the timer began
        ("dcc_end", "i8"),  # the clock at which DCC ends
        # split pulses, see split_pulse.py
        ("split_running", "i8"),  # split pulses are enabled
        ("split_output", "i8"),  # the split pulse output is on
        ("split_pulses_left", "i8"),  # number of split pulses that remain
        ("next_split_rise", "i8"),  # `total` at which the next split pulse begins
        ("next_split_fall", "i8"),  # `total` at which the present split pulse ends
        # SYNC sets, bit 0 for SYNC0
        ("enabled_sets", "i8"),  # sets that are enabled
        ("due_sets", "i8"),  # sets that were activated and have not acted
        ("finished_sets", "i8"),  # sets that have acted at this clock
        ("last_port_levels", "i8"),  # PIO levels at the last check
        ("last_exp_levels", "i8"),  # levels of EXP+ and EXP- at the last check, see external_drives.py
        ("exp_driving", "i8"),  # the pin that keeps a continuous drive in progress
        # home search, see home_search.py
        ("home_state", "i8"),  # state of the home search; 0: none
        ("home_trigger", "i8"),  # what ended the drive of a step: LIMIT or SIGNAL of home_search.py
        ("pause_end", "i8"),  # the clock at which the pause between two steps ends
        ("home_handles_limits", "i8"),  # the home search, not the drive, applies the limits
        ("drives_at_hv", "i8"),  # the drive of the step runs at HV
        ("launch_direction", "i8"),  # direction of the drive that a step has requested; 0: none
        ("launch_pulses", "i8"),  # number of its pulses
        # comparisons
        ("true_comparisons", "i8"),  # comparisons that are true now
        ("comparison_events", "i8"),  # RR3 of the older chips
        # interpolation
        ("interpolates", "i8"),  # 1: the axis takes part in an interpolation; MAIN: as its main axis
        ("moves", "i8"),  # the segment moves the axis
        # scan and trace
        ("pulse_off_clock", "i8"),  # end of the present pulse if the plan does not contain it, see pulse_output.py
        ("logged_pulses", "i8"),  # pulses that a trace has logged beyond `pulses_done`
        ("next_pulse_clock", "i8"),  # the clock at which the next pulse begins
        ("next_pulse_piece", "i8"),  # number of the piece in which it begins
        ("even_pps", "i8"),  # speed of that piece if its pulses are evenly spaced, see pulse_trace.py
        ("even_rest", "i8"),  # remainder of the even spacing, see pulse_trace.py
        # settings of WR1 to WR3
        ("stop_inputs", "i8"),  # STOP inputs that are enabled, bit 0 for STOP0
        ("limits_stop", "i8"),  # LMT+ and LMT- stop the drive
        ("limits_decelerate", "i8"),  # they stop it by a deceleration
        ("alarm_stops", "i8"),
        ("inpos_enabled", "i8"),
        ("soft_plus", "i8"),  # the software limit in + direction is enabled
        ("soft_minus", "i8"),
        ("soft_rp", "i8"),  # the software limits compare RP (EP) instead of LP
        ("soft_instant", "i8"),  # the software limits stop at once
        ("manual_deceleration", "i8"),  # deceleration begins at DP
        ("asymmetric", "i8"),  # the deceleration has its own registers
        ("s_curve", "i8"),
        ("prevents_triangle", "i8"),  # triangle prevention is on
        ("stop2_clears_ep", "i8"),  # STOP2 clears EP
        ("limits_swapped", "i8"),  # LMT+ and LMT- are exchanged
        ("encoder_mode", "i8"),  # input mode: 0 x4, 1 x2, 2 x1, 3 up / down
        ("encoder_reversed", "i8"),  # the encoder counts in the opposite direction
        # the shaft of its encoder, see encoder.py: at shaft_edges + shaft_rate * (clock - shaft_clock)
        ("shaft_clock", "i8"),
        ("last_edge", "i8"),  # the last edge that the shaft has passed
        ("shaft_edges", "f8"),  # edges of the encoder
        ("shaft_rate", "f8"),  # edges per clock
        ("inputs_with_filter", "i8"),  # INPUTS that have a filter
        ("filter_delay", "i8"),  # delay of the filters, clocks
        ("second_filter_delay", "i8"),  # delay of the filters of STOP2, ECA and ECB, clocks
        ("reg", "i8", (REGISTERS,)),  # registers by the indices above
        ("mode", "i8", (MODE_REGISTER_COUNT,)),  # mode registers 20h to 2Fh
        ("wr", "i8", (4,)),  # WR1 to WR3 under their own number
        ("filter_ends", "i8", (INPUT_PINS,)),  # clocks at which the filters pass a change of their inputs
        ("pulse_until", "i8", (SYNC_SETS,)),  # clocks at which the sync pulses on PIO end
        *_PROFILE,
    ]
)
"""State of one axis of a NOVA chip."""

LINE, ARC, PATTERN, HELIX = range(1, 5)
PRE_BUFFER_STAGES = 8  # of the pre-buffer; the queue has one more place, for the running segment

SEGMENT = record(
    [
        ("kind", "i8"),  # LINE, ARC, PATTERN, HELIX
        ("axis_count", "i8"),  # number of axes that take part, places 0, 1 ...
        ("vector_axes", "i8"),  # number of axes that constant vector speed considers; 0: off
        ("inner_ticks", "i8"),  # inner ticks per tick: 8 if short-axis pulses are equalized, else 1
        ("decelerates", "i8"),  # the segment ends with a deceleration
        # ticks of a line; of a helix: those in which the axes beyond the circle make their pulses
        ("tick_count", "i8"),
        ("rotations", "i8"),  # whole rotations of a helix before its arc
        ("y_sign", "i8"),  # -1 for clockwise circles, else 1
        ("axis_numbers", "i8", (MAX_CHIP_AXES,)),  # number of the axis at each place
        # finish point, pulses; of a bit pattern + in the low, - in the high 16 bits
        ("finish", "i8", (MAX_CHIP_AXES,)),
        ("center", "i8", (2,)),  # relative, pulses
    ]
)
"""One segment of an interpolation, as its command captured it."""

ARC_STATE = record(
    [
        ("x", "i8"),  # pulses from the centre
        ("y", "i8"),
        ("radius_error", "i8"),  # x^2 + y^2 - radius^2
        ("octant", "i8"),  # of the next tick
        ("octants_entered", "i8"),  # number of octants entered so far
        ("octants_to_enter", "i8"),  # number of octants to enter up to that of the finish point
        ("goal_x", "i8"),  # finish point, pulses from the centre
        ("goal_y", "i8"),
    ]
)
"""A circle in progress, counter-clockwise; a clockwise one is mirrored in y."""

INTERPOLATION = record(
    [
        ("deceleration_enabled", "i8"),  # segments end with a deceleration (6Dh, 3Bh)
        ("interrupt", "i8"),  # the interrupt of the interpolation is asserted
        ("main_axis", "i8"),  # its main axis, whose profile makes the ticks
        ("axis_mask", "i8"),  # axes that take part, bit 0 for X
        ("queue_depth", "i8"),  # segments that can wait
        ("queue_head", "i8"),  # the running segment in `queue`
        ("waiting_segments", "i8"),  # segments behind the running one
        ("start_clock", "i8"),  # clock of the start
        ("continuous", "i8"),  # a second segment has been queued
        ("single_stepped", "i8"),  # ticks come by command, or from the master
        ("planned_speed", "i8"),  # drive speed of the present plan
        ("stopping", "i8"),  # it brakes for a stop
        ("plan_decelerates", "i8"),  # the plan ends with a deceleration to SV
        # the next tick, prepared
        ("next_tick_clock", "i8"),  # its clock
        ("ticks_until_check", "i8"),  # ticks until a counter must be compared
        ("tick_piece", "i8"),  # the piece of the profile in which it begins
        ("is_last_tick", "i8"),  # it is the last tick of the segment
        ("ends_interpolation", "i8"),  # it has no pulses and ends the interpolation
        ("ticks_left", "i8"),  # ticks of the segment still to prepare
        ("finished_rotations", "i8"),  # rotations that the helix has made
        ("rotations_left", "i8"),  # rotations that remain
        ("zone", "i8"),  # octant, for RR0
        # several chips, see multichip.py
        ("role", "i8"),  # MASTER or SLAVE; 0: the chip interpolates alone
        ("awaits_start", "i8"),  # it waits until all chips can start
        ("uses_tx", "i8"),  # the maximum finish point is TX
        ("errors_at_start", "i8"),  # errors of RR2 at the start, a byte per axis
        ("last_tick_clock", "i8"),  # of a slave: clock of the last tick of the master
        ("tick_interval", "i8"),  # clocks between the last two ticks
        # bit patterns of the MCX312
        ("loads_pattern", "i8"),  # writes to WR2 to WR5 go to `pattern_words`
        ("stacked_sets", "i8"),  # sets of the pattern stack that wait for 34h
        ("steps", "i8", (MAX_CHIP_AXES,)),  # whether each place of the segment makes a pulse
        ("directions", "i8", (MAX_CHIP_AXES,)),  # direction of its pulses, 1 or -1
        ("line_errors", "i8", (MAX_CHIP_AXES,)),  # error terms of the slower axes of a line
        ("inner_positions", "i8", (MAX_CHIP_AXES,)),  # positions in inner ticks
        ("pattern_words", "i8", (6,)),  # the bit pattern that is being written
        ("arc", ARC_STATE),  # the running circle
        ("scratch_arc", ARC_STATE),  # an arc for calculations ahead
        ("pattern_stack", "i8", (3, 6)),  # the stacked sets
        ("tick_place", "f8", (2,)),  # place of the next tick in the profile, pulses
        ("segment_start", "f8", (2,)),  # place at which the segment begins
        ("segment_end", "f8", (2,)),  # place at which the segment ends, if it decelerates
    ]
)
"""State of the interpolation in progress."""

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("quiet_until", "i8"),  # the clock up to which only pulses happen, unless `stale`
        ("stale", "i8"),  # inputs or registers have changed since `quiet_until` was computed
        ("variant", "i8"),  # FIRST_GENERATION, MCX514_TYPE
        ("axes", "i8"),  # number of axes
        ("errata", "i8"),  # the chip has the S-curve failure, as it was sold
        ("has_l", "i8"),  # MCX312, MCX314As: register L, interpolation
        ("extended", "i8"),  # MCX314As: EM, STOP3, lines of three axes
        ("selected", "i8"),  # axis bits, bit 0 for X
        ("data_low", "i8"),  # WR6
        ("data_high", "i8"),  # WR7
        ("read_low", "i8"),  # RR6
        ("read_high", "i8"),  # RR7
        ("status_pages", "i8"),  # axes whose RR3 reads page 1
        ("outputs4", "i8"),  # WR4
        ("outputs5", "i8"),  # WR5
        ("emg_pin", "i8"),  # the pin EMG
        ("emergency", "i8"),  # the same after its filter
        ("emg_filter_end", "i8"),  # the clock at which the filter passes a change of the pin
        ("total", "i8"),  # pulses since power-up, all axes
        ("interpolating", "i8"),  # an interpolation is in progress
        ("command_high_byte", "i8"),  # high byte of WR0, waits for the low one
        ("has_unused_data", "i8"),  # WR6 or WR7 was written after the last command
        ("encoder_axes", "i8"),  # axes that have an encoder, bit 0 for X
        # the wires to other chips, see multichip.py
        ("wire_word", "i8"),  # the word on the wires
        ("master_ticks", "i8"),  # ticks that the chip has sent as a master since power-up
        ("signals_failure", "i8"),  # the chip signals an error to the other chips
        ("multichip_error", "i8"),  # MCERR
        ("ip", INTERPOLATION),
        ("queue", SEGMENT, (PRE_BUFFER_STAGES + 1,)),  # the running segment and those that wait, in a ring
        ("ax", AXIS, (MAX_CHIP_AXES,)),
    ]
)
"""State of one NOVA chip."""

_SIGNALS = ("lmt_plus", "lmt_minus", "stop0", "stop1", "stop2", "inpos", "alarm", "eca", "ecb")
INPUTS = {name: 1 << k for k, name in enumerate((*_SIGNALS, *(f"pio{i}" for i in range(8))))}
LMT_PLUS, LMT_MINUS, STOP0, STOP1, STOP2, INPOS, ALARM, ECA, ECB = (1 << k for k in range(9))
PIO0_SHIFT = 9
EXP_PLUS_SHIFT = PIO0_SHIFT + 4  # EXP+, then EXP-
INPUTS_300 = {name: 1 << k for k, name in enumerate(_SIGNALS)} | {
    "exp_plus": 1 << EXP_PLUS_SHIFT,
    "exp_minus": 2 << EXP_PLUS_SHIFT,
}
"""Input pins of the chips before the MCX514."""
STOP3 = 1 << PIO0_SHIFT
INPUTS_314 = INPUTS_300 | {"stop3": STOP3}
INPUTS_512 = INPUTS | {f"pio{i}": 1 << PIO0_SHIFT + i for i in range(8, 14)}  # PIO8 to PIO13
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
D_STA, C_STA, C_END, D_END, H_END, TIMER, SPLTP, SPLTE = MCX514_MAP.masks(
    "RR1", "D-STA", "C-STA", "C-END", "D-END", "H-END", "TIMER", "SPLTP", "SPLTE"
)
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
        ("net", "i8"),  # pulses since power-up, plus minus minus
        ("rate", "f8"),  # pulses a clock
    ]
)
"""State of an axis from one of its changes on, for journals and recordings."""
