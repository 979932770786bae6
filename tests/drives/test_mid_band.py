"""Mid-band instability of a stepper on a voltage, and what the damper of the bench hides of it; docs/how_far_to_trust_it.md."""

from dataclasses import replace

import numpy as np
import pytest

from stage.drives.dynamometer import simulate_pull_out
from stage.drives.motors import Drive, find_motor

MOTOR = find_motor("17HS4401")
LOSSLESS = replace(MOTOR, core_loss_resistance=None)


def compute_growth(m, volts, rpm, inertia):
    """Compute the fastest growth, 1/s, of a small disturbance of a rotor in step, unloaded, on a sinusoidal voltage.

    Equations of the motor in the rotor's coordinates (current along and across its field, speed, angle of the voltage),
    linearized about their steady state; the better of its two solutions.
    """
    w, n, km, r, b = rpm * 2 * np.pi / 60, m.rotor_teeth, m.torque_constant, m.resistance, m.core_loss_damping
    x, across = n * w * m.inductance, b * w / km
    root = np.sqrt((x * km * w) ** 2 - (r**2 + x**2) * ((x * across) ** 2 + (r * across + km * w) ** 2 - volts**2))
    growths = []
    for along in ((-x * km * w + sign * root) / (r**2 + x**2) for sign in (1, -1)):
        v_along, v_across = r * along - x * across, r * across + x * along + km * w
        assert np.hypot(v_along, v_across) == pytest.approx(volts)
        matrix = [
            [-r / m.inductance, n * w, n * across, -v_across / m.inductance],
            [-n * w, -r / m.inductance, -n * along - km / m.inductance, v_along / m.inductance],
            [0, km / inertia, -b / inertia, 0],
            [0, 0, -n, 0],
        ]
        growths.append(np.linalg.eigvals(np.array(matrix)).real.max())
    return min(growths)


@pytest.mark.parametrize(
    ("m", "rotors", "onset"), [(LOSSLESS, 1, 178), (MOTOR, 1, 182), (LOSSLESS, 10, 123), (MOTOR, 10, 127)]
)
def test_a_voltage_that_gives_the_rated_current_at_rest_is_unstable_from_mid_band_on(m, rotors, onset):
    volts, inertia = m.resistance * m.rated_current, rotors * m.rotor_inertia
    speeds = np.arange(60, 260)
    unstable = [rpm for rpm in speeds if compute_growth(m, volts, rpm, inertia) > 0]
    assert unstable[0] == pytest.approx(onset, abs=1)


def test_the_damper_of_the_bench_hides_torque_that_mid_band_instability_takes():
    drive, rpm = Drive(MOTOR), [600, 1200]
    damped, bare = simulate_pull_out(drive, rpm), simulate_pull_out(drive, rpm, damping_ratio=0.0)
    assert damped == pytest.approx([0.259, 0.189], abs=2e-3)
    assert bare == pytest.approx([0.259, 0.136], abs=3e-3), "the chopper still controls the current at 600 rpm"
