"""The TMC5160 in what the core does with every chip: lines that a limit breaks, and tuning."""

import pytest

from stage import Stage, firmware
from stage.firmware.driver import get_driver_class
from stage.tune import Task, bus_listing
from stage.tune.c_header import format_c_header
from stage.tune.register_planners import create_planner


@pytest.mark.parametrize(("limited", "other"), [("x", "y"), ("y", "x")])
def test_a_limit_that_ends_one_axis_of_a_line_slows_the_other_down(limited, other):
    """The chip does not interpolate, so the other axis cannot finish the line."""
    stage = Stage("xy", chips="tmc5160", visuals=False)
    edge = next(s.touch for s in stage.axes[limited].plant.switches if s.pin == "el_plus")
    speed, accel, before = 20e-3, 0.1, 3e-3
    stage.place(**{limited: edge - before})
    report = firmware.line({limited: 9e-3, other: -9e-3}, stage, speed=speed, accel=accel)
    assert {name: r.stopped_by for name, r in report.axes.items()} == {limited: "EL+", other: "another axis"}
    assert not any(r.ok for r in report.axes.values())
    stopped = before + 0.5 * speed * accel
    assert -stage.axes[other].position == pytest.approx(stopped, abs=0.2e-3), "a ramp down from where the limit was met"
    assert firmware.move(stage.axes[other], 1e-3).ok, "and it is at rest, and moves again"


def test_each_axis_of_a_broken_line_slows_down_once(monkeypatch):
    """Three axes come to rest one after the other, and each report names the cause."""
    stage = Stage("xyz", chips="tmc5160", visuals=False)
    driver = get_driver_class(type(stage.axes["x"].chip))
    slowed, slow_down = [], driver.slow_down
    monkeypatch.setattr(driver, "slow_down", lambda self: (slowed.append(self.axis.name), slow_down(self)))
    edge = next(s.touch for s in stage.axes["x"].plant.switches if s.pin == "el_plus")
    stage.place(x=edge - 3e-3)
    report = firmware.line({"x": 9e-3, "y": 9e-3, "z": 0.1e-3}, stage, speed=20e-3, accel=0.3)
    assert sorted(slowed) == ["y", "z"]
    assert {n: r.stopped_by for n, r in report.axes.items()} == {"x": "EL+", "y": "another axis", "z": "another axis"}


def test_the_formula_of_a_tuned_move_keeps_to_the_registers_and_its_waits_are_in_the_c():
    task = Task(Stage("xy", chips="tmc5160", visuals=False), "x", pulses=512_000, payload=2.0, hold=0.02)
    chip = task.stage.axes["x"].chip
    plans = create_planner(task)
    for name, value in plans.build_formula_plan().registers.items():
        assert chip.MAP.register(name).allows(value)
    cycles = bus_listing.list_bus_cycles(
        task, bus_listing.build_program(plans, plans.build_formula_plan(), task.pulses)
    )
    assert "send(address, value)" in format_c_header("x", "", [], [], cycles, chip)
    assert "50000}, /* CHOPCONF" in format_c_header("x", "", [], [], cycles, chip)
