"""NOVA chips, compiled: bit pattern interpolation: 16 steps of each axis, bit 0 first, + and - bits; both at once end it."""

from __future__ import annotations

from stage.native import hot

STEPS = 16


@hot
def load(ip, g):
    ip.left = STEPS
    for k in range(g.axes):
        ip.toward[k] = 0
    return True


@hot
def step(ip, g):
    """The steps of the next tick. Returns whether it is the last one; sets `closing` where it ends the interpolation."""
    bit = STEPS - ip.left
    for k in range(g.axes):
        plus, minus = g.finish[k] >> bit & 1, g.finish[k] >> bit + STEPS & 1
        ip.step[k] = plus | minus
        if plus and minus:
            ip.closing = 1
        if plus or minus:
            ip.toward[k] = plus - minus
    ip.left -= 1
    return ip.left == 0


@hot
def ticks(g):
    """Count the ticks as line.py does."""
    one = two = three = 0
    for bit in range(STEPS):
        moved = 0
        for k in range(g.axes):
            plus, minus = g.finish[k] >> bit & 1, g.finish[k] >> bit + STEPS & 1
            if plus and minus:
                return one, two, three
            if k < g.vector:
                moved += plus | minus
        one += moved < 2
        two += moved == 2
        three += moved == 3
    return one, two, three
