"""The S-curve failure of MCX302, MCX304 and MCX312 and the work-arounds of NOVA's notice, by bus cycles on chips alone."""

from types import SimpleNamespace

import pytest

from stage import ArgumentError, RunTimeout
from stage.chips import MCX302, MCX304, MCX312, MCX514, PCL240K
from stage.firmware import Bench
from stage.firmware.nova import s_curve_workarounds

every_chip = pytest.mark.parametrize("cls", [MCX302, MCX304, MCX312], ids=lambda cls: cls.__name__)
PULSES = 12_000
K, SV, V, M = 20_000, 100, 1000, 10
JERK, AREA_D = 62.5e6 * M / K, 2e-6 * K  # pps/s^2, s
RAMP = 2 * ((V - SV) * M / JERK) ** 0.5
FULL = 2 * RAMP + (PULSES - (V + SV) * M * RAMP) / (V * M)  # s
MAX_IN_D = SV * M + JERK / 2 * AREA_D**2  # pps
LATE = 3  # pulses: at MOST_IN_D in a polling period of 1 ms, and one for where the periods begin
US = 1e-6
IN_D = [FULL - AREA_D + 2 * US, FULL - AREA_D / 2, FULL - AREA_D / 7, FULL - 8 * US]
SHORTLY = 3 * AREA_D  # from when on a routine watches that has nothing to see before
LIMITS = {"CP": 2**31 - 1, "CM": -(2**31)}


class Setup:
    """A chip on a bench, its driver, and the flag of case 1, (1), once a start has made it."""

    def __init__(self, cls=MCX304, errata=True, wr1=0, wr2=0, **parameters):
        self.bench = Bench(x=cls(errata=errata))
        self.driver = s_curve_workarounds.open_port(self.bench.axes["x"])
        self.pins = self.driver.axis.pins
        self.driver.load(**{"R": 800_000, "K": K, "A": 8000, "SV": SV, "V": V, "AO": 0} | LIMITS | parameters)
        self.driver.mode(WR1=wr1, WR2=wr2, WR3=s_curve_workarounds.S_CURVE)

    def start(self, pulses=PULSES):
        self.driver.start(pulses)
        self.began = self.bench.time
        return self

    def run_to(self, seconds):
        """Until so many seconds after the start."""
        self.bench.wait(max(self.began + seconds - self.bench.time, 0))

    def runs_away(self):
        self.bench.wait(2.5)  # longer than a whole drive
        return self.driver.driving() and not self.driver.word(1) & s_curve_workarounds.PHASES

    def ended_at(self):
        self.driver.wait_until_stopped(5, poll=0.02)
        return self.driver.position()


# Case 1: 26h


def bare(setup):
    """26h whenever it is asked for."""
    setup.driver.command(s_curve_workarounds.DECELERATING_STOP)
    return True


def by_flag(setup):
    return s_curve_workarounds.stop_guarded(setup.flag)


def by_speed(setup):
    return s_curve_workarounds.stop_by_speed(setup.driver, s_curve_workarounds.compute_judgmental_speed(SV, V))


def asked(stop, when, cls=MCX304, pulses=PULSES, **options):
    """A drive, and a stop asked for `when` seconds after its start; whether 26h was given."""
    setup = Setup(cls, **options)
    setup.flag = s_curve_workarounds.DecelerationFlag(setup.driver)
    setup.start(pulses)
    setup.run_to(when)
    return setup, stop(setup)


@every_chip
@pytest.mark.parametrize("when", IN_D)
def test_a_stop_command_in_area_d_runs_away_unless_a_work_around_prevents_it(cls, when):
    setup, arguments = asked(bare, when, cls)
    assert arguments
    assert setup.runs_away()
    for stop in (by_flag, by_speed):
        setup, arguments = asked(stop, when, cls)
        assert not arguments
        assert setup.ended_at() == PULSES


@pytest.mark.parametrize("stop", [by_flag, by_speed])
def test_the_work_around_prevents_a_runaway_at_every_instant_of_the_drive(stop):
    """60 instants of the drive, and every bus cycle around the beginning and the end of area d."""
    edges = [edge + k * US for edge in (FULL - AREA_D, FULL) for k in range(-12, 3)]
    arguments = 0
    for when in [FULL * k / 60 for k in range(60)] + edges:
        setup, stopped = asked(stop, when)
        end = setup.ended_at()
        assert end < PULSES if stopped else end == PULSES
        arguments += stopped
    assert arguments > 15


@pytest.mark.parametrize(("stop", "from_"), [(by_flag, 0.01), (by_speed, 0.55)])
def test_the_work_around_stops_the_drive_before_the_deceleration(stop, from_):
    """The speed criterion works from the middle of the acceleration on."""
    for when in (from_ * RAMP, 0.9 * RAMP, RAMP + 1e-3):
        setup, arguments = asked(stop, when)
        assert arguments
        assert setup.ended_at() < PULSES


def test_a_drive_without_constant_speed_has_no_interrupt_but_stops_by_speed():
    """A drive too short to reach V: what the notice does not say of its work-around 1 (1)."""
    pulses, last_pulses = 3000, 20
    seconds = when_done(pulses, pulses - last_pulses)
    for stop, away in ((bare, True), (by_flag, True), (by_speed, False)):
        setup, _ = asked(stop, seconds, pulses=pulses)
        assert setup.runs_away() == away


def when_done(pulses, count):
    """Seconds until a drive has made `count` pulses."""
    setup = Setup().start(pulses)
    while setup.driver.position() < count:
        setup.bench.wait(1e-3)
    return setup.bench.time - setup.began


@pytest.mark.parametrize("v", [101, 115, 116])
def test_the_speed_criterion_works_if_area_d_covers_the_full_end_of_the_ramp(v):
    """V so near to SV that the deceleration is never above 125 m: area d begins at the judgmental speed."""
    judgmental = s_curve_workarounds.compute_judgmental_speed(SV, v)
    for k in range(200):
        setup = Setup(K=65_535, V=v).start(2000)
        setup.run_to(1.2 + k * 4e-3)
        s_curve_workarounds.stop_by_speed(setup.driver, judgmental)
        assert setup.ended_at() <= 2000


def test_the_judgmental_speed_is_the_middle():
    assert s_curve_workarounds.compute_judgmental_speed(100, 1000) == 550


def test_each_drive_needs_a_new_deceleration_flag():
    setup, _ = asked(by_flag, FULL / 2 + RAMP)  # in its deceleration: held back
    assert setup.ended_at() == PULSES
    flag = s_curve_workarounds.DecelerationFlag(setup.driver)
    setup.start()
    setup.run_to(RAMP + 1e-3)
    assert s_curve_workarounds.stop_guarded(flag)
    assert setup.ended_at() < 2 * PULSES


# Case 2: a hardware limit that decelerates

LIMIT_ROUTINES = {
    "interrupt": (s_curve_workarounds.handle_limit_interrupt, s_curve_workarounds.C_END_ENABLE),
    "polling": (s_curve_workarounds.handle_limit_timer, 0),
}
limit_routine = pytest.mark.parametrize("name", LIMIT_ROUTINES)


def with_limit(name, when, cls=MCX304, sign=1, routine=True, errata=True, begins=0.0):
    """A drive whose limit is met `when` seconds after its start; where it was then; whether the routine gave 27h, which watches
    from `begins` seconds after the start on."""
    watch, wr1 = LIMIT_ROUTINES[name]
    setup = Setup(cls, errata, wr1=wr1, wr2=s_curve_workarounds.LIMITS_DECELERATE)
    setup.driver.word(3)
    setup.start(sign * PULSES)
    places = []

    def touch():
        setattr(setup.pins, "lmt_plus" if sign > 0 else "lmt_minus", True)
        places.append(abs(setup.driver.axis.rail_position))

    setup.bench.at(setup.began + when, touch)
    setup.run_to(begins)
    stopped = setup.driver.wait_until_stopped(3, lambda: watch(setup.driver)) if routine else None
    return setup, places, stopped


@every_chip
@limit_routine
@pytest.mark.parametrize("when", IN_D)
def test_a_decelerating_limit_in_area_d_runs_away_and_is_ended_within_3_pulses(cls, name, when):
    assert with_limit(name, when, cls, routine=False)[0].runs_away()
    setup, (place,), stopped = with_limit(name, when, cls, begins=FULL - SHORTLY)
    assert stopped
    assert setup.driver.position() - place <= LATE


@limit_routine
@pytest.mark.parametrize("sign", [1, -1], ids=["plus", "minus"])
def test_a_limit_before_area_d_stops_within_3_pulses_of_the_area(name, sign):
    begins = PULSES - int(SV * M * AREA_D + JERK * AREA_D**3 / 6)
    setup, (place,), stopped = with_limit(name, FULL - RAMP / 2, sign=sign)
    assert stopped
    assert place < begins
    assert abs(setup.driver.position()) - begins <= LATE


@limit_routine
@pytest.mark.parametrize("when", [RAMP / 2, FULL / 2, FULL + 1], ids=["a", "b", "never"])
def test_the_routines_leave_a_drive_alone_that_ends_by_itself(name, when):
    setup, places, stopped = with_limit(name, when)
    assert not stopped
    assert setup.driver.position() == PULSES if not places else setup.driver.position() < PULSES


@limit_routine
def test_the_routines_leave_a_drive_alone_that_a_limit_ends_at_once(name):
    """At constant speed, V = SV, there is no deceleration to be seen: when the routine is called, the drive has ended."""
    watch, wr1 = LIMIT_ROUTINES[name]
    setup = Setup(wr1=wr1, wr2=s_curve_workarounds.LIMITS_DECELERATE, V=SV)
    setup.driver.word(3)
    setup.start()
    setup.bench.at(setup.began + 0.1, lambda: setattr(setup.pins, "lmt_plus", True))
    assert not setup.driver.wait_until_stopped(3, lambda: watch(setup.driver))
    assert 0 < setup.driver.position() < PULSES


@limit_routine
def test_a_chip_without_the_erratum_needs_no_routine(name):
    for when in IN_D:
        setup, _, stopped = with_limit(name, when, errata=False, begins=0.0 if when == IN_D[0] else FULL - SHORTLY)
        assert not stopped
        assert setup.driver.position() <= PULSES


# Case 3: a software limit


@every_chip
@pytest.mark.parametrize(
    ("pulses", "limits"),
    [(PULSES, {"CP": PULSES - 10, "CM": 0}), (-PULSES, {"CP": 1, "CM": 10 - PULSES})],
    ids=["plus", "minus"],
)
def test_a_drive_beyond_a_software_limit_is_not_started(cls, pulses, limits):
    setup = Setup(cls, wr2=s_curve_workarounds.SOFT_LIMITS, **limits).start(pulses)
    assert setup.runs_away()
    setup = Setup(cls, wr2=s_curve_workarounds.SOFT_LIMITS, **limits)
    assert not s_curve_workarounds.start_within_limits(setup.driver, pulses, limits["CM"], limits["CP"])
    assert not setup.driver.driving()
    assert setup.driver.position() == 0


@pytest.mark.parametrize("sign", [1, -1], ids=["plus", "minus"])
def test_a_drive_to_a_software_limit_starts_and_stops_there(sign):
    limits = {"CP": PULSES if sign > 0 else 1, "CM": -PULSES}
    setup = Setup(wr2=s_curve_workarounds.SOFT_LIMITS, **limits)
    assert s_curve_workarounds.start_within_limits(setup.driver, sign * PULSES, limits["CM"], limits["CP"])
    assert setup.ended_at() == sign * PULSES


# Case 4: STOP0 to STOP2


def with_stop(k, when, cls=MCX304, routine=True, begins=0.0):
    setup = Setup(cls, wr1=s_curve_workarounds.STOP_ENABLES[k]).start()
    places = []

    def touch():
        setattr(setup.pins, f"stop{k}", True)
        places.append(setup.driver.axis.rail_position)

    setup.bench.at(setup.began + when, touch)
    setup.run_to(begins)
    watch = setup.driver.wait_until_stopped
    return (
        setup,
        places,
        watch(3, lambda: s_curve_workarounds.handle_stop_signal_timer(setup.driver)) if routine else None,
    )


@every_chip
@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_stop_signal_in_area_d_runs_away_and_is_ended_within_3_pulses(cls, k):
    for when in IN_D:
        assert with_stop(k, when, cls, routine=False)[0].runs_away()
        setup, (place,), stopped = with_stop(k, when, cls, begins=FULL - SHORTLY)
        assert stopped
        assert setup.driver.position() - place <= LATE


@pytest.mark.parametrize("when", [RAMP / 2, FULL / 2, FULL + 1], ids=["a", "b", "never"])
def test_the_stop_routine_leaves_a_drive_alone_that_ends_by_itself(when):
    setup, places, stopped = with_stop(0, when)
    assert not stopped
    assert setup.driver.position() < PULSES if places else setup.driver.position() == PULSES


# The driver


def test_the_driver_writes_to_its_axis_only():
    chip = MCX304()
    z = s_curve_workarounds.open_port(SimpleNamespace(name="z", chip=chip, chip_axis=2))
    s_curve_workarounds.open_port(SimpleNamespace(name="x", chip=chip, chip_axis=0)).load(P=5)
    z.load(R=800_000, SV=1000, V=1000, LP=-3)
    z.mode(WR1=s_curve_workarounds.C_END_ENABLE)
    z.start(40)
    assert (z.driving(), z.speed()) == (True, 1000)
    assert set(chip.trace(16_000_000)["axis"]) == {2}
    assert (z.driving(), z.position()) == (False, 37)
    assert chip.diagnostics == []


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda d: d.load(K=0), "K .*cannot be 0: .* from 1 to 65535"),
        (lambda d: d.load(V=8001), "cannot be 8001"),
        (lambda d: d.load(VV=1), "Did you mean"),
        (lambda d: d.mode(WR4=1), "WR1, WR2, WR3"),
        (lambda d: d.start(0), "at least one"),
    ],
)
def test_errors_come_before_the_first_bus_cycle(act, message):
    setup = Setup()
    began = setup.bench.time
    with pytest.raises(ArgumentError, match=message):
        act(setup.driver)
    assert setup.bench.time == began


@pytest.mark.parametrize("chip", [PCL240K, MCX514], ids=lambda cls: cls.__name__)
def test_other_chips_are_refused(chip):
    with pytest.raises(ArgumentError, match="no MCX304, MCX302 or MCX312"):
        s_curve_workarounds.open_port(Bench(x=chip()).axes["x"])


@pytest.mark.parametrize("stops", [True, False])
def test_a_stop_by_the_routine_is_reported_though_it_runs_again_afterwards(stops):
    setup, samples = Setup().start(), []

    def routine():
        samples.append(setup.bench.time)
        if len(samples) != 100:
            return False
        if stops:
            setup.driver.command(s_curve_workarounds.DECELERATING_STOP)
        return stops

    assert setup.driver.wait_until_stopped(5, routine) is stops
    assert len(samples) > 110
    assert (setup.driver.position() < PULSES) is stops


def test_a_runaway_ends_in_a_timeout_that_shows_rr1():
    setup, _ = asked(bare, IN_D[1])
    with pytest.raises(RunTimeout, match="still drives after 1 s: RR1 = 000"):
        setup.driver.wait_until_stopped(1)


@every_chip
def test_error_bits_have_the_names_of_the_chip_s_map(cls):
    """erratum.port_of(axis).errors()"""
    setup = Setup(cls)
    assert setup.driver.errors() == ()
    setup.pins.lmt_plus = True
    setup.start()
    setup.bench.wait(1e-3)
    assert "HLMT+" in setup.driver.errors()


def test_a_routine_ignores_a_runaway_of_another_cause():
    """The flow charts of case 2 and 4 begin with their own cause: an interrupt for C-END, a limit, a stop signal."""
    limited = with_limit("interrupt", FULL - AREA_D / 2, routine=False)[0]
    assert limited.runs_away()
    limited.driver.word(3)  # C-END is told once
    assert not s_curve_workarounds.handle_limit_interrupt(limited.driver)
    assert not s_curve_workarounds.handle_stop_signal_timer(limited.driver)
    assert limited.runs_away()
    assert s_curve_workarounds.handle_limit_timer(limited.driver)
    reported = Setup().start()
    reported.run_to(FULL - AREA_D / 2)
    assert bare(reported)
    assert reported.runs_away()
    assert not s_curve_workarounds.handle_limit_timer(reported.driver)
    assert not s_curve_workarounds.handle_stop_signal_timer(reported.driver)
    assert reported.runs_away()


class Said:
    """A port that says what RR1 and RR3 hold; what it was told is in `told`."""

    def __init__(self, factors, status, driving):
        self._words, self._driving, self.told = {1: status, 3: factors}, driving, []

    def word(self, number):
        return self._words[number]

    def driving(self):
        return self._driving

    def command(self, code):
        self.told.append(code)


RUNS_AWAY = (s_curve_workarounds.C_END, s_curve_workarounds.STOPPED_BY_LIMIT, True)
"""What RR3 and RR1 say, and whether it drives."""


@pytest.mark.parametrize(
    ("said", "stops"),
    [
        (RUNS_AWAY, True),
        (
            (
                s_curve_workarounds.C_END | 0xF,
                s_curve_workarounds.STOPPED_BY_LIMIT & -s_curve_workarounds.STOPPED_BY_LIMIT,
                True,
            ),
            True,
        ),
        ((0xFFFF & ~s_curve_workarounds.C_END, s_curve_workarounds.STOPPED_BY_LIMIT, True), False),
        ((s_curve_workarounds.C_END, s_curve_workarounds.STOPPED_BY_LIMIT | s_curve_workarounds.DSND, True), False),
        ((s_curve_workarounds.C_END, s_curve_workarounds.STOPPED_BY_LIMIT, False), False),
        ((s_curve_workarounds.C_END, 0, True), False),
        *(
            ((s_curve_workarounds.C_END, s_curve_workarounds.STOPPED_BY_LIMIT | 1 << k, True), False)
            for k in range(16)
            if s_curve_workarounds.PHASES >> k & 1
        ),
    ],
)
def test_each_branch_of_the_flow_chart_of_the_limit_interrupt_leaves_the_drive_alone(said, stops):
    """C-END, DSND, n-DRV, the limit's bits, the phases: 27h only where all of them say that it runs away"""
    port = Said(*said)
    assert s_curve_workarounds.handle_limit_interrupt(port) is stops
    assert port.told == [s_curve_workarounds.SUDDEN_STOP] * stops
