"""Devices on the bus, compiled: a cycle reaches one; whether it pulls the interrupt line.

A compiled device, of ours or of a C library, is two functions over its state, which see the time and the counts of its encoders:

    access(state, now, counts, n, way, value) -> value      a cycle at its port `n`; way: IN8, OUT8, IN16, OUT16
    pulls(state, now, counts) -> 1 if it pulls the interrupt line then; changes nothing
"""

from __future__ import annotations

from stage.board.host import DEVICE_CALLED, DEVICE_TABLE, ENCODER, ask, now_of, stage_of
from stage.native import array_at, called, floor, hot
from stage.sim import records
from stage.sim.handle import REAL, WHOLE, clockwork, table, world

_access = called("i8", "i8", "i8", "i8", "i8", "i8", "i8")
_pulls = called("i8", "i8", "i8", "i8")


@hot
def device_of(h, k):
    return array_at(h.devices, h.n_devices, DEVICE_TABLE)[k]


@hot
def _look_at_encoders(h, d):
    """The counts of the device's encoders at the host's time."""
    s = stage_of(h)
    qpos, qvel, axes = array_at(h.qpos, h.nq, REAL), array_at(h.qvel, h.nv, REAL), table(s)
    counts, encoders = array_at(d.counts, d.n_encoders, WHOLE), array_at(d.encoders, d.n_encoders, ENCODER)
    tau = float(now_of(h) - world(s).start) / records.SECOND - clockwork(s).half
    for k in range(d.n_encoders):
        e = encoders[k]
        t = axes[e.axis]
        counts[k] = int(floor((qpos[t.qpos] + qvel[t.dof] * tau - e.zero) * e.counts + 0.5))


@hot
def at_device(h, k, n, way, value):
    """A cycle reaches port `n` of device `k`; the answer. Of one in Python the stage has caught up with the host."""
    if h.stopped:
        return 0xFFFF
    d = device_of(h, k)
    if d.access == 0:
        h.asked_chip, h.asked_address, h.asked_way, h.asked = k, n, way, value
        ask(h, DEVICE_CALLED)
        h.quiet = 0
        return h.asked
    if d.n_encoders:
        _look_at_encoders(h, d)
    h.answers = k + 1
    found = _access(d.access, (d.state, now_of(h), d.counts, n, way, value))
    h.answers = 0
    return found


@hot
def pulling(h):
    """The devices that pull the interrupt line, a bit each."""
    found = 0
    for k in range(h.n_devices):
        d = device_of(h, k)
        on = array_at(d.line, 1, WHOLE)[0] <= now_of(h)
        if d.pulls and not on:
            if d.n_encoders:
                _look_at_encoders(h, d)
            h.answers = k + 1
            on = _pulls(d.pulls, (d.state, now_of(h), d.counts)) != 0
            h.answers = 0
        if on:
            found |= 1 << k
    return found
