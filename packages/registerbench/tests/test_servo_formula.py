"""Tests of the engineer of a servo, who designs its filter without a trial."""

import sys

import pytest

from registerbench.baselines import servo_formula
from stage import Stage, StageError
from stage.chips import HCTL1100


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 10.0])
def test_the_engineers_design_has_its_margin_and_settles_sooner_than_after_a_reset(payload):
    pytest.importorskip("control", reason="extra servo is not installed")
    machine = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    machine.set_payload(payload)
    loop = servo_formula.ServoLoop.from_axis(
        machine.axes["x"], servo_formula.FilterTuning(pole=servo_formula.DEFAULT_POLE)
    )
    created = servo_formula.design_filter(loop)
    assert created.phase_margin == pytest.approx(
        servo_formula.PHASE_MARGIN_DEGREES, abs=servo_formula.MAX_MARGIN_LOSS_DEGREES
    )
    assert created.gain_margin > 2
    assert abs(servo_formula.replace(loop, tuning=created.tuning).poles).max() < 1
    after_reset = {"R22": 0x40, "R20": 0xE5, "R21": 0x40, "R0F": 0x40}
    designed = servo_formula.measure_moves(payload, servo_formula.design_registers(machine.axes["x"]), moves=1)
    assert designed["reward"] > servo_formula.measure_moves(payload, after_reset, moves=1)["reward"]


def test_without_python_control_the_baseline_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(StageError, match=r"pip install -e '\.\[servo\]'"):
        servo_formula.import_control()
