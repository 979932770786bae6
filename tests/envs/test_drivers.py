"""Host drivers: every pulse chip can be tuned and homed with registers that its data sheet allows."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, Program, Stage
from stage.chips import CHIPS, PCL240K
from stage.envs.origin_return import Config
from stage.envs.register_scaling import RegisterBox
from stage.firmware.driver import get_driver
from stage.sim.program import WRITE

PULSING = [name for name in CHIPS.built_in if not CHIPS[name].SERVO]


def create_driver(chip, axis="x"):
    return get_driver(Stage("xyz", chips=CHIPS[chip], visuals=False).axes[axis])


@pytest.mark.parametrize("chip", PULSING)
def test_the_formulas_registers_of_every_chip_are_those_that_tune_it_and_legal(chip):
    h = create_driver(chip)
    for s_curve in (None, False, True):
        if s_curve and chip in ("PCL240K", "PCL240MK"):
            with pytest.raises(ArgumentError, match="linear ramps only"):
                h.list_move_registers(s_curve)
            continue
        box = RegisterBox.of_registers(h.chip.MAP, h.list_move_registers(s_curve))
        values = h.compute_move_registers(1000.0, 40_000.0, 0.2, 0.15, 16_000, s_curve)
        created = box.to_dict(box.from_action(box.to_action(values)))
        assert created == {name: pytest.approx(values[name], rel=2e-6) for name in box.names}


@pytest.mark.parametrize("chip", PULSING)
def test_programs_of_moves_are_alike_whatever_their_registers(chip):
    h = create_driver(chip)
    box = RegisterBox.of_registers(h.chip.MAP, h.list_move_registers(None))

    def move(row, pulses):
        program = Program()
        h.write_move(program, box.to_dict(row), pulses)
        return np.array(program.ops)

    least, maximum = move(box.low, 1), move(box.high, 100_000)
    assert (least[:, :3] == maximum[:, :3]).all(), "only data differ"


@pytest.mark.parametrize("chip", PULSING)
@pytest.mark.parametrize("axis", ["x", "z"])
def test_programs_of_searches_keep_their_marks_whatever_is_selected(chip, axis):
    search = create_driver(chip, axis).build_home_program(Config())
    saved = dict(search.result_indices)
    for row in (search.choices.low, [maximum for _, maximum in search.choices.ranges.values()]):
        program = search.write_program(row)
        assert search.result_indices == saved
        assert max(saved.values()) < len(program)


def test_a_servo_driver_stops_the_axis_and_refuses_pulse_procedures():
    h, p = create_driver("HCTL1100"), Program()
    h.write_stop(p)
    assert p.ops == [(WRITE, 0, 0x05, 0x01)]
    for requested in (
        lambda: h.list_move_registers(None),
        lambda: h.write_move(p, {}, 100),
        lambda: h.compute_move_registers(1000.0, 40_000.0, 0.2, 0.15, 16_000),
        lambda: h.build_home_program(Config()),
        lambda: h.build_line_programs([h], None),
    ):
        with pytest.raises(
            ArgumentError, match=r"chip HCTL1100 on axis x: .* makes no pulses\. Take ServoTuning, RegisterBus"
        ):
            requested()


@pytest.mark.parametrize("name", ["RegisterTuning", "OriginReturn", "SynchronizedMove"])
def test_pulse_tasks_refuse_a_servo_chip(name):
    with pytest.raises(ArgumentError, match="chip HCTL1100"):
        gymnasium.make(f"stage/{name}-v0", chip="HCTL1100")


def test_a_family_without_a_driver_is_named():
    chip = PCL240K()
    chip.__class__ = type("Z80", (PCL240K,), {"DRIVER": ""})
    with pytest.raises(ArgumentError, match="a Z80 has no driver: its class names one in DRIVER"):
        get_driver(SimpleNamespace(chip=chip))
    with pytest.raises(ArgumentError, match="no axis"):
        get_driver(SimpleNamespace(chip="Z80"))
