"""The tour knows from pulses, switches and rotors what has happened, with any chip."""

import time
from types import SimpleNamespace

import pytest

from stage import Stage, firmware
from stage.firmware.driver import Speeds, get_driver
from stage.panel import tour as tours
from stage.panel.session import UNPACED_SPEED, Session
from stage.panel.tour import MAX_RATES, QUIET_TIME_S, SAMPLE_TIME_S, SIMULTANEITY_S, STEPS, AxisMotion, Tour


@pytest.mark.slow
@pytest.mark.parametrize("chips", ["pcl240ms", "mcx514"])
def test_each_step_waits_until_it_has_been_done(chips):
    stage = Stage("xy", chips=chips, visuals=False)
    with Session(stage, speed=UNPACED_SPEED, paused=True) as session:
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
    assert AxisMotion([500, 900, 1000, 1000, 1000, 600, 300]).list_plateaus() == [1000]
    assert AxisMotion([500, 1000, 1000, 1001, 1500, 2000, 2000, 2000, 700]).list_plateaus() == [1000, 2000]


def test_two_rates_speed_up_while_an_origin_return_slows_down():
    up, down = [500] * 4 + [2000] * 4, [2000] * 4 + [500] * 4
    for rates, observed in ((up, True), (down, False)):
        assert STEPS[4].done(SimpleNamespace(finished=[("x", AxisMotion(rates))])) == observed


class Slices:
    """A session's slices, without a session: of a stage that somebody runs."""

    observers = ()

    def __init__(self, stage):
        self.stage = stage
        stage.loop.pace = self.pace

    def call_after_pacing_intervals(self, look):
        self.looks = (look,)
        return lambda: setattr(self, "looks", ())

    def pace(self, until):
        for look in self.looks:
            look(self.stage)
        return min(until, self.stage.now + 20_000_000)


def test_two_rates_and_a_line_complete_their_steps():
    stage = Stage("xy", visuals=False)
    slices, (x, y) = Slices(stage), map(get_driver, stage.axes.values())
    tour = Tour(slices)
    for _ in range(4):
        tour.skip()
    x.move(3_000, Speeds(1000, 4000, 0.1, 0.1))
    stage.run(0.2)
    assert tour.step.title == "Dual rate", "one speed is not two"
    x.move_at_two_rates(12_000, Speeds(1000, 4000, 0.1, 0.1).with_second_rate(12_000), 0.3)
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


class Watched:
    """A session and a stage of two axes, of which a test says what they have done: stage.x.net, .lost, .org."""

    def __init__(self):
        self.time = 0.0
        self.axes = {name: self._axis(name) for name in "xy"}
        self.x, self.y = self.axes.values()
        self.tour = Tour(self)

    @staticmethod
    def _axis(name):
        axis = SimpleNamespace(name=name, net=0.0, lost_steps=0, org=False)
        axis.read_drive = lambda: (None, axis.net)
        axis.switches = SimpleNamespace(as_dict=lambda: {"org": axis.org, "el_plus": True})
        return axis

    def call_after_pacing_intervals(self, look):
        return lambda: None

    def passes(self, seconds, **rates):
        """So much time in slices of a SAMPLE_TIME_S, at rates of axes, pulses a second."""
        for _ in range(round(seconds / 0.02)):
            self.time += 0.02
            for name, rate in rates.items():
                self.axes[name].net += rate * 0.02
            self.tour.observe(self)

    def at(self, number):
        """Assert that the tour waits for this step."""
        while self.tour.number < number:
            self.tour.skip()
        return self.tour

    def rest(self):
        self.passes(QUIET_TIME_S + 0.06)


@pytest.fixture
def watched():
    watched = Watched()
    watched.tour.observe(watched)
    return watched


@pytest.mark.parametrize(
    ("rates", "expected"),
    [
        ([], []), ([7], []), ([7, 7], []), ([7, 7, 7], [7]), ([5, 7, 7, 7], [7]), ([7, 7, 7, 5], [7]), ([7, 7, 5, 7, 7], []),
        ([1000, 1030, 1000], [1000]), ([1000, 1032, 1000], []), ([1000, 969, 1000], []), ([1000, 971, 1000], [1000]),
        ([1000] * 3 + [1190] * 3, [1000]), ([1000] * 3 + [1210] * 3, [1000, 1210]), ([1000] * 3 + [790] * 3, [1000, 790]),
        ([1000] * 3 + [810] * 3, [1000]), ([10] * 3 + [20] * 3 + [10] * 3, [10, 20, 10]), ([9] * 20, [9]),
    ],
)  # fmt: skip
def test_a_plateau_is_three_rates_within_a_thirtieth_and_another_is_a_fifth_away(rates, expected):
    assert AxisMotion(rates).list_plateaus() == expected


def observed(number, *drives):
    return STEPS[number].done(SimpleNamespace(finished=[(n, d) for n, d in drives], lost=False))


@pytest.mark.parametrize(
    ("rates", "ramp"),
    [
        ([], False), ([1, 2], False), ([1, 2, 1], True), ([2, 1, 2], False), ([1, 2, 2], False), ([2, 2, 1], False),
        ([79, 100, 79], True), ([80, 100, 79], False), ([79, 100, 80], False), ([10, 50, 100, 100, 60, 20], True),
    ],
)  # fmt: skip
def test_a_ramp_begins_and_ends_slower_than_four_fifths_of_what_it_reaches(rates, ramp):
    assert observed(1, ("x", AxisMotion(rates))) == ramp
    assert observed(1, ("y", AxisMotion([5] * 9)), ("x", AxisMotion(rates))) == ramp, "any drive of those"
    assert observed(1, ("x", AxisMotion(rates)), ("y", AxisMotion([5] * 9))) == ramp


def test_the_two_rates_step_needs_one_run_that_speeds_up_between_plateaus():
    slow, fast = [500] * 3, [2000] * 3
    assert observed(4, ("x", AxisMotion(slow + fast)))
    assert observed(4, ("x", AxisMotion(fast + slow + fast))), "also later"
    assert not observed(4, ("x", AxisMotion(slow)), ("x", AxisMotion(fast)))
    assert not observed(4, ("x", AxisMotion(fast + slow)))


@pytest.mark.parametrize(
    ("first", "second", "together"),
    [
        (("x", 0.0, 1.0), ("y", 0.0, 1.0), True), (("x", 0.0, 1.0), ("x", 0.0, 1.0), False),
        (("x", 0.0, 1.0), ("y", 0.5, 1.0 + 0.9 * SIMULTANEITY_S), True),
        (("x", 0.0, 1.0), ("y", 0.5, 1.0 + 1.1 * SIMULTANEITY_S), False),
        (("x", 0.0, 1.0 + 0.9 * SIMULTANEITY_S), ("y", 0.5, 1.0), True),
        (("x", 0.0, 1.0 + 1.1 * SIMULTANEITY_S), ("y", 0.5, 1.0), False),
        (("x", 0.0, 1.0), ("y", 1.0, 1.05), False), (("x", 1.0, 1.05), ("y", 0.0, 1.0), False),
        (("x", 0.0, 1.0), ("y", 0.98, 1.05), True),
    ],
)  # fmt: skip
def test_drives_of_two_axes_are_together_where_they_overlap_and_end_within_a_tenth_of_a_second(first, second, together):
    drives = [(name, AxisMotion(begin=began, end=ended)) for name, began, ended in (first, second)]
    assert observed(5, *drives) == together
    between = ("x", AxisMotion(begin=-9.0, end=-8.0))
    assert not observed(5, drives[0], between, drives[1]), "one right after the other ends"
    assert observed(5, between, *drives) == together


def test_a_drive_is_its_rates_without_sign_from_its_first_pulse_to_its_last(watched):
    watched.at(1)
    watched.passes(0.1)
    watched.passes(0.06, x=-500.0)
    watched.passes(0.04, x=-250.0)
    watched.passes(0.06, y=0.0)
    assert not watched.tour.finished, "not quiet for long enough"
    watched.rest()
    ((name, drive),) = watched.tour.finished
    assert name == "x"
    assert drive.rates == pytest.approx([500, 500, 500, 250, 250])
    assert (drive.begin, drive.end) == pytest.approx((0.1, 0.2))
    watched.passes(0.04, x=100.0)
    assert len(watched.tour.finished) == 1
    watched.rest()
    assert watched.tour.finished[1][1].rates == pytest.approx([100, 100])


def test_a_pause_that_is_shorter_than_quiet_is_of_the_same_drive(watched):
    watched.at(1)
    for _ in range(3):
        watched.passes(0.04, x=500.0)
        watched.passes(0.06)
    watched.rest()
    ((_, drive),) = watched.tour.finished
    assert len(drive.rates) == 6


def test_rates_are_averaged_over_the_sample_time_at_any_slice_rate(watched):
    watched.at(1)
    for k in range(1, 101):
        watched.time, watched.x.net = k * 0.001, 0.7 * k
        watched.tour.observe(watched)
    watched.rest()
    ((_, drive),) = watched.tour.finished
    assert drive.rates == pytest.approx([700] * 5)
    assert 0.001 < SAMPLE_TIME_S < 0.02


def test_the_first_pulse_counts_during_its_run(watched):
    watched.passes(0.1)
    assert watched.tour.number == 0
    watched.passes(0.02, y=-50.0)
    assert watched.tour.number == 1
    watched.rest()
    assert not watched.tour.finished, "it began before the step that waits"
    watched.passes(0.04, y=50.0)
    watched.rest()
    assert len(watched.tour.finished) == 1


def test_a_stall_is_steps_lost_by_any_axis_since_the_step_began(watched):
    watched.y.lost_steps = 4
    tour = watched.at(2)
    watched.passes(0.1)
    assert tour.number == 2, "lost before"
    watched.y.lost_steps = 0
    watched.passes(0.02)
    assert tour.number == 3, "they came back by four: that is lost, too"
    assert not tour.lost


def test_the_origin_return_step_needs_a_run_over_the_axis_own_switch(watched):
    tour = watched.at(3)
    watched.y.org = True
    watched.passes(0.06, x=100.0)
    watched.rest()
    assert tour.number == 3, "the switch of another axis"
    watched.x.org = True
    watched.passes(0.1)
    watched.x.org = False
    watched.passes(0.06, x=100.0)
    watched.rest()
    assert tour.number == 3, "it was not on while it drove"
    watched.passes(0.02, x=100.0)
    watched.x.org = True
    watched.passes(0.02, x=100.0)
    watched.x.org = False
    watched.passes(0.02, x=100.0)
    watched.rest()
    assert tour.number == 4


def test_a_run_after_the_restored_time_is_forgotten(watched):
    tour = watched.at(1)
    watched.passes(0.1, x=100.0)
    watched.time, watched.x.net = 0.01, 0.0
    tour.observe(watched)
    assert not tour.has_pulses()
    watched.rest()
    assert not tour.finished
    watched.passes(0.04, x=100.0)
    watched.rest()
    assert len(tour.finished) == 1


def test_the_tour_remembers_the_last_drives_and_the_last_rates(watched):
    tour = watched.at(5)
    for k in range(18):
        watched.passes(0.04, x=100.0 * (k + 1))
        watched.rest()
    assert [round(d.rates[0]) for _, d in tour.finished] == [100 * k for k in range(3, 19)]
    for k in range(MAX_RATES + 5):
        watched.passes(0.02, x=1000.0 + k)
    rates = tour._running_axes["x"].rates
    assert (len(rates), round(rates[-1])) == (MAX_RATES, 1000 + MAX_RATES + 4)


def test_after_the_last_step_skipping_changes_nothing(watched):
    tour = watched.at(len(STEPS))
    assert tour.step is None
    tour.skip()
    assert tour.number == len(STEPS)
    watched.passes(0.1, x=100.0)
    assert tour.number == len(STEPS)
    assert tours.STEPS[0].done is Tour.has_pulses
