"""Drives of MCX304, MCX302 and MCX312 against the exact reference, by the formulas of their page.

multiple m = 8,000,000 / R; SV m and V m pps; 125 A m and 125 D m pps/s; 62.5e6 m / K pps/s^2.
"""

from fractions import Fraction
from typing import NamedTuple

import pytest
from reference.nova_profile import SECOND, Drive, mp
from support.covers import covers
from support.nova_bench import (
    AVTRI_304,
    NOP_304,
    SEED,
    Move,
    U,
    X,
    Y,
    assert_pulses,
    command,
    draw_clock,
    driving,
    examples,
    get_signed,
    load_304,
    log_uniform,
    played,
    put,
    set_wr3,
)

from stage.chips import MCX302, MCX304, MCX312

MS = SECOND // 1000
PHASES = {"accelerating": 0x04, "constant": 0x08, "decelerating": 0x10}  # ASND, CNST, DSND of RR1
every_chip = pytest.mark.parametrize("cls", [MCX302, MCX304, MCX312], ids=lambda cls: cls.__name__)


class Registers(NamedTuple):
    """Register values that the bus writes; P is None for a continuous drive."""

    R: int = 8_000_000
    K: int = 1010
    A: int = 100
    D: int = 100
    SV: int = 1000
    V: int = 4000
    P: int | None = 3000
    DP: int | None = None
    AO: int = 0
    s_curve: bool = False
    asymmetric: bool = False
    triangle_prevention: bool = True

    @property
    def multiple(self) -> Fraction:
        return Fraction(8_000_000, self.R)

    @property
    def move(self) -> Move:
        m = self.multiple
        jerk = Fraction(62_500_000, self.K) * m
        speeds = {"SV": self.SV * m, "DV": self.V * m, "AC": 125 * self.A * m, "DC": 125 * self.D * m}
        return Move(**speeds, JK=jerk, DJ=jerk, **{name: getattr(self, name) for name in Move._fields[6:]})

    def reference(self, *interventions) -> Drive:
        """Interventions with V in the chip's own units."""
        m = self.multiple
        expected = [
            (clock, "DV", value[0] * m) if what == "V" else (clock, what, *value)
            for clock, what, *value in interventions
        ]
        return self.move.reference(*expected)


def start(chip, registers, axes=X, minus=False):
    """Start a drive, and return the clock of the start."""
    load_304(chip, axes, **{name: getattr(registers, name) for name in ("R", "K", "A", "D", "SV", "V", "AO")})
    if isinstance(chip, MCX312):
        put(chip, 0x0E, registers.K, axes)  # L, which the others do not have
    set_wr3(chip, registers.move.wr3(AVTRI_304), axes, NOP_304)
    if registers.DP is not None:
        load_304(chip, axes, DP=registers.DP)
    if registers.P is not None:
        load_304(chip, axes, P=registers.P)
    command(chip, (0x22 if registers.P is None else 0x20) + minus, axes)
    return chip.clock


def intervene(chip, what, *value):
    if what == "V":
        load_304(chip, V=value[0])
    elif what == "P":
        load_304(chip, P=value[0])
    else:
        command(chip, {"slow": 0x26, "stop": 0x27}[what])


def assert_made(chip, registers, interventions=(), minus=False, until=None):
    drive = registers.reference(*interventions)
    note = f"{registers} {interventions} PULSESTAGE_SEED={SEED}"
    until = drive.end_clock if until is None else until
    start(chip, registers, minus=minus)
    pulses = played(chip, interventions, until, intervene)
    assert_pulses([clock for clock, _ in pulses], drive, note, until)
    assert {direction for _, direction in pulses} <= {-1 if minus else 1}, note
    if drive.end_clock is not None and drive.end_clock <= until:
        assert not driving(chip), f"it goes on\n{note}"
        assert chip.advance(SECOND) == 0, note


def random_registers(rng, fixed=True):
    """Draw registers for ramps of milliseconds to some seconds, and up to about 2000 pulses."""
    sv, v = sorted((log_uniform(rng, 1, 8000), log_uniform(rng, 2, 8000)))
    pulses = log_uniform(rng, 1, 2000)
    return Registers(
        R=rng.choice([8_000_000, 800_000, 16_000, rng.randint(16_000, 8_000_000)]),
        K=log_uniform(rng, 1, 65_535),
        A=log_uniform(rng, 1, 8000),
        D=log_uniform(rng, 1, 8000),
        SV=sv,
        V=v,
        P=pulses if fixed else None,
        DP=rng.randint(0, pulses) if fixed and rng.random() < 0.15 else None,
        AO=rng.choice([0, 0, 8, rng.randint(-20, 60)]),
        s_curve=rng.random() < 0.5,
        asymmetric=rng.random() < 0.4,
        triangle_prevention=rng.random() < 0.5,
    )


PAGE = Registers(R=800_000, K=1010, A=100, SV=100, V=4000, P=25_000)
NAMED = {
    "constant": Registers(SV=1000, V=1000, P=300),
    "the page's, linear": PAGE._replace(P=12_000),
    "the page's, S-curve": PAGE._replace(s_curve=True),
    "short": Registers(P=100),
    "short, prevention off": Registers(P=100, triangle_prevention=False),
    "asymmetric": Registers(D=37, asymmetric=True),
    "D without DSNDE": Registers(D=37),
    "S-curve": Registers(s_curve=True),
    "short S-curve": Registers(s_curve=True, P=200),
    "manual point": Registers(DP=2500),
    "AO": Registers(AO=40),
    "a fractional multiple": Registers(R=700_001, P=4000),
}
named = pytest.mark.parametrize("registers", NAMED.values(), ids=NAMED)


def test_the_page_s_worked_example():
    move = PAGE.move
    assert (move.SV, move.DV, move.AC) == (1000, 40_000, 125_000)
    assert int(move.JK) == 618_811
    assert round(move.JK) == 618_812


@every_chip
@named
@pytest.mark.parametrize("minus", [False, True], ids=["20h", "21h"])
def test_named_drives_are_the_references(cls, registers, minus):
    chip = cls()
    assert_made(chip, registers, minus=minus)
    assert get_signed(chip, 0x10) == (-registers.P if minus else registers.P)


@covers("MCX304 MCX302 MCX312", "R", "K", "A", "D", "SV", "V", "P", "AO")
@every_chip
def test_round_speeds_put_each_pulse_on_its_own_round_clock(cls):
    for r, v, period in ((8_000_000, 1000, 16_000), (800_000, 100, 16_000), (16_000, 8000, 4), (16_000, 1, 32_000)):
        chip = cls()
        began = start(chip, Registers(R=r, SV=v, V=v, P=40))
        assert (chip.trace(40 * period)["clock"] - began).tolist() == [period * k for k in range(1, 41)]
        assert not driving(chip)


@pytest.mark.parametrize("minus", [False, True], ids=["22h", "23h"])
def test_continuous_drives_take_their_direction_from_the_command(minus):
    assert_made(MCX304(), Registers(P=None), [(900 * MS, "slow")], minus=minus)


@every_chip
def test_any_fixed_pulse_drive_is_the_references(cls):
    for rng in examples(0.06):
        assert_made(cls(), random_registers(rng), minus=rng.random() < 0.5)


@covers("MCX304 MCX302 MCX312", "DP")
@every_chip
def test_a_deceleration_begins_at_the_manual_point(cls):
    for point in (10, 1500):
        assert_made(cls(), Registers(P=3000, DP=point))


def test_the_erratum_does_not_touch_a_drive_left_alone():
    for rng in examples(0.03):
        registers = random_registers(rng)._replace(s_curve=True)
        assert_made(MCX304(errata=False), registers)
        assert_made(MCX304(errata=True), registers)


def test_the_offset_is_8_after_reset():
    chip, registers = MCX304(), Registers(P=1000)
    start(chip, registers)
    chip.write(0, 0x8000)
    load_304(chip, **{name: getattr(registers, name) for name in ("R", "K", "A", "D", "SV", "V", "P")})
    command(chip, 0x20)
    drive = registers._replace(AO=8, triangle_prevention=False).reference()  # WR3 is 0
    assert_pulses([c for c, _ in played(chip, (), drive.end_clock)], drive, "AO not written")


@covers("MCX312", "L", "D")
def test_l_is_the_deceleration_jerk_of_an_mcx312():
    registers = Registers(K=500, D=60, s_curve=True, asymmetric=True, P=4000)
    chip = MCX312()
    start(chip, registers)
    command(chip, 0x27)
    put(chip, 0x0E, 2000)
    command(chip, 0x20)
    drive = registers.move._replace(DJ=Fraction(62_500_000, 2000)).reference()
    assert_pulses([c for c, _ in played(chip, (), drive.end_clock)], drive, "L = 2000")


def test_four_axes_drive_side_by_side():
    chip, other = MCX304(), Registers(V=2500, s_curve=True)
    start(chip, Registers(), X | U)
    start(chip, other, Y, minus=True)
    trace = chip.trace(max(Registers().reference().end_clock, other.reference().end_clock))
    for axis, registers in ((0, Registers()), (1, other), (3, Registers())):
        pulses = trace[trace["axis"] == axis]
        assert_pulses(pulses["clock"].tolist(), registers.reference(), f"axis {axis}")
        assert set(pulses["direction"].tolist()) == {-1 if axis == 1 else 1}


# Interventions; errata=False, so that no stop runs for ever


def test_a_new_drive_speed_acts_at_once_in_any_phase():
    for rng in examples(0.08):
        registers = random_registers(rng)
        clock = draw_clock(rng, registers.reference())
        v = rng.choice([log_uniform(rng, registers.SV, 8000), rng.randint(registers.SV, 8000)])
        assert_made(MCX304(errata=False), registers, [(clock, "V", v)])


def test_a_decelerating_stop_brakes_to_sv_from_any_phase_except_during_s_curve_braking():
    for rng in examples(0.06):
        registers = random_registers(rng, fixed=rng.random() < 0.7)
        unmodified = registers.reference()
        clock = draw_clock(rng, unmodified)
        chip, stop = MCX304(errata=False), [(clock, "slow")]
        if registers.s_curve and registers.P is not None and unmodified.phase(clock) == "decelerating":
            note = f"{registers} {stop} PULSESTAGE_SEED={SEED}"
            start(chip, registers)
            assert_pulses([c for c, _ in played(chip, stop, unmodified.end_clock, intervene)], unmodified, note)
        else:
            assert_made(chip, registers, stop)


def test_a_sudden_stop_ends_the_drive_at_its_clock():
    for rng in examples(0.04):
        registers = random_registers(rng)
        clock = draw_clock(rng, registers.reference())
        assert_made(MCX304(errata=False), registers, [(clock, "stop")])


def test_speed_acceleration_and_phase_read_as_the_profile_says():
    for rng in examples(0.08):
        registers = random_registers(rng)
        chip, drive = MCX304(errata=False), registers.reference()
        samples = sorted(draw_clock(rng, drive) for _ in range(8))
        began = start(chip, registers)
        for clock in samples:
            chip.advance(began + clock - chip.clock)
            note = f"{registers} at {clock}: {drive.phase(clock)} PULSESTAGE_SEED={SEED}"
            assert_shows(chip, registers, drive, clock, note)


def assert_shows(chip, registers, drive, clock, note):
    if clock >= drive.end_clock:
        return
    m = registers.multiple.numerator / mp.mpf(registers.multiple.denominator)
    command(chip, 0x12)
    assert abs(chip.read(6) - drive.speed(clock) / m) <= 1, note
    if min((abs(clock - boundary) for boundary in drive.boundaries()), default=mp.inf) < 2:
        return  # at a boundary either side may be shown
    command(chip, 0x13)
    assert abs(chip.read(6) - abs(drive.acceleration(clock)) / (125 * m)) <= 1, note
    assert chip.read(1) & sum(PHASES.values()) == PHASES[drive.phase(clock)], note
