"""NOVA chips, compiled: linear interpolation: the long axis steps at every tick, the others to where they are nearest the line."""

from __future__ import annotations

from stage.native import hot, least


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
    """Count the ticks of the whole line that move one axis at most, two, and three of them."""
    ticks_in_all = g.longest * g.fine
    if not g.vector or g.axes == 1:
        return ticks_in_all, 0, 0
    looked, always = least(g.vector, g.axes), 0
    a = b = 0  # the short ones, as far as there are two
    shorts = 0
    for k in range(looked):
        length = abs(g.finish[k])
        if length == g.longest:
            always += 1
        elif shorts == 0:
            a, shorts = length, 1
        else:
            b, shorts = length, shorts + 1
    if shorts == 3:
        return _walked(ip, g, ticks_in_all)
    both = meetings(a, b, g.longest) if shorts == 2 else 0
    alone = a + b - 2 * both  # ticks in which just one of the short ones steps
    moved = ((g.longest - alone - both) * g.fine, alone * g.fine, both * g.fine)
    if always == 0:
        return moved[0] + moved[1], moved[2], 0
    if always == 1:
        return moved
    return (0, ticks_in_all - moved[1], moved[1]) if always == 2 else (0, 0, ticks_in_all)


@hot
def _walked(ip, g, ticks_in_all):
    """The same, tick by tick: three short axes, below a longer fourth one or a maximum of the host's."""
    two = three = 0
    for _ in range(ticks_in_all if load(ip, g) else 0):
        step(ip, g)
        moved = ip.step[0] + ip.step[1] + ip.step[2]
        two += moved == 2
        three += moved == 3
    return ticks_in_all - two - three, two, three


@hot
def meetings(a, b, n):
    """In how many of the `n` ticks of a line two axes step at once, which step in `a` and in `b` of them (0 <= a, b <= n).

    An axis steps in tick k where a k lies in [-h, a - h) modulo n, h = n // 2. So points of the lattice of all (a k, b k) modulo n
    in a rectangle are counted: its columns lie e apart, and each begins `shift` higher than the one before, modulo `gap`.
    """
    if a == 0 or b == 0:
        return 0
    e, inverse = _shared(a, n)
    gap = n // e * _shared(b, e)[0]
    shift = b * inverse % gap
    first = -(n // 2 // e)  # the first column in the rectangle
    low = (-(n // 2) - 1 - first * shift) % gap
    down = (gap - shift) % gap
    columns = a // e
    return _shared(b, e)[0] * (_floors(columns, gap, down, low + b) - _floors(columns, gap, down, low))


@hot
def _shared(a, n):
    """The greatest common divisor e of two numbers, and what times a is e modulo n."""
    e, rest, u, v = a, n, 1, 0
    while rest:
        q = e // rest
        e, rest = rest, e - q * rest
        u, v = v, u - q * v
    return e, u % n


@hot
def _floors(n, m, a, b):
    """The sum of (a i + b) // m over i = 0 to n - 1, for 0 <= a < m and 0 <= b: Euclid's algorithm on the slope."""
    total = 0
    while n > 0:
        total += n * (n - 1) // 2 * (a // m) + n * (b // m)
        a, b = a % m, b % m
        top = a * n + b
        if top < m:
            break
        n, b, m, a = top // m, top % m, a, m
    return total
