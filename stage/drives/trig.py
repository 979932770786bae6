"""Sine and cosine computed together, with the same bits on every machine; compiled into their callers.

The angle is reduced by quarter turns (Cody and Waite, three parts of pi / 2), then two minimax polynomials on +-pi / 4, those
of fdlibm's k_sin.c and k_cos.c. Error: 1 unit in the last place, plus that of the angle itself.
"""

from __future__ import annotations

from stage.native import floor, hot

QUADRANTS_PER_RAD = 0.6366197723675814  # a radian, 2 / pi
FIRST, SECOND, THIRD = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21  # pi / 2 in parts of 33 bits


@hot
def compute_sincos(angle):
    """Compute (sin x, cos x) for x in radians, without branches and integers, so that a loop over it is vectorized."""
    k = floor(angle * QUADRANTS_PER_RAD + 0.5)
    r = angle - k * FIRST - k * SECOND - k * THIRD
    z = r * r
    s = 8.333333333322489e-3 + z * (-1.98412698298579493134e-4 + z * (2.75573137070700676789e-6
        + z * (-2.50507602534068634195e-8 + z * 1.58969099521155010221e-10)))  # fmt: skip
    s = r + r * z * (-1.66666666666666324348e-1 + z * s)
    c = 4.16666666666666019037e-2 + z * (-1.38888888888741095749e-3 + z * (2.48015872894767294178e-5
        + z * (-2.75573143513906633035e-7 + z * (2.08757232129817482790e-9 - z * 1.13596475577881948265e-11))))  # fmt: skip
    c = 1.0 - (0.5 * z - z * z * c)
    half = floor(0.5 * k)  # half turns
    sign = 1.0 - 2.0 * (half - 2.0 * floor(0.5 * half))
    odd = k - 2.0 * half > 0.5
    return sign * (c if odd else s), sign * (-s if odd else c)


SMALL_ANGLE_RAD = 0.25  # rad


@hot
def compute_sincos_of_small_angle(angle):
    """Compute (sin r, cos r) of an angle of up to SMALL_ANGLE_RAD radians by Taylor's series, with less than half of the work of
    `compute_sincos`."""
    z = angle * angle
    s = -1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362880.0 - z * (1.0 / 39916800.0))))
    c = 1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 - z * (1.0 / 3628800.0)))
    return angle + angle * z * s, 1.0 - z * (0.5 - z * c)


@hot
def add_angles(sin_a, cos_a, sin_b, cos_b):
    """Return sine and cosine of the sum of two angles, each given by its sine and cosine."""
    return sin_a * cos_b + cos_a * sin_b, cos_a * cos_b - sin_a * sin_b
