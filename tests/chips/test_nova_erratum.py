"""The S-curve failure of MCX304, MCX302 and MCX312: NOVA's notice of 21 November 2006, in the terms of section 8 of
shared/spec/nova_mcx304.md.

Area d is the end of an S-curve with fixed pulses, where the acceleration reads 0 and the speed is still above SV. A
decelerating stop asked for there makes pulses for ever. The course of the drive below is worked out here by hand.
"""

import copy
import math
import pickle
from typing import NamedTuple

import pytest
from reference.nova_profile import Drive, ceil_clock
from support.covers import covers
from support.nova_bench import (
    DSNDE,
    NOP_304,
    SACC,
    SECOND,
    SEED,
    X,
    Y,
    command,
    driving,
    examples,
    get,
    get_signed,
    load,
    load_304,
    log_uniform,
    put,
    set_wr3,
)

from stage import ArgumentError
from stage.chips import MCX302, MCX304, MCX312, MCX314AS, MCX501, MCX514

CHIPS = (MCX304, MCX302, MCX312)
every_chip = pytest.mark.parametrize("cls", CHIPS, ids=lambda cls: cls.__name__)
US = SECOND // 1_000_000
ASND, CNST, DSND = 0x04, 0x08, 0x10  # of RR1
PHASES, ALL_SIX = ASND | CNST | DSND, 0xFC
SLMT_BOTH, LMTMD, CMPSL, ALM_E = 0x0003, 0x0004, 0x0020, 0x2000  # of WR2
C_END, C_STA, D_END = 0x20, 0x40, 0x80  # of RR3; 2000h of WR1 enables C-END
CONTINUOUS, STOP, SUDDEN = 0x22, 0x26, 0x27
FAR = 0x7FFF_FFFF


class Course(NamedTuple):
    """A symmetric S-curve drive that reaches V; no part of it has constant acceleration. m = 10, AO = 0."""

    K: int = 20_000
    SV: int = 100
    V: int = 1000
    P: int = 12_000

    @property
    def jerk(self):
        """pps/s^2."""
        return 62.5e6 * 10 / self.K

    @property
    def ramp(self):
        """Seconds from SV to V."""
        return 2 * math.sqrt((self.V - self.SV) * 10 / self.jerk)

    @property
    def seconds(self):
        pulses = (self.V + self.SV) * 10 / 2 * self.ramp
        return 2 * self.ramp + (self.P - 2 * pulses) / (self.V * 10)

    def at(self, area):
        """A clock in area a, b, c or d of the notice's figure 3; "d first", "d last", "end"."""
        t, d = self.seconds, 2e-6 * self.K
        clocks = {
            "a": self.ramp / 3,
            "b": t / 2,
            "c": t - self.ramp / 2,
            "c last": math.ceil((t - d) * SECOND) / SECOND - 1 / SECOND,
            "d first": t - d,
            "d": t - d / 2,
            "d last": math.ceil(t * SECOND) / SECOND - 1 / SECOND,
            "end": t,
        }
        return math.ceil(clocks[area] * SECOND - 1e-6)

    def speed_in_d(self, clock):
        """Return the speed in area d at a clock, pps."""
        return self.SV * 10 + self.jerk / 2 * (self.seconds - clock / SECOND) ** 2

    def load(self, chip, wr1=0, wr2=0, wr3=SACC):
        load_304(chip, R=800_000, K=self.K, A=8000, D=8000, SV=self.SV, V=self.V, P=self.P, AO=0, LP=0)
        put(chip, 0x0B, FAR)
        put(chip, 0x0C, -FAR & 0xFFFFFFFF)
        set_wr3(chip, wr3, X, NOP_304)
        chip.write(1, wr1)
        chip.write(2, wr2)

    def begin(self, chip, area="a", sign=1, **modes):
        """Start it at clock 0 of a new chip, and let it run into an area."""
        self.load(chip, **modes)
        assert chip.clock == 0
        command(chip, 0x20 if sign > 0 else 0x21)
        go(chip, self.at(area))
        return chip


COURSE = Course()


class Request(NamedTuple):
    """A decelerating stop: how WR1 and WR2 are set before the start, and what makes it, chip and direction given."""

    act: object
    wr1: int = 0
    wr2: int = 0
    level: bool = True
    """It lasts: made before area d it acts when d begins."""


def limit(chip, sign):
    setattr(chip.axes[0].pins, "lmt_plus" if sign > 0 else "lmt_minus", True)


def soft_limit_lp(chip, sign):
    """LP >= C+, LP < C-."""
    lp = get_signed(chip, 0x10)
    put(chip, 0x0B if sign > 0 else 0x0C, lp if sign > 0 else (lp + 1) & 0xFFFFFFFF)


def soft_limit_ep(chip, sign):
    """Let the encoder's counter jump beyond the software limit."""
    put(chip, 0x0B if sign > 0 else 0x0C, sign * 1000 & 0xFFFFFFFF)
    put(chip, 0x0A, sign * 1001 & 0xFFFFFFFF)


def stop_input(k):
    return lambda chip, sign: setattr(chip.axes[0].pins, f"stop{k}", True)


REQUESTS = {
    "26h": Request(lambda chip, sign: command(chip, STOP), level=False),
    "limit": Request(limit, wr2=LMTMD),
    "software limit of LP": Request(soft_limit_lp, wr2=SLMT_BOTH),
    "software limit of EP": Request(soft_limit_ep, wr2=SLMT_BOTH | CMPSL),
    "STOP0": Request(stop_input(0), wr1=0x02),
    "STOP1": Request(stop_input(1), wr1=0x08),
    "STOP2": Request(stop_input(2), wr1=0x20),
}
every_request = pytest.mark.parametrize("name", REQUESTS)
lasting = pytest.mark.parametrize("name", [name for name, r in REQUESTS.items() if r.level])
in_d = pytest.mark.parametrize("area", ["d first", "d", "d last"])


def go(chip, clock):
    chip.advance(clock - chip.clock)


def phases(chip):
    return chip.read(1) & PHASES


def runs_away(chip):
    """Return whether a chip shows the failure: n-DRV = 1, ASND = CNST = DSND = 0, and pulses beyond P."""
    return driving(chip) and chip.read(1) & ALL_SIX == 0 and chip.advance(20 * SECOND) > COURSE.P


def begin_drive(cls, name, area, sign=1, **options):
    """Begin a drive, with a request made in an area of the notice's figure 3."""
    request = REQUESTS[name]
    chip = COURSE.begin(cls(**options), area, sign, wr1=request.wr1, wr2=request.wr2)
    request.act(chip, sign)
    return chip


def ends(chip):
    """Return the pulses that a drive has made when it ends by itself."""
    go(chip, 10 * SECOND)
    assert not driving(chip)
    assert phases(chip) == 0
    assert chip.advance(SECOND) == 0
    return abs(get_signed(chip, 0x10))


# The four cases of the notice


@every_chip
@every_request
@in_d
def test_a_decelerating_stop_in_area_d_makes_pulses_for_ever(cls, name, area):
    chip = begin_drive(cls, name, area)
    speed = COURSE.speed_in_d(COURSE.at(area))
    assert driving(chip)
    assert chip.read(1) & ALL_SIX == 0
    assert chip.advance(10 * SECOND) == pytest.approx(10 * speed, abs=1)
    assert get_signed(chip, 0x10) > COURSE.P + 10 * speed - 50
    assert runs_away(chip)


@every_request
@in_d
def test_it_does_so_in_the_minus_direction(name, area):
    chip = begin_drive(MCX304, name, area, sign=-1)
    assert runs_away(chip)
    assert get_signed(chip, 0x10) < -COURSE.P - 10_000


@every_chip
@every_request
@pytest.mark.parametrize("area", ["a", "b"])
def test_before_the_deceleration_the_same_request_stops(cls, name, area):
    assert 0 < ends(begin_drive(cls, name, area)) < COURSE.P


@every_chip
@pytest.mark.parametrize("area", ["c", "c last"])
def test_a_stop_command_while_dsnd_is_1_changes_nothing(cls, area):
    chip = begin_drive(cls, "26h", area)
    assert phases(chip) == DSND
    go(chip, COURSE.at("end") - 1)
    assert driving(chip)
    chip.advance(1)
    assert ends(chip) == COURSE.P


@every_chip
@lasting
@pytest.mark.parametrize("area", ["c", "c last"])
def test_a_level_asserted_before_area_d_acts_as_d_begins(cls, name, area):
    chip = begin_drive(cls, name, area)
    assert phases(chip) == DSND
    go(chip, COURSE.at("c last"))
    assert phases(chip) == DSND
    chip.advance(1)
    speed = COURSE.speed_in_d(COURSE.at("d first"))
    assert driving(chip)
    assert phases(chip) == 0
    assert chip.advance(10 * SECOND) == pytest.approx(10 * speed, abs=1)


def test_a_level_that_is_gone_before_area_d_changes_nothing():
    for name, pin in {"limit": "lmt_plus", "STOP0": "stop0", "STOP2": "stop2"}.items():
        chip = begin_drive(MCX304, name, "c")
        go(chip, COURSE.at("c last"))
        setattr(chip.axes[0].pins, pin, False)
        assert ends(chip) == COURSE.P


@every_chip
@every_request
def test_after_the_end_nothing_comes(cls, name):
    assert ends(begin_drive(cls, name, "end")) == COURSE.P


@every_chip
@pytest.mark.parametrize("left", [1, 20])
def test_a_software_limit_that_the_drive_itself_passes_in_area_d_is_enough(cls, left):
    chip = cls()
    COURSE.load(chip, wr2=SLMT_BOTH)
    put(chip, 0x0B, COURSE.P - left)
    command(chip, 0x20)
    go(chip, COURSE.at("end") - 1)
    assert runs_away(chip)


@every_chip
def test_a_software_limit_at_the_target_acts_after_the_end_of_the_drive(cls):
    chip = cls()
    COURSE.load(chip, wr2=SLMT_BOTH)
    put(chip, 0x0B, COURSE.P)
    command(chip, 0x20)
    assert ends(chip) == COURSE.P


# What is not a request


@pytest.mark.parametrize("name", ["software limit of LP", "software limit of EP", "STOP0", "STOP1", "STOP2"])
@in_d
def test_what_is_not_enabled_stops_nothing(name, area):
    chip = COURSE.begin(MCX304(), area, wr2=REQUESTS[name].wr2 & ~SLMT_BOTH)
    REQUESTS[name].act(chip, 1)
    assert ends(chip) == COURSE.P


@pytest.mark.parametrize("other", [0, 1, 2])
def test_one_stop_input_is_not_another(other):
    enabled = 0x2A & ~(2 << 2 * other)
    chip = COURSE.begin(MCX304(), "d", wr1=enabled)
    stop_input(other)(chip, 1)
    assert ends(chip) == COURSE.P


@pytest.mark.parametrize("name", ["limit", "software limit of LP", "software limit of EP"])
@pytest.mark.parametrize("sign", [1, -1], ids=["20h", "21h"])
def test_the_limit_of_the_other_direction_stops_nothing(name, sign):
    chip = COURSE.begin(MCX304(), "d", sign, wr2=REQUESTS[name].wr2)
    REQUESTS[name].act(chip, -sign)
    assert ends(chip) == COURSE.P


@every_chip
@in_d
def test_a_sudden_limit_ends_the_drive_at_once(cls, area):
    chip = COURSE.begin(cls(), area)
    limit(chip, 1)
    assert not driving(chip)
    assert COURSE.P - 50 < ends(chip) < COURSE.P


@every_chip
@in_d
def test_another_axis_does_not_care(cls, area):
    chip = COURSE.begin(cls(), area)
    command(chip, STOP, Y)
    command(chip, NOP_304, X)
    assert ends(chip) == COURSE.P


# What can be seen


@every_chip
def test_rr1_shows_the_areas_of_figure_3(cls):
    chip, observed = COURSE.begin(cls()), []
    for area in ("a", "b", "c", "c last", "d first", "d", "d last"):
        go(chip, COURSE.at(area))
        observed.append(phases(chip))
    command(chip, STOP)
    assert [*observed, phases(chip)] == [ASND, CNST, DSND, DSND, CNST, CNST, CNST, 0]


@covers("MCX304 MCX302 MCX312", "CV", "CA")
@every_chip
def test_in_area_d_the_acceleration_reads_0_and_the_speed_is_above_sv(cls):
    chip = COURSE.begin(cls(), "c last")
    assert get(chip, 0x13) == 1
    go(chip, COURSE.at("d first") + 1)
    assert get(chip, 0x13) == 0
    assert get(chip, 0x12) == int(COURSE.speed_in_d(chip.clock) / 10)
    assert get(chip, 0x12) > COURSE.SV


@every_chip
def test_left_alone_the_drive_ends_on_its_pulse_and_its_clock(cls):
    chip = COURSE.begin(cls(), "d last")
    assert driving(chip)
    assert get_signed(chip, 0x10) == COURSE.P - 1
    chip.advance(1)
    assert not driving(chip)
    assert get_signed(chip, 0x10) == COURSE.P


@every_chip
@pytest.mark.parametrize("away", [False, True], ids=["left alone", "run away"])
def test_c_end_says_that_area_d_is_over(cls, away):
    """The work-around 2 (1) of the notice lives on it: at C-END without DSND the drive has ended or run away."""
    chip = COURSE.begin(cls(), "b", wr1=0x2000)
    assert chip.read(3) & (C_END | C_STA) == C_STA
    go(chip, COURSE.at("c"))
    assert chip.read(3) & (C_END | C_STA) == C_END
    go(chip, COURSE.at("d"))
    assert chip.read(3) & (C_END | C_STA) == C_STA
    if away:
        command(chip, STOP)
    else:
        go(chip, COURSE.at("end"))
    assert chip.read(3) & (C_END | D_END) == (C_END if away else C_END | D_END)
    assert driving(chip) == away


def test_c_end_causes_an_interrupt_if_wr1_enables_it():
    for wr1, asks in ((0x2000, 1), (0xDF00, 0)):
        chip = COURSE.begin(MCX304(), "d", wr1=wr1)
        chip.read(3)
        command(chip, STOP)
        assert chip.output_word(chip.AXES) & 1 == asks


# How it ends


@every_chip
def test_a_sudden_stop_ends_it(cls):
    chip = begin_drive(cls, "26h", "d")
    chip.advance(SECOND)
    command(chip, SUDDEN)
    assert not driving(chip)
    assert chip.advance(SECOND) == 0


CAUSES = {
    "EMG": lambda chip: chip.set_input_word(chip.AXES, 1),
    "ALARM": lambda chip: setattr(chip.axes[0].pins, "alarm", True),
    "a reset": lambda chip: chip.write(0, 0x8000),
    "a limit, sudden": lambda chip: (chip.write(2, 0), limit(chip, 1)),
}


@pytest.mark.parametrize("cause", CAUSES)
@every_request
def test_emg_alarm_a_reset_and_a_sudden_limit_end_it(name, cause):
    request = REQUESTS[name]
    chip = COURSE.begin(MCX304(), "d", wr1=request.wr1, wr2=request.wr2 | ALM_E)
    request.act(chip, 1)
    chip.advance(SECOND)
    assert driving(chip)
    CAUSES[cause](chip)
    assert not driving(chip)
    assert chip.advance(SECOND) == 0


NOTHING = {
    "26h again": lambda chip: command(chip, STOP),
    "STOP0 to STOP2, enabled": lambda chip: [stop_input(k)(chip, 1) for k in range(3)],
    "a decelerating limit": lambda chip: limit(chip, 1),
    "the sudden limit of the other direction": lambda chip: (chip.write(2, 0), limit(chip, -1)),
    "ALARM, not enabled": lambda chip: setattr(chip.axes[0].pins, "alarm", True),
    "a software limit": lambda chip: soft_limit_lp(chip, 1),
    "P": lambda chip: load_304(chip, P=COURSE.P + 1000),
    "P that is passed": lambda chip: load_304(chip, P=10),
    "V": lambda chip: load_304(chip, V=50),
    "LP": lambda chip: load_304(chip, LP=0),
    "a drive command": lambda chip: command(chip, 0x20),
    "a continuous drive command": lambda chip: command(chip, CONTINUOUS),
    "hold and release": lambda chip: (command(chip, 0x24), command(chip, 0x25)),
    "linear ramps": lambda chip: set_wr3(chip, 0, X, NOP_304),
    "27h to another axis": lambda chip: command(chip, SUDDEN, Y),
}


@pytest.mark.parametrize("name", NOTHING)
def test_nothing_else_ends_it_or_changes_its_speed(name):
    chip = COURSE.begin(MCX304(), "d", wr1=0x2A, wr2=LMTMD | SLMT_BOTH)
    command(chip, STOP)
    NOTHING[name](chip)
    command(chip, NOP_304)
    assert chip.advance(10 * SECOND) == pytest.approx(10 * COURSE.speed_in_d(COURSE.at("d")), abs=1)
    assert runs_away(chip)


def test_releasing_the_level_does_not_end_it():
    for name, pin in {"limit": "lmt_plus", "STOP1": "stop1"}.items():
        chip = begin_drive(MCX304, name, "d")
        chip.read(0)
        setattr(chip.axes[0].pins, pin, False)
        assert runs_away(chip)


def test_after_a_sudden_stop_the_chip_drives_as_ever():
    chip = begin_drive(MCX304, "26h", "d")
    command(chip, SUDDEN)
    load_304(chip, LP=0)
    command(chip, 0x20)
    assert ends(chip) == COURSE.P


# Where it never happens


@every_chip
@every_request
@pytest.mark.parametrize("area", ["c", "c last", "d first", "d", "d last"])
def test_a_chip_without_the_erratum_ends_on_its_pulse(cls, name, area):
    assert ends(begin_drive(cls, name, area, errata=False)) <= COURSE.P
    if area[0] == "d" or name == "26h":
        assert ends(begin_drive(cls, name, area, errata=False)) >= COURSE.P - 50


@every_request
@pytest.mark.parametrize("area", ["c", "c last", "d first", "d", "d last"])
def test_an_mcx314as_which_the_notice_says_has_no_failure_ends_on_its_pulse(name, area):
    """What makes an MCX304 run away, in each case of the notice."""
    assert ends(begin_drive(MCX314AS, name, area)) == ends(begin_drive(MCX304, name, area, errata=False)) <= COURSE.P
    assert area[0] != "d" or runs_away(begin_drive(MCX304, name, area))


OTHERS = {
    "linear": (0x20, 0, COURSE),
    "linear, D": (0x20, DSNDE, COURSE),
    "constant": (0x20, SACC, COURSE._replace(V=COURSE.SV, P=2000)),
    "continuous": (CONTINUOUS, SACC, COURSE),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_drives_never_run_away(name):
    drive, wr3, waveforms = OTHERS[name]
    chip = MCX304()
    waveforms.load(chip, wr3=wr3)
    if name.startswith("linear"):
        load_304(chip, A=14, D=14)
    command(chip, drive)
    if drive == CONTINUOUS:  # and it slows down to SV
        go(chip, 3 * SECOND)
        load_304(chip, V=COURSE.SV)
    assert_never_runs_away(chip, STOP)


@pytest.mark.parametrize("make", [MCX514, MCX501])
def test_an_mcx514_or_mcx501_never_runs_away(make):
    chip = make()
    load(chip, SV=1000, DV=10_000, AC=10_000_000, DC=10_000_000, JK=int(COURSE.jerk), TP=COURSE.P, AO=0)
    set_wr3(chip, SACC)
    command(chip, 0x50)
    assert_never_runs_away(chip, 0x56)


def assert_never_runs_away(begin_drive, stop):
    """A decelerating stop at 100 instants, ever closer to the end of a drive; or of 6 seconds, where it has none."""
    last = int(copy.deepcopy(begin_drive).trace(6 * SECOND)["clock"][-1])
    for k in range(100):
        chip = copy.deepcopy(begin_drive)
        go(chip, max(last - int(1.2**k), chip.clock))
        assert driving(chip)
        command(chip, stop)
        go(chip, 12 * SECOND)
        assert not driving(chip), f"26h or 56h {1.2**k} clocks before the end"
        assert chip.advance(SECOND) == 0


# The option


def test_a_chip_has_the_erratum_by_default():
    for cls in CHIPS:
        assert cls().errata is True
        assert cls(errata=False).errata is False
    assert runs_away(begin_drive(MCX304, "26h", "d"))


@pytest.mark.parametrize("replica", [copy.copy, copy.deepcopy, lambda chip: pickle.loads(pickle.dumps(chip))])
@pytest.mark.parametrize("errata", [True, False])
def test_copies_and_pickles_keep_it(replica, errata):
    chip = replica(COURSE.begin(MCX304(errata=errata), "d"))
    assert chip.errata is errata
    command(chip, STOP)
    assert runs_away(chip) is errata


def test_snapshots_within_area_d_and_after_it_go_on_as_they_were():
    chip = COURSE.begin(MCX304(), "d")
    in_area = chip.snapshot()
    command(chip, STOP)
    away = chip.snapshot()
    pulses = chip.advance(SECOND)
    chip.restore(away)
    assert chip.advance(SECOND) == pulses
    chip.restore(in_area)
    assert ends(chip) == COURSE.P


@every_chip
def test_a_snapshot_of_one_kind_is_refused_by_the_other(cls):
    sold, mended = cls(), cls(errata=False)
    for chip, other in ((sold, mended), (mended, sold)):
        before = other.snapshot()
        with pytest.raises(ArgumentError, match="cannot be restored"):
            other.restore(chip.snapshot())
        assert other.snapshot() == before


# The setting value of parameters


@pytest.mark.parametrize("k", [1, 10, 100])
def test_k_decides_how_many_bus_cycles_can_hit_area_d(k):
    """26h once in each microsecond of the end of a drive: 2 K of them do."""
    waveforms = Course(K=k, P=2000)
    chip = waveforms.begin(MCX304(), "c")
    begin, end = chip.snapshot(), waveforms.at("end")
    hit = 0
    for cycle in range(2 * k + 20):
        chip.restore(begin)
        go(chip, end + 5 * US - cycle * US)
        command(chip, STOP)
        hit += driving(chip) and phases(chip) == 0
    assert hit == pytest.approx(2 * k, abs=1)


def test_outside_area_d_no_stop_command_ever_runs_away_and_inside_every_one_does():
    hits = tried = 0
    for rng in examples(1.0):
        drawn = random_drive(rng)
        drive, m = drawn["drive"], drawn["m"]
        area = area_d(drive, m)
        inside = area is not None and rng.random() < 0.5
        clock = rng.randrange(*area) if inside else int(drive.end_clock * rng.random())
        inside = area is not None and area[0] <= clock < area[1]
        if area is not None and abs(clock - area[0]) <= 1:
            continue  # within rounding of its beginning
        chip = MCX304()
        load_304(chip, **drawn["told"])
        set_wr3(chip, SACC | (DSNDE if drawn["asymmetric"] else 0), X, NOP_304)
        command(chip, 0x20)
        go(chip, clock)
        command(chip, STOP)
        go(chip, clock + int(drive.end_clock) + SECOND)
        note = f"{drawn['told']} at {clock} of {drive.end_clock}, d {area} PULSESTAGE_SEED={SEED}"
        assert driving(chip) == inside, note
        assert not inside or phases(chip) == 0, note
        hits, tried = hits + inside, tried + 1
    assert hits > tried // 10


def random_drive(rng):
    sv, v = sorted((log_uniform(rng, 1, 8000), log_uniform(rng, 2, 8000)))
    expected = {
        "R": rng.choice([8_000_000, 800_000, rng.randint(16_000, 8_000_000)]),
        "K": log_uniform(rng, 1, 65_535),
        "A": log_uniform(rng, 1, 8000),
        "D": log_uniform(rng, 1, 8000),
        "SV": sv,
        "V": v,
        "P": log_uniform(rng, 1, 20_000),
        "AO": rng.choice([0, 0, 8, 60]),
    }
    m, asymmetric = 8_000_000 / expected["R"], rng.random() < 0.4
    jerk = 62.5e6 * m / expected["K"]
    speeds = {"SV": sv * m, "DV": v * m, "AC": 125 * expected["A"] * m, "DC": 125 * expected["D"] * m}
    drive = Drive(**speeds, JK=jerk, DJ=jerk, P=expected["P"], AO=expected["AO"], s_curve=True, asymmetric=asymmetric)
    return {"told": expected, "drive": drive, "m": m, "asymmetric": asymmetric}


def area_d(drive, m):
    """Return the first clock of area d and the first after it; None if there is none."""
    last = [piece for piece in drive.pieces if piece.a < 0 and piece.jerk > 0]
    if not last:
        return None
    piece = last[-1]
    dull = min(125 * m, -piece.a)
    first = piece.t + piece.length - dull / piece.jerk
    end = min(piece.t + piece.length, drive.end)
    span = ceil_clock(first * SECOND), ceil_clock(end * SECOND)
    return span if span[0] < span[1] else None
