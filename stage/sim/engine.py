"""The one compiled loop: switches -> chips -> drives -> mj_step, many steps per call.

Time is an integer of nanoseconds. A physics step of dt is a *window* [start, start + dt) of chip time, cut into equal
slices. Every chip runs through the window (an input edge or a bus cycle may fall anywhere inside), and its mean pulse count
in each slice is kept. At the window's end every drive turns its counts into torque, slice by slice; the mean goes to
`ctrl`, and mj_step moves the stage.

MuJoCo's integrator is a leapfrog: positions live at times t, velocities half a step before. The force that it wants at a
position is the mean over the window centred there, so a window's centre, not its start, is the time of the position held in
`qpos`: at a chip time tau after the window's start a joint stands at q + v (tau - dt / 2). With that the coupling adds no
damping of its own (a stepper on its detent would ring falsely dead), and a switch's edge is extrapolated by half
a step only. The velocity of that centre is not known before the force is; what a drive needs of it, it finds by trying twice
(`stepper.mean_torque`), or the coupling would feed energy in.

All state is in records inside MjData.userdata, all tables of constants in arrays beside it; nothing here allocates.
"""

from __future__ import annotations

import math

import numpy as np

from stage.chips import cores
from stage.chips.entries import INPUT, SHAFT
from stage.drives import drive, stepper
from stage.native import array_at, called, floor, greatest, hot, least, record
from stage.sim.pins import PINS

_step = called(None, "i8", "i8")
_get_state = called(None, "i8", "i8", "i8", "i4")

ADDRESS = np.dtype("i8")
NEVER = 1 << 62
FAR = 1.0  # distance of a vane that no sensor sees
TURN = 2.0 * math.pi
INDEX, INDEX_HYSTERESIS = 0.01, 5e-4  # turns: width of the encoder's index pulse, and by how much it lets go later
SECOND = 1_000_000_000
SLICES = stepper.SLICES

# --- state, in userdata ---
WORLD = record([(name, "i8") for name in "now start slice steps to_sample powered".split()])
"""`now`, `start` of the window (ns); slices and steps done; steps until the next sample; 1 under power: where it is 0, somebody has
cleared userdata (mj_resetData does), and nothing in it means anything."""
AXIS = record(
    [("counts", "f8", (SLICES,))] + [(name, "i8") for name in "count next_edge index_on index_edge index_end".split()]
)
"""Mean pulse counts of the window's slices so far, the count at the last slice's end, time of the next input edge (ns); the
encoder's index pulse: asserted, its next edge in this window, and the one after (ns)."""
SWITCH = record([("dist", "f8"), ("edge", "i8"), ("on", "i8"), ("toggles", "i8"), ("until", "i8")])
"""Distance vane to switch at `qpos`, time of its next edge (ns), asserted; of a contact that bounces, how often it will still
toggle and when it will have come to rest (ns)."""

# --- constants ---
CALLBACKS = 8  # that MuJoCo has
CLOCKWORK = record(
    [
        ("busy", "i8"),
        ("dt", "i8"),
        ("slices", "i8"),
        ("h", "f8"),
        ("half", "f8"),
        ("nv", "i8"),
        ("sample_every", "i8"),
        ("encoders", "i8"),
        ("guarded", "i8"),
        ("failed", "i8"),
        ("mj_step", "i8"),
        ("mj_get_state", "i8"),
        ("state_spec", "i8"),
        ("clocks", "i8", (SLICES,)),
        ("callbacks", "i8", (CALLBACKS,)),
        ("native", "i8", (CALLBACKS,)),
    ]
)
"""Who runs the stage, see stage.in_use; window (ns), slices in it, a slice and half a window (s), degrees of freedom, steps per
sample (0: none), axes whose chips see an encoder; of MuJoCo's callbacks, see stage.callbacks: whether they are guarded, whether one
has failed, where their addresses lie and what these are while nobody in Python is called; addresses of
MuJoCo's functions, and which parts of its state a snapshot has; the clocks of a chip at the ends of the window's slices."""
CHIP_TABLE = cores.CHIP
AXIS_TABLE = record(
    [(name, "i8") for name in "chip chip_axis qpos dof actuator first_switch end_switch index_bit".split()]
    + [("gear", "f8"), ("index_at", "f8"), ("counts", "f8")]
)
"""Which axis of which chip (a row of CHIP_TABLE) and which drive row (= the axis' own index) move which joint; rotor radians
per joint unit; the pin bit of the index pulse (0: not connected) and where in the rotor's turn it stands, in turns; counts of the
encoder that the chip sees per joint unit (0: none)."""
SWITCH_TABLE = record(
    [(name, "i8") for name in "bit found at forced bounce toggles".split()] + [("slope", "f8"), ("hysteresis", "f8")]
)
"""Pin bit, addresses in sensordata, d dist / d q; `forced`: -1 works, 0 stuck open, 1 stuck closed; how long a contact bounces
after an edge (ns, 0: not at all), and how often it toggles in that time (even)."""

SAMPLE = record(
    [
        ("time", "f8"),
        ("position", "f8"),
        ("velocity", "f8"),
        ("commanded", "f8"),
        ("load_angle", "f8"),
        ("torque", "f8"),
    ]
    + [("current_a", "f8"), ("current_b", "f8"), ("voltage", "f8"), ("rate", "f8")]
    + [(name, "i8") for name in "pulses lost_steps counter inputs outputs".split()]
)
"""One axis at one moment. SI units; load angle in electrical radians; voltage at a DC motor; rate in pps, counts a second."""
EDGE = record([(name, "i8") for name in ("now", "clock", "axis", "kind", "a", "b")] + [("count", "f8"), ("rate", "f8")])
"""What reached the chip of an axis: time (ns), the chip's clock, and an `Entry` for its journal: kind, a, b; of a SHAFT count and
rate in their place."""

MAX_TOGGLES = 8
EDGES_A_WINDOW = len(PINS) * (1 + MAX_TOGGLES) + 2 + 1
"""Of an axis at most: each switch an edge and its toggles; the index pulse begins and ends; the shaft."""
REACHED, SAMPLES_FULL, EDGES_FULL, DIVERGED, FAILED, UNGUARDED, IN_USE, WIPED = range(8)
"""Why it returned: time is up; no room to log in; the physics diverged; a callback failed. And why it did nothing: there are
callbacks, and nobody guards them; another runs the stage; it is not under power."""
MAX_SPEED = 1e6  # of any joint, per second; beyond it, or NaN, the simulation has diverged


@hot
def clock_at(now, hz):
    """Ticks of a reference clock at `now` ns, exact for centuries."""
    return now // SECOND * hz + now % SECOND * hz // SECOND


@hot
def _off_index(t, q):
    """Turns from the nearest index mark to the rotor, -0.5 to 0.5."""
    turns = q * t.gear / TURN - t.index_at
    return turns - floor(turns + 0.5)


@hot
def _foresee_index(world, axis, t, q, v, half):
    """At a window's start: when in this window the index pulse will begin or end, at most both."""
    axis.index_edge = axis.index_end = NEVER
    speed = v * t.gear / TURN
    way = 1.0 if speed >= 0.0 else -1.0
    off = (_off_index(t, q) - speed * half) * way  # as if the motor turned forward
    off -= floor(off + 0.5)
    rim = 0.5 * INDEX + (INDEX_HYSTERESIS if axis.index_on else 0.0)
    speed *= way
    if axis.index_on:
        wait = rim - off if abs(off) <= rim else 0.0
    elif abs(off) <= rim:
        wait = 0.0
    else:
        wait = -rim - off if off < -rim else 1.0 - rim - off
    if wait <= speed * 2.0 * half:
        axis.index_edge = world.start + (int(wait / speed * SECOND) if wait > 0.0 else 0)
        if not axis.index_on:
            last = wait + INDEX + INDEX_HYSTERESIS if wait > 0.0 else rim + INDEX_HYSTERESIS - off
            if 0.0 < last < speed * 2.0 * half:
                axis.index_end = world.start + int(last / speed * SECOND)
        axis.next_edge = least(axis.next_edge, axis.index_edge)


@hot
def _foresee_switch(world, axis, s, t, v, half):
    """When in this window, from now on, a switch will change; `s.dist` is known. A bouncing contact comes to rest first."""
    if s.toggles == 0:
        s.edge = NEVER
        approach = -t.slope * v
        threshold = t.hysteresis if s.on else 0.0
        on = 1 if s.dist - approach * half <= threshold else 0
        if t.forced >= 0:
            on = t.forced
        if on != s.on:
            wait = 0.0
            if t.forced < 0 and approach != 0.0:
                wait = least(greatest(half + (s.dist - threshold) / approach, 0.0), 2.0 * half)
            s.edge = greatest(world.start + int(wait * SECOND), world.now)
    axis.next_edge = least(axis.next_edge, s.edge)


@hot
def _bounce(s, t, now):
    """After an edge, or a toggle that followed it: when the contact toggles next, ever sooner, the last at the bounce's end."""
    if s.toggles == 0:
        s.toggles, s.until = t.toggles, now + t.bounce
    else:
        s.toggles -= 1
    if s.toggles:
        s.edge = now + 2 * (s.until - now) // (s.toggles + 1)


@hot
def _foresee(world, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel, moved):
    """At a window's start: where each vane is, and when in this window its switch will change.

    `moved`: qpos has moved since the sensors were read, by one step of the present qvel.
    """
    half = clockwork.half
    for a in range(len(axes)):
        axes[a].next_edge = NEVER
        v = qvel[table[a].dof]
        for k in range(table[a].first_switch, table[a].end_switch):
            s, t = switches[k], switch_table[k]
            s.dist = FAR
            if sensordata[t.found] > 0.0:
                s.dist = sensordata[t.at] + (t.slope * v * 2.0 * half if moved else 0.0)
            elif not s.on and t.forced <= 0 and s.toggles == 0:
                s.edge = NEVER
                continue
            _foresee_switch(world, axes[a], s, t, v, half)
        if table[a].index_bit:
            _foresee_index(world, axes[a], table[a], qpos[table[a].qpos], v, half)


@hot
def _switched(t, switches, switch_table, word):
    """The pin word of an axis with its switches as they are. Two that are wired to one pin assert it if either is on."""
    on = off = 0
    for k in range(t.first_switch, t.end_switch):
        bit = switch_table[k].bit
        on, off = (on | bit, off) if switches[k].on else (on, off | bit)
    return word & ~off | on


@hot
def _meet_axis_edges(axis, t, c, j, switches, switch_table, now):
    """The switches of chip axis `j` that change at `now` do."""
    axis.next_edge = NEVER
    for k in range(t.first_switch, t.end_switch):
        s = switches[k]
        if s.edge <= now:
            s.edge = NEVER
            s.on = 1 - s.on
            if s.toggles or switch_table[k].bounce:
                _bounce(s, switch_table[k], now)
        axis.next_edge = least(axis.next_edge, s.edge)
    word = _switched(t, switches, switch_table, cores.inputs(c, j))
    if t.index_bit:
        if axis.index_edge <= now:
            axis.index_edge, axis.index_end = axis.index_end, NEVER
            axis.index_on = 1 - axis.index_on
            word = word | t.index_bit if axis.index_on else word & ~t.index_bit
        axis.next_edge = least(axis.next_edge, axis.index_edge)
    cores.set_input(c, j, word)


@hot
def _next_edge(axes, c):
    """When the next input of a chip changes."""
    edge = axes[c.axis[0]].next_edge
    for j in range(1, c.axes):
        edge = least(edge, axes[c.axis[j]].next_edge)
    return edge


@hot
def _meet_edges(c, axes, table, switches, switch_table, until, edges, n_edges):
    """Take chip `c` through the edges of its switches up to `until` ns. Returns how many are noted by now."""
    now = _next_edge(axes, c)
    while now <= until:
        cores.run(c, clock_at(now, c.hz))
        for j in range(c.axes):
            a = c.axis[j]
            if axes[a].next_edge > now:
                continue
            _meet_axis_edges(axes[a], table[a], c, j, switches, switch_table, now)
            if n_edges < len(edges):
                e = edges[n_edges]
                e.now, e.clock, e.axis, e.kind, e.a, e.b = now, cores.clock(c), a, INPUT, j, cores.inputs(c, j)
                n_edges += 1
        now = _next_edge(axes, c)
    return n_edges


@hot
def _run_chips(chips, world, axes, table, switches, switch_table, stop, clockwork, edges, counts):
    """Run the chips up to `stop` ns, inside the window; counts[1]: edges noted by now. Returns slices done."""
    start, dt = world.start, clockwork.dt
    hz = clock = rest = 0
    k = world.slice
    for i in range(len(chips)):
        c = chips[i]
        if c.hz != hz:
            hz = c.hz
            clock, rest = clock_at(start, hz), start % SECOND * hz % SECOND
            for k in range(SLICES):
                clockwork.clocks[k] = clock + (rest + (k + 1) * dt // SLICES * hz) // SECOND
        k, now = world.slice, 0
        if stop == start + dt and _next_edge(axes, c) > stop:
            cores.window(c, k)
            k = SLICES
            continue
        while now < stop:
            bound = start + (k + 1) * dt // SLICES
            now = least(bound, stop)
            if _next_edge(axes, c) <= now:
                counts[1] = _meet_edges(c, axes, table, switches, switch_table, now, edges, counts[1])
            cores.run(c, clock + (rest + (now - start) * hz) // SECOND)
            if now == bound:
                for j in range(c.axes):
                    axis = axes[c.axis[j]]
                    axis.counts[k] = cores.drive_input(c, j, axis.count, c.ticks)
                    axis.count = cores.net(c, j)
                k += 1
    return k


@hot
def _shaft(world, t, clockwork, qpos, qvel):
    """Where an axis' shaft is now, in counts of its encoder, and how fast, in counts a second."""
    v = qvel[t.dof]
    tau = float(world.now - world.start) / SECOND - clockwork.half
    return (qpos[t.qpos] + v * tau) * t.counts, v * t.counts


@hot
def _show_shafts(chips, world, table, clockwork, qpos, qvel, edges, counts):
    """At a window's start: the shafts, for the chips that look at them. Returns the edges noted by now."""
    for i in range(len(chips)):
        c = chips[i]
        for j in range(c.axes):
            a = c.axis[j]
            if table[a].counts == 0.0:
                continue
            count, speed = _shaft(world, table[a], clockwork, qpos, qvel)
            cores.set_shaft(c, j, count, speed / c.hz)
            if counts[1] < len(edges):
                e = edges[counts[1]]
                e.now, e.clock, e.axis, e.kind, e.count, e.rate = (
                    world.now,
                    cores.clock(c),
                    a,
                    SHAFT,
                    count,
                    speed / c.hz,
                )
                counts[1] += 1
    return counts[1]


@hot
def _sample(world, t, c, d, clockwork, qpos, qvel, effort, out):
    j = t.chip_axis
    net = cores.net(c, j)
    v = qvel[t.dof]
    q = qpos[t.qpos] - v * clockwork.half
    theta = q * t.gear
    out.time = world.now / SECOND
    out.position, out.velocity = q, v
    out.commanded = q + drive.behind(d, net, theta) / t.gear
    out.load_angle, out.torque = stepper.load_angle(d, net, theta), drive.torque(d, effort)
    out.voltage = drive.voltage(d, effort)
    out.current_a, out.current_b = d.current_a, d.current_b
    out.rate = cores.pulse_rate(c, j, c.hz)
    out.pulses, out.counter = net, cores.counter(c, j)
    out.lost_steps = drive.lost_steps(d, net, theta)
    out.inputs, out.outputs = cores.inputs(c, j), cores.outputs(c, j)


@hot
def unguarded(clockwork):
    """MuJoCo would call somebody whose exceptions nobody guards."""
    if not clockwork.guarded:
        for k in range(CALLBACKS):
            if array_at(clockwork.callbacks[k], 1, ADDRESS)[0] != clockwork.native[k]:
                return True
    return False


@hot
def run(
    model, data, world_, axes, drives, switches, table, switch_table, chips, clockwork_,
    qpos, qvel, ctrl, sensordata, inertia, until, samples, positions, n_samples, edges, n_edges, counts, state,
):  # fmt: skip
    """Run up to `until` ns. Returns why it returned (REACHED, ...); counts[0], counts[1] = samples and edges written.

    model, data: addresses. chips: CHIP_TABLE. inertia: (nv,), kg or kg m^2 that each degree of freedom moves. samples:
    (capacity, axes) SAMPLE; positions: (capacity, nq) float64; edges: EDGE. Empty arrays log nothing. state: address (0: none) that
    takes the state as it is before the physics.
    """
    world, clockwork = world_[0], clockwork_[0]
    status, counts[0], counts[1] = REACHED, n_samples, n_edges
    if not world.powered:
        return WIPED
    if world.start + clockwork.dt <= until:
        if unguarded(clockwork):
            return UNGUARDED
        if state:
            _get_state(clockwork.mj_get_state, (model, data, state, clockwork.state_spec))
    while world.now < until:
        end = world.start + clockwork.dt
        stop = least(until, end)
        k = _run_chips(chips, world, axes, table, switches, switch_table, stop, clockwork, edges, counts)
        world.now = stop
        world.slice = k
        if stop < end:
            break
        middle = 0.5 * clockwork.h - clockwork.half  # of the first slice
        for a in range(len(axes)):
            t = table[a]
            omega = qvel[t.dof] * t.gear
            theta = qpos[t.qpos] * t.gear + omega * middle
            gain = clockwork.half * t.gear * t.gear / inertia[t.dof]
            ctrl[t.actuator] = drive.effort(
                drives[a], axes[a].counts, clockwork.slices, theta, omega, clockwork.h, gain
            )
        _step(clockwork.mj_step, (model, data))
        world.slice = 0
        world.start += clockwork.dt
        world.steps += 1
        for k in range(clockwork.nv):
            if not abs(qvel[k]) < MAX_SPEED:
                status = DIVERGED
        if clockwork.failed:
            status = FAILED
        if status != REACHED:
            break
        _foresee(world, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel, True)
        if clockwork.encoders:
            counts[1] = _show_shafts(chips, world, table, clockwork, qpos, qvel, edges, counts)
        if clockwork.sample_every and n_samples < len(samples):
            world.to_sample -= 1
            if world.to_sample <= 0:
                world.to_sample = clockwork.sample_every
                for a in range(len(axes)):
                    t = table[a]
                    c, out, effort = chips[t.chip], samples[n_samples, a], ctrl[t.actuator]
                    _sample(world, t, c, drives[a], clockwork, qpos, qvel, effort, out)
                for i in range(len(qpos)):
                    positions[n_samples, i] = qpos[i]
                n_samples += 1
                if n_samples == len(samples):
                    status = SAMPLES_FULL
                    break
        if len(edges) and counts[1] > len(edges) - EDGES_A_WINDOW * len(axes):
            status = EDGES_FULL
            break
    counts[0] = n_samples
    return status


@hot
def look_again(world_, axes, switches, table, switch_table, chips, clockwork_, qvel, a, edges, n_edges):
    """A fault of axis `a`'s switches has come or gone, at any moment in a window: their levels now, their edges in the rest
    of it. Returns how many edges are noted.
    """
    world, axis, t = world_[0], axes[a], table[a]
    axis.next_edge = axis.index_edge if t.index_bit else NEVER
    for k in range(t.first_switch, t.end_switch):
        if switch_table[k].forced >= 0:
            switches[k].toggles = 0
        _foresee_switch(world, axis, switches[k], switch_table[k], qvel[t.dof], clockwork_[0].half)
    return _meet_edges(chips[t.chip], axes, table, switches, switch_table, world.now, edges, n_edges)


@hot
def _settle_axis(c, world, axis, t, switches, switch_table, d, clockwork, qpos, qvel):
    if t.counts != 0.0:
        count, speed = _shaft(world, t, clockwork, qpos, qvel)
        cores.set_shaft(c, t.chip_axis, count, speed / c.hz)
    axis.next_edge = NEVER
    axis.count = cores.net(c, t.chip_axis)
    for k in range(SLICES):
        axis.counts[k] = drive.at_rest(d, axis.count)
    for k in range(t.first_switch, t.end_switch):
        s = switches[k]
        s.edge = NEVER
        s.on = switch_table[k].forced if switch_table[k].forced >= 0 else (1 if s.dist <= 0.0 else 0)
    word = _switched(t, switches, switch_table, cores.inputs(c, t.chip_axis))
    if t.index_bit:
        axis.index_edge = axis.index_end = NEVER
        axis.index_on = 1 if abs(_off_index(t, qpos[t.qpos])) <= 0.5 * INDEX else 0
        word = word | t.index_bit if axis.index_on else word & ~t.index_bit
    cores.set_input(c, t.chip_axis, word)
    drive.align(d, float(axis.count), qpos[t.qpos] * t.gear)


@hot
def settle(world_, axes, drives, switches, table, switch_table, chips, clockwork_, qpos, qvel, sensordata):
    """Before the first window, or after the carriages were placed by hand: switch levels and pending edges anew."""
    world, clockwork = world_[0], clockwork_[0]
    world.powered = 1
    for k in range(len(switches)):
        switches[k].toggles, switches[k].edge = 0, NEVER
    _foresee(world, axes, table, switches, switch_table, clockwork, sensordata, qpos, qvel, False)
    for a in range(len(axes)):
        t = table[a]
        _settle_axis(chips[t.chip], world, axes[a], t, switches, switch_table, drives[a], clockwork, qpos, qvel)
