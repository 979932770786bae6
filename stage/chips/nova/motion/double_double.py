"""Double-double arithmetic: a number as the exact sum of two floats, (high, low), with about 32 decimal digits.

A speed profile must decide on which side of a clock a pulse falls. At round speeds it falls exactly on the clock, where floats err
and double-doubles do not. Algorithms of Dekker (1971) and Knuth (TAOCP 2, 4.2.2); IEEE arithmetic without fused operations.
"""

from __future__ import annotations

import math

from stage.native import hot

SPLITTER = 134217729.0  # 2^27 + 1
ZERO = (0.0, 0.0)


@hot
def load_pair(row):
    """Load a double-double, the pair (high, low), from the first two floats of a row."""
    return row[0], row[1]


@hot
def store_pair(row, pair):
    """Store a double-double, the pair (high, low), in the first two floats of a row."""
    row[0], row[1] = pair


@hot
def add_ordered_floats(a, b):
    """Add two floats with |a| >= |b|; the result is the exact sum as a double-double."""
    s = a + b
    return s, b - (s - a)


@hot
def add_floats(a, b):
    """Add two floats; the result is the exact sum as a double-double."""
    s = a + b
    v = s - a
    return s, (a - (s - v)) + (b - v)


@hot
def multiply_floats(a, b):
    """Multiply two floats; the result is the exact product as a double-double."""
    p = a * b
    t = SPLITTER * a
    ah = t - (t - a)
    al = a - ah
    t = SPLITTER * b
    bh = t - (t - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@hot
def to_double_double(integer):
    """Convert an integer, |integer| < 2^62, to a double-double, exactly."""
    h = float(integer)
    return add_ordered_floats(h, float(integer - int(h)))


@hot
def add(a, b):
    """Add two double-doubles."""
    s, e = add_floats(a[0], b[0])
    t, f = add_floats(a[1], b[1])
    s, e = add_ordered_floats(s, e + t)
    return add_ordered_floats(s, e + f)


@hot
def negate(a):
    """Negate a double-double."""
    return -a[0], -a[1]


@hot
def subtract(a, b):
    """Subtract the double-double `b` from `a`."""
    return add(a, negate(b))


@hot
def multiply(a, b):
    """Multiply two double-doubles."""
    p, e = multiply_floats(a[0], b[0])
    return add_ordered_floats(p, e + (a[0] * b[1] + a[1] * b[0]))


@hot
def scale(a, power_of_two):
    """Multiply a double-double by a float that is a power of two, exactly."""
    return a[0] * power_of_two, a[1] * power_of_two


@hot
def divide(a, b):
    """Divide the double-double `a` by `b`."""
    q = a[0] / b[0]
    r = subtract(a, multiply((q, 0.0), b))
    p = r[0] / b[0]
    r = subtract(r, multiply((p, 0.0), b))
    q, p = add_ordered_floats(q, p)
    return add((q, p), (r[0] / b[0], 0.0))


@hot
def square_root(a):
    """Compute the square root of a double-double; 0 for a number that is not positive."""
    if a[0] <= 0.0:
        return ZERO
    x = math.sqrt(a[0])
    r = subtract(a, multiply_floats(x, x))
    y = add_ordered_floats(x, r[0] / (2.0 * x))
    r = subtract(a, multiply(y, y))
    return add(y, (r[0] / (2.0 * x), 0.0))


@hot
def is_less(a, b):
    """Return whether the double-double `a` is less than `b`."""
    return a[0] < b[0] or (a[0] == b[0] and a[1] < b[1])


@hot
def floor(a):
    """Return the greatest integer that is not above the double-double `a`."""
    h = math.floor(a[0])
    if h == a[0]:
        return int(h) + int(math.floor(a[1]))
    return int(h)


@hot
def minimum(a, b):
    """Return the lesser of two double-doubles."""
    return a if is_less(a, b) else b
