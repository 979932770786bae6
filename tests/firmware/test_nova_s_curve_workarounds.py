"""The S-curve failure of MCX302, MCX304 and MCX312 and the workarounds of NOVA's notice, by bus cycles on chips without a stage."""

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
RAMP_S = 2 * ((V - SV) * M / JERK) ** 0.5
DRIVE_S = 2 * RAMP_S + (PULSES - (V + SV) * M * RAMP_S) / (V * M)  # s
MAX_IN_D = SV * M + JERK / 2 * AREA_D**2  # pps
MAX_EXTRA_PULSES = 3  # pulses at MAX_IN_D within a polling period of 1 ms, and one more for its phase
US = 1e-6
TIMES_IN_AREA_D = [DRIVE_S - AREA_D + 2 * US, DRIVE_S - AREA_D / 2, DRIVE_S - AREA_D / 7, DRIVE_S - 8 * US]
WATCHED_S = 3 * AREA_D  # the last seconds of a drive, in which the routine runs
LIMITS = {"CP": 2**31 - 1, "CM": -(2**31)}


class DriveSetup:
    """Chip on a bench, its workaround driver, and a drive."""

    def __init__(self, cls=MCX304, errata=True, wr1=0, wr2=0, **parameters):
        self.bench = Bench(x=cls(errata=errata))
        self.driver = s_curve_workarounds.open_port(self.bench.axes["x"])
        self.pins = self.driver.axis.pins
        self.driver.write_parameters(
            **{"R": 800_000, "K": K, "A": 8000, "SV": SV, "V": V, "AO": 0} | LIMITS | parameters
        )
        self.driver.write_mode_words(WR1=wr1, WR2=wr2, WR3=s_curve_workarounds.S_CURVE)

    def start(self, pulses=PULSES):
        self.driver.start_drive(pulses)
        self.began = self.bench.time
        return self

    def run_to(self, seconds):
        """Wait until this time after the start."""
        self.bench.wait(max(self.began + seconds - self.bench.time, 0))

    def runs_away(self):
        self.bench.wait(2.5)  # longer than a whole drive
        return self.driver.is_driving() and not self.driver.read_status_register(1) & s_curve_workarounds.PHASES

    def wait_for_end_position(self):
        self.driver.wait_until_stopped(5, poll=0.02)
        return self.driver.read_position()


# Case 1: 26h


def stop_unguarded(setup):
    """Write 26h without a check."""
    setup.driver.write_command(s_curve_workarounds.DECELERATING_STOP)
    return True


def stop_by_flag(setup):
    return s_curve_workarounds.stop_guarded(setup.flag)


def stop_by_speed_criterion(setup):
    return s_curve_workarounds.stop_by_speed(setup.driver, s_curve_workarounds.compute_judgmental_speed(SV, V))


def start_and_stop(stop, seconds, cls=MCX304, pulses=PULSES, **options):
    """Start a drive, request a stop some seconds later, and return the setup and whether 26h was written."""
    setup = DriveSetup(cls, **options)
    setup.flag = s_curve_workarounds.DecelerationFlag(setup.driver)
    setup.start(pulses)
    setup.run_to(seconds)
    return setup, stop(setup)


@every_chip
@pytest.mark.parametrize("seconds", TIMES_IN_AREA_D)
def test_a_stop_command_in_area_d_runs_away_without_a_workaround(cls, seconds):
    setup, was_stopped = start_and_stop(stop_unguarded, seconds, cls)
    assert was_stopped
    assert setup.runs_away()
    for stop in (stop_by_flag, stop_by_speed_criterion):
        setup, was_stopped = start_and_stop(stop, seconds, cls)
        assert not was_stopped
        assert setup.wait_for_end_position() == PULSES


@pytest.mark.parametrize("stop", [stop_by_flag, stop_by_speed_criterion])
def test_the_workaround_prevents_a_runaway_at_every_instant_of_the_drive(stop):
    """60 instants of the drive, and every bus cycle around the beginning and the end of area d."""
    edges = [edge + k * US for edge in (DRIVE_S - AREA_D, DRIVE_S) for k in range(-12, 3)]
    stop_count = 0
    for seconds in [DRIVE_S * k / 60 for k in range(60)] + edges:
        setup, was_stopped = start_and_stop(stop, seconds)
        end = setup.wait_for_end_position()
        assert end < PULSES if was_stopped else end == PULSES
        stop_count += was_stopped
    assert stop_count > 15


@pytest.mark.parametrize(("stop", "from_"), [(stop_by_flag, 0.01), (stop_by_speed_criterion, 0.55)])
def test_the_workaround_stops_the_drive_before_the_deceleration(stop, from_):
    """The speed criterion works from the middle of the acceleration on."""
    for seconds in (from_ * RAMP_S, 0.9 * RAMP_S, RAMP_S + 1e-3):
        setup, was_stopped = start_and_stop(stop, seconds)
        assert was_stopped
        assert setup.wait_for_end_position() < PULSES


def test_only_the_speed_criterion_stops_a_drive_without_constant_speed():
    """A drive too short to reach V; the notice does not mention it for its workaround 1 (1)."""
    pulses, last_pulses = 3000, 20
    seconds = measure_time_of_pulses(pulses, pulses - last_pulses)
    for stop, runs_away in ((stop_unguarded, True), (stop_by_flag, True), (stop_by_speed_criterion, False)):
        setup, _ = start_and_stop(stop, seconds, pulses=pulses)
        assert setup.runs_away() == runs_away


def measure_time_of_pulses(pulses, count):
    """Measure the seconds until a drive has made `count` pulses."""
    setup = DriveSetup().start(pulses)
    while setup.driver.read_position() < count:
        setup.bench.wait(1e-3)
    return setup.bench.time - setup.began


@pytest.mark.parametrize("v", [101, 115, 116])
def test_the_speed_criterion_works_if_area_d_covers_the_full_end_of_the_ramp(v):
    """V so near to SV that the deceleration is never above 125 m: area d begins at the judgmental speed."""
    judgmental = s_curve_workarounds.compute_judgmental_speed(SV, v)
    for k in range(200):
        setup = DriveSetup(K=65_535, V=v).start(2000)
        setup.run_to(1.2 + k * 4e-3)
        s_curve_workarounds.stop_by_speed(setup.driver, judgmental)
        assert setup.wait_for_end_position() <= 2000


def test_the_judgmental_speed_is_the_middle_of_both_speeds():
    assert s_curve_workarounds.compute_judgmental_speed(100, 1000) == 550


def test_each_drive_needs_a_new_deceleration_flag():
    setup, _ = start_and_stop(stop_by_flag, DRIVE_S / 2 + RAMP_S)  # in its deceleration: held back
    assert setup.wait_for_end_position() == PULSES
    flag = s_curve_workarounds.DecelerationFlag(setup.driver)
    setup.start()
    setup.run_to(RAMP_S + 1e-3)
    assert s_curve_workarounds.stop_guarded(flag)
    assert setup.wait_for_end_position() < 2 * PULSES


# Case 2: a hardware limit that decelerates

LIMIT_ROUTINES = {
    "interrupt": (s_curve_workarounds.handle_limit_interrupt, s_curve_workarounds.C_END_ENABLE),
    "polling": (s_curve_workarounds.handle_limit_timer, 0),
}
limit_routine = pytest.mark.parametrize("name", LIMIT_ROUTINES)


def run_into_limit(name, seconds, cls=MCX304, sign=1, routine=True, errata=True, begins=0.0):
    """Start a drive that meets a limit some seconds later, while the routine runs from `begins` seconds on.

    Returns the setup, the positions at which the limit was met, and whether the routine has written 27h.
    """
    watch, wr1 = LIMIT_ROUTINES[name]
    setup = DriveSetup(cls, errata, wr1=wr1, wr2=s_curve_workarounds.LIMIT_DECELERATION_MASK)
    setup.driver.read_status_register(3)
    setup.start(sign * PULSES)
    places = []

    def set_pin():
        setattr(setup.pins, "lmt_plus" if sign > 0 else "lmt_minus", True)
        places.append(abs(setup.driver.axis.rail_position))

    setup.bench.at(setup.began + seconds, set_pin)
    setup.run_to(begins)
    stopped = setup.driver.wait_until_stopped(3, lambda: watch(setup.driver)) if routine else None
    return setup, places, stopped


@every_chip
@limit_routine
@pytest.mark.parametrize("seconds", TIMES_IN_AREA_D)
def test_the_routine_stops_a_runaway_at_a_decelerating_limit_within_3_pulses(cls, name, seconds):
    assert run_into_limit(name, seconds, cls, routine=False)[0].runs_away()
    setup, (place,), stopped = run_into_limit(name, seconds, cls, begins=DRIVE_S - WATCHED_S)
    assert stopped
    assert setup.driver.read_position() - place <= MAX_EXTRA_PULSES


@limit_routine
@pytest.mark.parametrize("sign", [1, -1], ids=["plus", "minus"])
def test_a_limit_before_area_d_stops_within_3_pulses_of_the_area(name, sign):
    begins = PULSES - int(SV * M * AREA_D + JERK * AREA_D**3 / 6)
    setup, (place,), stopped = run_into_limit(name, DRIVE_S - RAMP_S / 2, sign=sign)
    assert stopped
    assert place < begins
    assert abs(setup.driver.read_position()) - begins <= MAX_EXTRA_PULSES


@limit_routine
@pytest.mark.parametrize("seconds", [RAMP_S / 2, DRIVE_S / 2, DRIVE_S + 1], ids=["a", "b", "never"])
def test_the_routines_ignore_a_drive_that_ends_without_them(name, seconds):
    setup, places, stopped = run_into_limit(name, seconds)
    assert not stopped
    assert setup.driver.read_position() == PULSES if not places else setup.driver.read_position() < PULSES


@limit_routine
def test_the_routines_ignore_a_drive_that_a_limit_ends_at_once(name):
    """At constant speed, V = SV, there is no deceleration: the drive has ended when the routine is called."""
    watch, wr1 = LIMIT_ROUTINES[name]
    setup = DriveSetup(wr1=wr1, wr2=s_curve_workarounds.LIMIT_DECELERATION_MASK, V=SV)
    setup.driver.read_status_register(3)
    setup.start()
    setup.bench.at(setup.began + 0.1, lambda: setattr(setup.pins, "lmt_plus", True))
    assert not setup.driver.wait_until_stopped(3, lambda: watch(setup.driver))
    assert 0 < setup.driver.read_position() < PULSES


@limit_routine
def test_a_chip_without_the_erratum_needs_no_routine(name):
    for seconds in TIMES_IN_AREA_D:
        begins = 0.0 if seconds == TIMES_IN_AREA_D[0] else DRIVE_S - WATCHED_S
        setup, _, stopped = run_into_limit(name, seconds, errata=False, begins=begins)
        assert not stopped
        assert setup.driver.read_position() <= PULSES


# Case 3: a software limit


@every_chip
@pytest.mark.parametrize(
    ("pulses", "limits"),
    [(PULSES, {"CP": PULSES - 10, "CM": 0}), (-PULSES, {"CP": 1, "CM": 10 - PULSES})],
    ids=["plus", "minus"],
)
def test_a_drive_beyond_a_software_limit_is_not_started(cls, pulses, limits):
    setup = DriveSetup(cls, wr2=s_curve_workarounds.SOFT_LIMIT_MASK, **limits).start(pulses)
    assert setup.runs_away()
    setup = DriveSetup(cls, wr2=s_curve_workarounds.SOFT_LIMIT_MASK, **limits)
    assert not s_curve_workarounds.start_within_limits(setup.driver, pulses, limits["CM"], limits["CP"])
    assert not setup.driver.is_driving()
    assert setup.driver.read_position() == 0


@pytest.mark.parametrize("sign", [1, -1], ids=["plus", "minus"])
def test_a_drive_that_ends_at_a_software_limit_is_started(sign):
    limits = {"CP": PULSES if sign > 0 else 1, "CM": -PULSES}
    setup = DriveSetup(wr2=s_curve_workarounds.SOFT_LIMIT_MASK, **limits)
    assert s_curve_workarounds.start_within_limits(setup.driver, sign * PULSES, limits["CM"], limits["CP"])
    assert setup.wait_for_end_position() == sign * PULSES


# Case 4: STOP0 to STOP2


def run_with_stop_signal(k, seconds, cls=MCX304, routine=True, begins=0.0):
    setup = DriveSetup(cls, wr1=s_curve_workarounds.STOP_ENABLES[k]).start()
    places = []

    def set_pin():
        setattr(setup.pins, f"stop{k}", True)
        places.append(setup.driver.axis.rail_position)

    setup.bench.at(setup.began + seconds, set_pin)
    setup.run_to(begins)
    watch = setup.driver.wait_until_stopped
    return (
        setup,
        places,
        watch(3, lambda: s_curve_workarounds.handle_stop_signal_timer(setup.driver)) if routine else None,
    )


@every_chip
@pytest.mark.parametrize("k", [0, 1, 2])
def test_the_routine_stops_a_runaway_after_a_stop_signal_within_3_pulses(cls, k):
    for seconds in TIMES_IN_AREA_D:
        assert run_with_stop_signal(k, seconds, cls, routine=False)[0].runs_away()
        setup, (place,), stopped = run_with_stop_signal(k, seconds, cls, begins=DRIVE_S - WATCHED_S)
        assert stopped
        assert setup.driver.read_position() - place <= MAX_EXTRA_PULSES


@pytest.mark.parametrize("seconds", [RAMP_S / 2, DRIVE_S / 2, DRIVE_S + 1], ids=["a", "b", "never"])
def test_the_stop_routine_ignores_a_drive_that_ends_without_it(seconds):
    setup, places, stopped = run_with_stop_signal(0, seconds)
    assert not stopped
    assert setup.driver.read_position() < PULSES if places else setup.driver.read_position() == PULSES


# The driver


def test_the_driver_writes_to_its_axis_only():
    chip = MCX304()
    z = s_curve_workarounds.open_port(SimpleNamespace(name="z", chip=chip, chip_axis=2))
    s_curve_workarounds.open_port(SimpleNamespace(name="x", chip=chip, chip_axis=0)).write_parameters(P=5)
    z.write_parameters(R=800_000, SV=1000, V=1000, LP=-3)
    z.write_mode_words(WR1=s_curve_workarounds.C_END_ENABLE)
    z.start_drive(40)
    assert (z.is_driving(), z.read_speed()) == (True, 1000)
    assert set(chip.trace(16_000_000)["axis"]) == {2}
    assert (z.is_driving(), z.read_position()) == (False, 37)
    assert chip.diagnostics == []


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda d: d.write_parameters(K=0), "K .*cannot be 0: .* from 1 to 65535"),
        (lambda d: d.write_parameters(V=8001), "cannot be 8001"),
        (lambda d: d.write_parameters(VV=1), "Did you mean"),
        (lambda d: d.write_mode_words(WR4=1), "WR1, WR2, WR3"),
        (lambda d: d.start_drive(0), "at least one"),
    ],
)
def test_invalid_arguments_are_refused_before_the_first_bus_cycle(act, message):
    setup = DriveSetup()
    began = setup.bench.time
    with pytest.raises(ArgumentError, match=message):
        act(setup.driver)
    assert setup.bench.time == began


@pytest.mark.parametrize("chip", [PCL240K, MCX514], ids=lambda cls: cls.__name__)
def test_other_chips_are_refused(chip):
    with pytest.raises(ArgumentError, match="no MCX304, MCX302 or MCX312"):
        s_curve_workarounds.open_port(Bench(x=chip()).axes["x"])


@pytest.mark.parametrize("stops", [True, False])
def test_a_stop_by_the_routine_is_reported_although_later_calls_return_false(stops):
    setup, samples = DriveSetup().start(), []

    def routine():
        samples.append(setup.bench.time)
        if len(samples) != 100:
            return False
        if stops:
            setup.driver.write_command(s_curve_workarounds.DECELERATING_STOP)
        return stops

    assert setup.driver.wait_until_stopped(5, routine) is stops
    assert len(samples) > 110
    assert (setup.driver.read_position() < PULSES) is stops


def test_a_runaway_ends_in_a_timeout_that_shows_rr1():
    setup, _ = start_and_stop(stop_unguarded, TIMES_IN_AREA_D[1])
    with pytest.raises(RunTimeout, match="still drives after 1 s: RR1 = 000"):
        setup.driver.wait_until_stopped(1)


@every_chip
def test_error_bits_have_the_names_of_the_chip_s_map(cls):
    """erratum.port_of(axis).errors()"""
    setup = DriveSetup(cls)
    assert setup.driver.read_error_names() == ()
    setup.pins.lmt_plus = True
    setup.start()
    setup.bench.wait(1e-3)
    assert "HLMT+" in setup.driver.read_error_names()


def test_a_routine_ignores_a_runaway_of_another_cause():
    """The flow charts of case 2 and 4 begin with their own cause: an interrupt for C-END, a limit, a stop signal."""
    limited = run_into_limit("interrupt", DRIVE_S - AREA_D / 2, routine=False)[0]
    assert limited.runs_away()
    limited.driver.read_status_register(3)  # C-END is reported once
    assert not s_curve_workarounds.handle_limit_interrupt(limited.driver)
    assert not s_curve_workarounds.handle_stop_signal_timer(limited.driver)
    assert limited.runs_away()
    assert s_curve_workarounds.handle_limit_timer(limited.driver)
    reported = DriveSetup().start()
    reported.run_to(DRIVE_S - AREA_D / 2)
    assert stop_unguarded(reported)
    assert reported.runs_away()
    assert not s_curve_workarounds.handle_limit_timer(reported.driver)
    assert not s_curve_workarounds.handle_stop_signal_timer(reported.driver)
    assert reported.runs_away()


class FixedStatusPort:
    """Port with fixed RR1 and RR3 that records the commands it gets."""

    def __init__(self, factors, status, driving):
        self._words, self._driving, self.commands = {1: status, 3: factors}, driving, []

    def read_status_register(self, number):
        return self._words[number]

    def is_driving(self):
        return self._driving

    def write_command(self, code):
        self.commands.append(code)


RUNS_AWAY = (s_curve_workarounds.C_END, s_curve_workarounds.LIMIT_STOP_MASK, True)
"""RR3, RR1, and whether the axis drives."""


@pytest.mark.parametrize(
    ("status", "stops"),
    [
        (RUNS_AWAY, True),
        (
            (
                s_curve_workarounds.C_END | 0xF,
                s_curve_workarounds.LIMIT_STOP_MASK & -s_curve_workarounds.LIMIT_STOP_MASK,
                True,
            ),
            True,
        ),
        ((0xFFFF & ~s_curve_workarounds.C_END, s_curve_workarounds.LIMIT_STOP_MASK, True), False),
        ((s_curve_workarounds.C_END, s_curve_workarounds.LIMIT_STOP_MASK | s_curve_workarounds.DSND, True), False),
        ((s_curve_workarounds.C_END, s_curve_workarounds.LIMIT_STOP_MASK, False), False),
        ((s_curve_workarounds.C_END, 0, True), False),
        *(
            ((s_curve_workarounds.C_END, s_curve_workarounds.LIMIT_STOP_MASK | 1 << k, True), False)
            for k in range(16)
            if s_curve_workarounds.PHASES >> k & 1
        ),
    ],
)
def test_the_limit_interrupt_stops_the_drive_only_if_all_status_bits_show_a_runaway(status, stops):
    """C-END, DSND, n-DRV, the limit's bits, the phases: 27h only if all of them show a runaway"""
    port = FixedStatusPort(*status)
    assert s_curve_workarounds.handle_limit_interrupt(port) is stops
    assert port.commands == [s_curve_workarounds.SUDDEN_STOP] * stops
