"""An axis without any loss keeps its energy: the coupling of drives to MuJoCo's leapfrog neither brakes nor drives it."""

import math
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stage import Stage, faults
from stage.drives.motors import MOTORS, Drive, Motor

LOSSLESS = replace(MOTORS["17HS4401"], core_loss_resistance=None)
PAGE = Path(__file__).resolve().parents[1] / "docs" / "models.md"


def make_frictionless_stage(drive, integrator="implicitfast"):
    """The page's one axis, without friction, its bumpers out of the way."""
    text = re.search(r"```xml\n(.*?)```", PAGE.read_text(), re.S)[1]
    for old, new in ((' damping="60" frictionloss="4"', ""), ('pos="0.091', 'pos="1'), ('pos="-0.091', 'pos="-1')):
        assert old in text
        text = text.replace(old, new)
    spec = mujoco.MjSpec.from_string(text)
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    return Stage(spec, drives=drive)


def measure_energies(stage, potential, seconds):
    """Kinetic energy of what moves and `potential` of the rotor's angle, J, looked at every 10 ms."""
    x = stage.axes["x"]
    mass, out = float(stage.model.dof_M0[0]), []
    for _ in range(round(seconds / 0.01)):
        stage.run(0.01)
        out.append(0.5 * mass * stage.data.qvel[0] ** 2 + potential(x.position * x.gear))
    return np.array(out)


@pytest.mark.parametrize("payload", [0.0, 3.0])
@pytest.mark.parametrize("speed", [0.02, 0.05])
def test_an_unpowered_axis_glides_over_its_detents_without_gaining_energy(speed, payload):
    """faults.phase_open(x, "a"); faults.phase_open(x, "b"); stage.data.qvel[0] = 0.02; stage.run(4): 24 % more energy."""
    stage = make_frictionless_stage(Drive(LOSSLESS))
    x = stage.axes["x"]
    stage.set_payload(payload, "carriage")
    faults.phase_open(x, "a")
    faults.phase_open(x, "b")
    stage.data.qvel[0] = speed
    detent, teeth = x.drive.detent_torque, x.drive.motor.rotor_teeth
    observed = measure_energies(stage, lambda angle: -detent / (4 * teeth) * np.cos(4 * teeth * angle), 4.0)
    assert observed[-20:].mean() == pytest.approx(observed[:20].mean(), rel=1e-4)


@pytest.mark.parametrize("mode", ["chopper", "sine"])
def test_a_powered_axis_that_was_pushed_keeps_its_amplitude(mode):
    """Stage(one_axis_without_friction); stage.data.qvel[0] = 0.05; stage.run(4): it slipped, and ran away to 800 rad."""
    stage = make_frictionless_stage(Drive(LOSSLESS, mode=mode))
    x = stage.axes["x"]
    stage.data.qvel[0] = 0.05

    def reach():
        observed = []
        for _ in range(100):
            stage.step()
            observed.append(abs(x.load_angle))
        return max(observed)

    first = reach()
    assert first > 1.8, "a wide swing, electrical radians"
    stage.run(4.0)
    assert reach() == pytest.approx(first, rel=2e-3)
    assert x.lost_steps == 0


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_an_unpowered_axis_loses_the_energy_of_its_core_loss_and_no_other(integrator):
    """Speed falls by exp(-b t / J), the energy by its square, with every integrator that a stage takes."""
    motor = Motor("lossy", 2.0, 1.6, 3.0e-3, 0.56, 0.0, 82e-7, core_loss_resistance=400.0)
    stage = make_frictionless_stage(Drive(motor), integrator)
    x = stage.axes["x"]
    faults.phase_open(x, "a")
    faults.phase_open(x, "b")
    stage.data.qvel[0] = 0.05
    energy = measure_energies(stage, lambda angle: 0.0, 0.2)
    time = 0.01 * np.arange(1, len(energy) + 1)
    damping, inertia = motor.torque_constant**2 / 400.0, float(stage.model.dof_M0[0]) / x.gear**2
    first = 0.5 * float(stage.model.dof_M0[0]) * 0.05**2
    assert energy == pytest.approx(first * np.exp(-2 * damping / inertia * time), rel=0.02)
    assert math.exp(-2 * damping / inertia * 0.2) < 0.2


@pytest.mark.parametrize("detent", [0.0, 0.022])
def test_an_axis_rings_at_its_natural_frequency(detent):
    """sqrt(stiffness / mass) / 2 pi, stiffness Nr (Km I + 4 Td) gear^2 on a full step (spec/drives.md, 2)."""
    drive = Drive(LOSSLESS, detent=detent)
    stage = make_frictionless_stage(drive)
    x, mass = stage.axes["x"], float(stage.model.dof_M0[0])
    stiffness = 50 * (LOSSLESS.torque_constant * 1.7 + 4 * detent) * x.gear**2
    expected = math.sqrt(stiffness / mass) / (2 * math.pi)
    stage.data.qvel[0] = 0.05 * 2 * math.pi * expected / (50 * abs(x.gear))  # 0.05 electrical radians
    position = []
    for _ in range(4000):
        stage.step()
        position.append(stage.data.qpos[0])
    observed = np.array(position) - np.mean(position)
    up = np.flatnonzero((observed[:-1] < 0) & (observed[1:] >= 0))
    at = up - observed[up] / (observed[up + 1] - observed[up])
    frequency = (len(at) - 1) / ((at[-1] - at[0]) * stage.model.opt.timestep)
    print(frequency, expected)
    assert frequency == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("payload", [0.0, 2.0])
def test_the_swing_of_an_unforced_axis_never_grows(payload):
    """Amplitudes of a second, then of later ones: with friction each is less; here none is there to hide a gain."""
    stage = make_frictionless_stage(Drive(LOSSLESS))
    stage.set_payload(payload, "carriage")
    stage.data.qvel[0] = 0.03
    swings = []
    for _ in range(8):
        observed = []
        for _ in range(1000):
            stage.step()
            observed.append(abs(stage.axes["x"].load_angle))
        swings.append(max(observed))
    assert max(swings[1:]) <= swings[0] * 1.0005


@pytest.mark.parametrize("speed", [0.15, 0.3, -0.45])
def test_an_axis_that_slips_comes_to_rest_a_multiple_of_an_electrical_revolution_away(speed):
    """Four full steps of 50 um each; friction leaves the rotor a few um beside its step."""
    stage = Stage("xyz", drives=Drive(LOSSLESS), visuals=False)
    x = stage.axes["x"]
    begin = x.position
    stage.data.qvel[stage.model.joint("x").dofadr[0]] = speed
    stage.run(1.0)
    revolutions = (x.position - begin) / 2e-4
    assert abs(round(revolutions)) >= 1
    assert revolutions == pytest.approx(round(revolutions), abs=0.05)
    assert x.lost_steps == -4 * round(revolutions)
