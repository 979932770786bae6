"""The TMC5160's encoder: a shaft that is told counts as its edges at the pins do, and on a stage it is the carriage's."""

import copy
import math
import pickle

import numpy as np
import pytest

from stage import ArgumentError, Drive, Stage, StageError, faults, firmware
from stage.board.devices import Encoder
from stage.chips import PCL240K, chip_class

PER_METRE = 100_000
N_EVENT, DEVIATION = 1, 2
POL_N, IGNORE_AB, CLR_CONT, CLR_ONCE, CLR_ENC_X, LATCH_X, DECIMAL = 4, 8, 16, 32, 256, 512, 1024


@pytest.fixture(scope="module")
def made():
    drive = Drive("17HS4401", detent=0.0, mode="sine")
    return Stage("xy", chips={"x": "tmc5160"}, drives=drive, encoders={"x": PER_METRE}, visuals=False)


@pytest.fixture
def x(made):
    made.reset()
    return made.axes["x"]


@pytest.fixture
def chip():
    return chip_class("tmc5160")()


def put(chip, **registers):
    for name, value in registers.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)


def steps_an_edge(axis):
    """ENC_CONST, by which X_ENC counts as XACTUAL does."""
    return round(65_536 / (PER_METRE * axis.meters_per_pulse))


def show(chip, edge):
    """Its pins as at an edge: A leads B."""
    chip.pins.enca, chip.pins.encb = bool(edge + 1 & 2), bool(edge & 2)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 400))])
def test_a_shaft_counts_as_its_edges_at_the_pins_do(chip, seed):
    """Every bit of the state is the same, but for what tells of the shaft; with N events, deviation and the emergency stop."""
    rng = np.random.default_rng(seed)
    by_hand = chip.make_replica()
    count, seen, rate, edge = 0.0, 0, 0.0, 0
    chip.set_shaft(0)
    for c in (chip, by_hand):
        put(
            c,
            CHOPCONF=0x100100C3,
            VMAX=400_000,
            AMAX=50_000,
            DMAX=50_000,
            D1=50_000,
            VSTOP=1000,
            GCONF=0x8000 * (seed % 3 == 0),
        )
        put(c, ENC_DEVIATION=(0, 40)[seed & 1], SW_MODE=0x220)
    for _ in range(30):
        what = int(rng.integers(8))
        number = int(rng.integers(1 << 11)) & (0x7FF if rng.integers(2) else 0x7CF)
        target, factor = (
            int(rng.integers(-60, 60)),
            (0x10000, 0x33_0000 | 2000, 0xFFE6_0000 | 4000)[int(rng.integers(3))],
        )
        level, name = bool(rng.integers(2)), ("encn", "refl")[int(rng.integers(2))]
        for c in (chip, by_hand):
            if what < 2:
                put(c, ENCMODE=number)
            elif what < 4:
                setattr(c.pins, name, level)
            elif what < 6:
                put(c, XTARGET=target, ENC_STATUS=3)
            elif what < 7:
                put(c, ENC_CONST=factor, X_ENC=target)
        count += rate * (chip.clock - seen)
        seen, rate = chip.clock, float(rng.choice((0.0, 0.004, -0.002, 0.03)))
        chip.set_shaft(count, rate)
        for _ in range(int(rng.integers(1, 700))):
            now = math.floor(count + rate * (by_hand.clock + 1 - seen) + 0.5)
            if now != edge:
                edge = now
                show(by_hand, edge)
            by_hand.advance(1)
        chip.advance((by_hand.clock - chip.clock) // 2)
        chip.advance(by_hand.clock - chip.clock)
        for field in set(chip.state.dtype.names) - {"fed", "edge", "seen", "shaft", "shaft_rate", "fresh"}:
            assert np.array_equal(chip.state[field], by_hand.state[field]), (seed, field)
    assert edge


@pytest.mark.parametrize(
    ("edges_per_turn", "constant", "mode"), [(4096, 12.5, 0), (1000, 0x33_0000 | 2000, DECIMAL), (16_384, 3.125, 0)]
)
def test_the_factors_of_the_page_make_a_turn_of_the_motor(chip, edges_per_turn, constant, mode):
    from pulsestage_trinamic.tmc5160.driver import encoder_registers

    wanted = {"ENC_CONST": constant if mode else round(constant * 65_536), "ENCMODE": mode}
    assert encoder_registers(edges_per_turn) == wanted
    put(chip, **wanted)
    chip.set_shaft(0)
    for turns in (1, -3):
        chip.set_shaft(turns * edges_per_turn)
        chip.advance(1)
        assert chip.values()["X_ENC"] == turns * 51_200


def test_a_course_has_the_edges_of_a_shaft_that_turns_while_the_motor_stands(chip):
    chip.set_shaft(0, 1e-3)
    journal = chip.journal()
    chip.advance(20_000)
    journal.close()
    edges = journal.course(every_pulse=True).edges
    pins = edges["inputs"] & (chip.INPUTS["enca"] | chip.INPUTS["encb"])
    assert np.count_nonzero(np.diff(pins)) == 20


def test_a_negative_factor_counts_the_other_way_with_its_fraction(chip):
    """-25.6 is 0xFFE6, 4000"""
    from pulsestage_trinamic.tmc5160.driver import encoder_registers

    assert encoder_registers(-2000) == {"ENC_CONST": 0xFFE6_0000 | 4000, "ENCMODE": DECIMAL}
    put(chip, **encoder_registers(-2000))
    chip.set_shaft(0)
    chip.set_shaft(1)
    chip.advance(1)
    assert chip.values()["X_ENC"] == -26, "-25.6, floor"
    chip.set_shaft(5)
    chip.advance(1)
    assert chip.values()["X_ENC"] == -128


@pytest.mark.parametrize("edges", [0, 0.5, 1.99, True, math.nan, 3_400_000_000, 10**10, "many"])
def test_an_encoder_that_no_factor_suits_is_refused(edges):
    from pulsestage_trinamic.tmc5160.driver import encoder_registers

    with pytest.raises(ArgumentError, match="edges a turn"):
        encoder_registers(edges)
    assert encoder_registers(2)["ENC_CONST"] == 25_600 << 16
    assert encoder_registers(3_300_000_000)["ENC_CONST"] == 1


def test_on_a_stage_it_counts_where_the_carriage_is(x):
    put(x.chip, ENC_CONST=steps_an_edge(x))
    firmware.move(x, 5e-3)
    values = x.chip.values()
    assert values["XACTUAL"] == 25_600
    assert values["X_ENC"] == pytest.approx(x.position / x.meters_per_pulse, abs=1 / (PER_METRE * x.meters_per_pulse))
    assert values["X_ENC"] == pytest.approx(25_600, abs=120)


@pytest.mark.parametrize("way", [1, -1])
def test_a_deviation_is_told_beyond_its_limit_and_not_at_it(chip, way):
    put(chip, ENC_DEVIATION=20, X_ENC=20 * way)
    chip.advance(100)
    assert not chip.values()["ENC_STATUS"] & DEVIATION
    put(chip, X_ENC=21 * way)
    chip.advance(100)
    assert chip.values()["ENC_STATUS"] & DEVIATION


def test_a_jammed_motor_deviates_and_says_so_at_diag0(x):
    put(x.chip, ENC_CONST=steps_an_edge(x), ENC_DEVIATION=600)
    firmware.move(x, 2e-3)
    put(x.chip, RAMP_STAT=0x80)
    assert not x.chip.values()["ENC_STATUS"]
    assert not x.chip.pins.diag0
    with faults.jam(x):
        firmware.move(x, 5e-3)
        put(x.chip, RAMP_STAT=0x80)
    values = x.chip.values()
    assert values["ENC_STATUS"] & DEVIATION
    assert x.chip.pins.diag0
    assert values["XACTUAL"] - values["X_ENC"] == pytest.approx(256 * x.lost_steps, abs=300)


def test_the_index_pulse_makes_the_n_event(x):
    """ENC_LATCH and XLATCH have where it was; clr_once acts but once."""
    turn = 51_200
    put(x.chip, ENC_CONST=steps_an_edge(x))
    firmware.move(x, 3e-3)
    put(x.chip, ENCMODE=POL_N | IGNORE_AB | CLR_ONCE | LATCH_X | 1 << 6)
    begin = x.chip.values()["XACTUAL"]
    firmware.move(x, pulses=turn)
    values = x.chip.values()
    assert values["ENC_STATUS"] == N_EVENT
    assert begin < values["XLATCH"] <= begin + turn
    assert values["ENC_LATCH"] == pytest.approx(values["XLATCH"], abs=300)
    assert values["ENCMODE"] == POL_N | IGNORE_AB | LATCH_X | 1 << 6
    first = values["XLATCH"]
    put(x.chip, ENCMODE=POL_N | IGNORE_AB | CLR_CONT | LATCH_X | 1 << 6, ENC_STATUS=N_EVENT)
    firmware.move(x, pulses=turn)
    assert x.chip.values()["XLATCH"] - first == pytest.approx(turn, abs=100), "one a turn"


def test_a_switch_latches_the_encoder_as_well(x):
    x.stage.place(x=-0.14)
    put(x.chip, ENC_CONST=steps_an_edge(x))
    firmware.home(x)
    put(x.chip, SW_MODE=0x220)
    firmware.move(x, 2e-3)
    put(x.chip, SW_MODE=0x220, X_ENC=x.chip.values()["XACTUAL"])
    x.chip.write(0x20, 2)
    x.stage.run_until(lambda: x.chip.pins.refl, timeout=5.0, poll=1e-4)
    x.stage.run(1e-3)
    values = x.chip.values()
    assert values["ENC_LATCH"] == pytest.approx(values["XLATCH"], abs=200)


def test_copies_snapshots_and_journals_go_on_to_the_same_bits(x):
    stage = x.stage
    put(x.chip, CHOPCONF=0x100100C3, IHOLD_IRUN=31 << 8, VMAX=2_000_000, AMAX=65_535, RAMPMODE=1)
    put(x.chip, ENC_DEVIATION=5000, ENCMODE=POL_N | CLR_CONT)
    stage.run(0.0123456)
    others = [copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))]
    before, journal = stage.snapshot(), x.chip.journal()
    stage.run(0.02)
    after = stage.snapshot()
    journal.close()
    edges = journal.course(every_pulse=True).edges
    a = (edges["inputs"] & x.chip.INPUTS["enca"] != 0).astype(int)
    lone = x.chip.make_replica(journal.start.tobytes())
    for e in journal.entries:
        lone.CORE.run(lone._rows, e.clock)
        e.apply(lone.CORE, lone._rows)
    lone.CORE.run(lone._rows, journal.until)
    assert lone.state.tobytes() == x.chip.state.tobytes()
    counted = x.chip.values()["X_ENC"] - int(journal.start["enc"])
    assert counted > 25
    assert abs(np.diff(a)).sum() == pytest.approx(counted / 2, abs=2)
    stage.restore(before)
    for one in (stage, *others):
        one.run(0.02)
        assert one.snapshot().state.tobytes() == after.state.tobytes()


def test_hands_are_kept_from_an_encoders_pins_and_other_chips_from_shafts(chip):
    chip.pins.enca = True
    chip.set_shaft(7.25)
    chip.advance(3)
    assert chip.values()["X_ENC"] == 0, "where it is at first counts nothing"
    chip.pins.encn = True
    with pytest.raises(StageError, match="cannot be driven by hand"):
        chip.pins.encb = not chip.pins.encb
    with pytest.raises(ArgumentError, match="finite"):
        chip.set_shaft(math.nan)
    with pytest.raises(ArgumentError, match="looks at no encoder"):
        PCL240K().set_shaft(1)


def test_an_encoder_may_be_on_the_motor():
    stage = Stage("xy", chips="tmc5160", encoders=[Encoder("y", per_turn=4000)], visuals=False)
    y = stage.axes["y"]
    stage.place(y=0.005)
    stage.run(1e-4)
    assert y.chip.values()["X_ENC"] == math.floor(0.005 * 4000 * y.gear / (2 * math.pi) + 0.5)
