"""NOVA chips, compiled: linear interpolation: the long axis steps at every tick, the others to where they are nearest the line."""

from __future__ import annotations

from stage.native import greatest, hot, least


@hot
def load(ip, g):
    """Begin line `g`. Returns whether it has a tick."""
    ip.left = g.longest * g.fine
    for k in range(g.axes):
        ip.error[k] = g.longest
        ip.toward[k] = (1 if g.finish[k] > 0 else 0) - (1 if g.finish[k] < 0 else 0)
    return ip.left > 0


@hot
def step(ip, g):
    """The steps of the next tick. Returns whether it is the last one."""
    for k in range(g.axes):
        ip.error[k] += 2 * abs(g.finish[k])
        ip.step[k] = 0
        if ip.error[k] >= 2 * g.longest:
            ip.error[k] -= 2 * g.longest
            ip.step[k] = 1
    ip.left -= 1
    return ip.left == 0


@hot
def ticks(ip, g):
    """How many ticks of the whole line move one axis at most, two, three of those that constant vector speed looks at."""
    whole = g.longest * g.fine
    if not g.vector or g.axes == 1:
        return whole, 0, 0
    first, second = abs(g.finish[0]), abs(g.finish[1])
    if g.axes == 2 and g.longest == greatest(first, second):
        both = least(first, second) * g.fine
        return whole - both, both, 0
    two = three = 0
    for _ in range(whole if load(ip, g) else 0):  # the steps of two short axes meet where they like
        step(ip, g)
        moved = 0
        for k in range(least(g.vector, g.axes)):
            moved += ip.step[k]
        two += moved == 2
        three += moved == 3
    return whole - two - three, two, three
