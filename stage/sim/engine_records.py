"""Record types of the engine: the state of a stage in MuJoCo's userdata, tables of constants, samples, and logged edges."""

from __future__ import annotations

import math

import numpy as np

from stage.chips import core_interface
from stage.drives import stepper
from stage.native import hot, record

SWITCH_PINS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org")
"""Switches that an axis may have, by the names of the pins that they are meant for, see docs/models.md."""
ADDRESS_TYPE = np.dtype("i8")
NEVER = 1 << 62
SWITCH_HYSTERESIS_M = (
    25e-6  # m (rad on a hinge); a slotted optical switch lets go that much later than it trips (typical data sheets)
)
TURN_RAD = 2.0 * math.pi
INDEX, INDEX_HYSTERESIS = 0.01, 5e-4  # turns: width of the encoder's index pulse, and by how much it lets go later
NS_PER_SECOND = 1_000_000_000
SLICES = stepper.SLICES

# --- state, in userdata ---
STAGE_TIME = record([(name, "i8") for name in "now start slice steps to_sample powered".split()])
"""Time of a stage: `now` and `start` of the window (ns); slices and physics steps completed; physics steps until the next sample;
`powered`: 1, or 0 after userdata was cleared, for example by mj_resetData, so that no state in it is valid."""
AXIS = record(
    [("counts", "f8", (SLICES,)), ("speed", "f8")]
    + [(name, "i8") for name in "count next_edge awake index_on index_edge index_end".split()]
)
"""Mean pulse counts of the window's slices so far; the joint's speed in the last physics step (units/s); the count at the last
slice's end, time of the next input edge (ns); whether a switch of it is on, sees its vane or bounces; the encoder's index pulse:
asserted, its next edge in this window, and the one after (ns)."""
SWITCH = record([("shift", "f8")] + [(name, "i8") for name in "sensed on edge next_edge toggles until".split()])
"""State of a switch: shift of the flag from its measured position, joint units; whether the contact sensor detects the vane;
whether the switch is asserted; times of the next edge in this window and of the one after it (ns); for a contact that bounces, the
number of toggles to come and the time at which it rests (ns)."""

# --- constants ---
CALLBACK_COUNT = 8  # that MuJoCo has
ENGINE_CONSTANTS = record(
    [(name, "i8") for name in "busy dt slices nv sample_every encoders currents loads linked most_edges".split()]
    + [(name, "i8") for name in "guarded failed mj_step mj_get_state state_spec flag_edges n_flag_edges".split()]
    + [("h", "f8"), ("half", "f8"), ("callbacks", "i8", (CALLBACK_COUNT,)), ("native", "i8", (CALLBACK_COUNT,))]
)
"""Constants of a stage's time.

busy: Token of whoever runs the stage, see `claim` of stage.sim.compiled_stage_access; the first field.
dt, slices, h, half: Window, ns; slices in it; a slice and half a window, s.
nv: Degrees of freedom.
sample_every: Physics steps per sample, 0 for none.
encoders, currents, loads, linked: Number of axes whose chips count an encoder, set their motor's current, receive its load; number
    of chips that are linked.
most_edges: How many edges a window can have.
guarded, failed: Whether MuJoCo's callbacks are guarded, and whether one has failed, see stage.sim.mujoco_callback_guards.
callbacks, native: Where the addresses of the callbacks lie, and their values while nobody in Python is called.
mj_step, mj_get_state, state_spec: Addresses of MuJoCo's functions, and the parts of its state that a snapshot has.
flag_edges, n_flag_edges: Where the FLAG_EDGE records of all switches lie, and their number.
"""
CHIP_ROW = core_interface.CHIP
AXIS_ROW = record(
    [(name, "i8") for name in "chip chip_axis qpos dof actuator first_switch end_switch index_bit positive".split()]
    + [("gear", "f8"), ("index_at", "f8"), ("counts", "f8")]
)
"""Which axis of which chip (a CHIP_ROW record) and which drive row (= the axis' own index) move which joint; rotor radians
per joint unit; the pin bit of the index pulse (0: not connected) and where in the rotor's turn it stands, in turns; the pin bits
whose sensors are high while they are on; counts of the encoder that the chip sees per joint unit (0: none)."""
SWITCH_ROW = record(
    [(name, "i8") for name in "bit found dist forced bounce toggles first_edge end_edge".split()] + [("turn", "f8")]
)
"""Pin bit, addresses in sensordata; `forced`: -1 works, 0 stuck open, 1 stuck closed; how long a contact bounces after an edge (ns,
0: not at all), and how often it toggles in that time (even); which FLAG_EDGE records are its own; after which travel of the joint
the same edges come again (0: never)."""
FLAG_EDGE = record([(name, "f8") for name in "at slope bend noise below above".split()])
"""A place in the joint's travel where a vane enters or leaves its switch, see `stage.sim.plant.switch_finder.FlagEdge`."""

SAMPLE = record(
    [(name, "f8") for name in "time position velocity commanded load_angle torque".split()]
    + [(name, "f8") for name in "current_a current_b voltage rate".split()]
    + [(name, "i8") for name in "pulses lost_steps counter inputs outputs".split()]
)
"""One axis at one moment. SI units; load angle in electrical radians; voltage at a DC motor; rate in pps, counts a second."""
LOGGED_EDGE = record(
    [(name, "i8") for name in ("now", "clock", "axis", "kind", "a", "b")] + [("count", "f8"), ("rate", "f8")]
)
"""Input that the chip of an axis has received: time (ns), the chip's clock, and an `Entry` for its journal: kind, a, b. A SHAFT has
the chip's axis, count and rate instead; a LOAD the axis, the angle and the share of the supply."""

MAX_TOGGLES = 8
MAX_EDGES_PER_WINDOW = len(SWITCH_PINS) * (1 + MAX_TOGGLES) + 2 + 1 + 1 + 1
"""Largest number of LOGGED_EDGE records that an axis adds in a window, without those of wires between chips: for each
switch an edge and its toggles; begin and end of the index pulse; the shaft; the output of another chip; the load."""
REACHED, SAMPLES_FULL, EDGES_FULL, DIVERGED, FAILED, UNGUARDED, IN_USE, WIPED = range(8)
"""Reasons why the engine returned: the time is reached; the buffer of samples or of edges is full; the physics diverged; a callback
failed. Reasons why it did nothing: callbacks are not guarded; another thread runs the stage; the stage is not powered."""
MAX_JOINT_SPEED = 1e6  # of any joint, per second; beyond it, or NaN, the simulation has diverged


@hot
def compute_clock_at(now_ns: int, clock_hz: int) -> int:
    """Compute the number of reference clocks of a chip with a clock of `clock_hz` at `now_ns` nanoseconds, exact for centuries."""
    return now_ns // NS_PER_SECOND * clock_hz + now_ns % NS_PER_SECOND * clock_hz // NS_PER_SECOND
