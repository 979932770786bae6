"""Libraries of Arduino from their public repositories run by their folders, unchanged. Nothing of them is in this repository."""

import os
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost

FAST_ACCEL_STEPPER = os.environ.get("PULSESTAGE_FASTACCELSTEPPER", "")
MOVES = """\
#include <FastAccelStepper.h>
FastAccelStepperEngine engine;
void setup()
{
    engine.init();
    FastAccelStepper *stepper = engine.stepperConnectToPin(9);
    stepper->setDirectionPin(5);
    stepper->setEnablePin(6);
    stepper->setAutoEnable(true);
    stepper->setSpeedInHz(4000);
    stepper->setAcceleration(20000);
    for (long target : {3200, -800}) {
        stepper->moveTo(target);
        while (stepper->isRunning())
            delay(1);
        Serial.println(stepper->getCurrentPosition());
    }
    pulsestage::end(0);
}
void loop() {}
"""


@pytest.mark.skipif(not FAST_ACCEL_STEPPER, reason="PULSESTAGE_FASTACCELSTEPPER names no folder of FastAccelStepper")
def test_fastaccelstepper_makes_exactly_its_steps_by_the_output_of_a_timer(tmp_path):
    (tmp_path / "moves.ino").write_text(MOVES)
    stage = Stage("xyz", chips="stepdir", drives="a4988", visuals=False)
    pins, library = "x.step=9,x.dir=5,x.enable=!6", Path(FAST_ACCEL_STEPPER)
    with NativeHost(tmp_path / "moves.ino", Board(stage), pins=pins, libraries=[library]) as host:
        host.run(timeout=10)
    axis = stage.axes["x"]
    assert [text for _, text in host.log] == ["3200", "-800"]
    assert (abs(axis.chip.net()), axis.lost_steps, axis.chip.diagnostics) == (800, 0, [])
    assert host.wiring_problems == ()
