"""Double-double arithmetic: a number as the exact sum of two floats, (high, low), with about 32 decimal digits.

The ideal speed profile asks on which side of a clock a pulse falls, and at round speeds it falls on the clock itself: a float
slips there, this does not. Algorithms of Dekker (1971) and Knuth (TAOCP 2, 4.2.2); IEEE arithmetic without fused operations.
"""

from __future__ import annotations

import math

from stage.native import hot

SPLITTER = 134217729.0  # 2^27 + 1
ZERO = (0.0, 0.0)


@hot
def quick(a, b):
    """a + b where |a| >= |b|."""
    s = a + b
    return s, b - (s - a)


@hot
def total(a, b):
    """a + b of two floats."""
    s = a + b
    v = s - a
    return s, (a - (s - v)) + (b - v)


@hot
def product(a, b):
    """a b of two floats."""
    p = a * b
    t = SPLITTER * a
    ah = t - (t - a)
    al = a - ah
    t = SPLITTER * b
    bh = t - (t - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@hot
def from_integer(i):
    """A whole number, |i| < 2^62."""
    h = float(i)
    return quick(h, float(i - int(h)))


@hot
def add(a, b):
    s, e = total(a[0], b[0])
    t, f = total(a[1], b[1])
    s, e = quick(s, e + t)
    return quick(s, e + f)


@hot
def neg(a):
    return -a[0], -a[1]


@hot
def sub(a, b):
    return add(a, neg(b))


@hot
def mul(a, b):
    p, e = product(a[0], b[0])
    return quick(p, e + (a[0] * b[1] + a[1] * b[0]))


@hot
def times(a, x):
    """a times a power of two, exactly."""
    return a[0] * x, a[1] * x


@hot
def div(a, b):
    q = a[0] / b[0]
    r = sub(a, mul((q, 0.0), b))
    p = r[0] / b[0]
    r = sub(r, mul((p, 0.0), b))
    q, p = quick(q, p)
    return add((q, p), (r[0] / b[0], 0.0))


@hot
def root(a):
    """Square root; 0 of what is not above 0."""
    if a[0] <= 0.0:
        return ZERO
    x = math.sqrt(a[0])
    r = sub(a, product(x, x))
    y = quick(x, r[0] / (2.0 * x))
    r = sub(a, mul(y, y))
    return add(y, (r[0] / (2.0 * x), 0.0))


@hot
def less(a, b):
    return a[0] < b[0] or (a[0] == b[0] and a[1] < b[1])


@hot
def floor(a):
    """The greatest whole number that is not above `a`, as an integer."""
    h = math.floor(a[0])
    if h == a[0]:
        return int(h) + int(math.floor(a[1]))
    return int(h)


@hot
def least(a, b):
    return a if less(a, b) else b
