"""The tour knows from pulses, switches and rotors what has happened, with any chip."""

import time
from types import SimpleNamespace

import pytest

from stage import Stage, firmware
from stage.firmware.driver import Speeds, driver_of
from stage.panel.session import FREE, Session
from stage.panel.tour import STEPS, Run, Tour


@pytest.mark.slow
@pytest.mark.parametrize("chips", ["pcl240ms", "mcx514"])
def test_each_step_waits_until_it_has_been_done(chips):
    stage = Stage("xy", chips=chips, visuals=False)
    with Session(stage, speed=FREE, paused=True) as session:
        tour = Tour(session)
        session.paused = False

        def waits_for(title):
            end = time.monotonic() + 20
            while tour.step is None or tour.step.title != title:
                assert time.monotonic() < end, f"waits for {tour.step}, not for {title}"
                time.sleep(0.001)

        def act(order):
            session.act("an order", lambda stage: order(stage.axes["x"], stage)).result(60)
            session.act("a pause", lambda stage: stage.run(0.2)).result(60)

        waits_for("First pulse")
        act(lambda x, stage: firmware.move(x, distance=0.001))
        waits_for("Ramp")
        act(lambda x, stage: firmware.move(x, distance=0.001, speed=2e-3, start_speed=2e-3))
        waits_for("Ramp")  # a move at one speed has none
        act(lambda x, stage: firmware.move(x, distance=0.04))
        waits_for("Stall")
        act(lambda x, stage: firmware.move(x, distance=0.03))
        waits_for("Stall")  # no step was lost
        act(lambda x, stage: stage.set_payload(60))
        act(lambda x, stage: firmware.move(x, distance=-0.03, speed=0.2, accel=0.02))
        waits_for("Origin return")
        act(lambda x, stage: stage.set_payload(0))
        act(lambda x, stage: firmware.home(x))
        waits_for("Dual rate")
        tour.close()


def test_a_drive_with_two_speeds_has_two_plateaus():
    assert Run([500, 900, 1000, 1000, 1000, 600, 300]).plateaus() == [1000]
    assert Run([500, 1000, 1000, 1001, 1500, 2000, 2000, 2000, 700]).plateaus() == [1000, 2000]


def test_two_rates_go_up_and_an_origin_return_goes_down():
    up, down = [500] * 4 + [2000] * 4, [2000] * 4 + [500] * 4
    for rates, seen in ((up, True), (down, False)):
        assert STEPS[4].done(SimpleNamespace(finished=[("x", Run(rates))])) == seen


class Slices:
    """A session's slices, without a session: of a stage that somebody runs."""

    looks = ()

    def __init__(self, stage):
        self.stage = stage
        stage.loop.pace = self.pace

    def on_slice(self, look):
        self.looks = (look,)
        return lambda: setattr(self, "looks", ())

    def pace(self, until):
        for look in self.looks:
            look(self.stage)
        return min(until, self.stage.now + 20_000_000)


def test_two_rates_and_then_a_line_are_seen_and_nothing_less():
    stage = Stage("xy", visuals=False)
    slices, (x, y) = Slices(stage), map(driver_of, stage.axes.values())
    tour = Tour(slices)
    for _ in range(4):
        tour.skip()
    x.move(3_000, Speeds(1000, 4000, 0.1, 0.1))
    stage.run(0.2)
    assert tour.step.title == "Dual rate", "one speed is not two"
    x.two_rates(12_000, Speeds(1000, 4000, 0.1, 0.1), 12_000, 0.3)
    stage.run(0.2)
    assert tour.step.title == "Synchronized move"
    for driver in (x, y):
        driver.move(2_000, Speeds())
        stage.run(0.2)
    assert tour.step is not None, "one after the other is not together"
    for driver in (x, y):
        driver.start(-2_000, Speeds())
    stage.run(1.0)
    assert tour.step is None
    tour.close()
    assert not slices.looks


def test_the_steps_are_those_of_the_page():
    assert [step.title for step in STEPS] == [
        "First pulse", "Ramp", "Stall", "Origin return", "Dual rate", "Synchronized move",
    ]  # fmt: skip
