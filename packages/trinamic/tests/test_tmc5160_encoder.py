"""Tests of the TMC5160's encoder interface, driven by a shaft position, by edges at its pins and by a carriage."""

import copy
import math
import pickle

import numpy as np
import pytest

from stage import ArgumentError, Drive, Stage, StageError, faults, firmware
from stage.board.devices import Encoder
from stage.chips import PCL240K, chip_class

EDGES_PER_METER = 100_000
N_EVENT, DEVIATION = 1, 2
POL_N, IGNORE_AB, CLR_CONT, CLR_ONCE, CLR_ENC_X, LATCH_X, DECIMAL = 4, 8, 16, 32, 256, 512, 1024


@pytest.fixture(scope="module")
def stage_():
    drive = Drive("17HS4401", detent=0.0, mode="sine")
    return Stage("xy", chips={"x": "tmc5160"}, drives=drive, encoders={"x": EDGES_PER_METER}, visuals=False)


@pytest.fixture
def x(stage_):
    stage_.reset()
    return stage_.axes["x"]


@pytest.fixture
def chip():
    return chip_class("tmc5160")()


def write_registers(chip, **registers):
    for name, value in registers.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)


def compute_enc_const(axis):
    """Return the ENC_CONST with which X_ENC counts in the unit of XACTUAL."""
    return round(65_536 / (EDGES_PER_METER * axis.meters_per_pulse))


def set_encoder_pins(chip, edge):
    """Set the pins A and B to their levels after edge number `edge`; A leads B."""
    chip.pins.enca, chip.pins.encb = bool(edge + 1 & 2), bool(edge & 2)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 400))])
def test_a_shaft_counts_like_the_same_edges_at_the_encoder_pins(chip, seed):
    """Compare every state field but those of the shaft, with N events, deviation and the emergency stop."""
    rng = np.random.default_rng(seed)
    pin_driven = chip.make_replica()
    count, shaft_clock, rate, edge = 0.0, 0, 0.0, 0
    chip.set_shaft(0)
    for c in (chip, pin_driven):
        write_registers(
            c,
            CHOPCONF=0x100100C3,
            VMAX=400_000,
            AMAX=50_000,
            DMAX=50_000,
            D1=50_000,
            VSTOP=1000,
            GCONF=0x8000 * (seed % 3 == 0),
        )
        write_registers(c, ENC_DEVIATION=(0, 40)[seed & 1], SW_MODE=0x220)
    for _ in range(30):
        action = int(rng.integers(8))
        number = int(rng.integers(1 << 11)) & (0x7FF if rng.integers(2) else 0x7CF)
        target, factor = (
            int(rng.integers(-60, 60)),
            (0x10000, 0x33_0000 | 2000, 0xFFE6_0000 | 4000)[int(rng.integers(3))],
        )
        level, name = bool(rng.integers(2)), ("encn", "refl")[int(rng.integers(2))]
        for c in (chip, pin_driven):
            if action < 2:
                write_registers(c, ENCMODE=number)
            elif action < 4:
                setattr(c.pins, name, level)
            elif action < 6:
                write_registers(c, XTARGET=target, ENC_STATUS=3)
            elif action < 7:
                write_registers(c, ENC_CONST=factor, X_ENC=target)
        count += rate * (chip.clock - shaft_clock)
        shaft_clock, rate = chip.clock, float(rng.choice((0.0, 0.004, -0.002, 0.03)))
        chip.set_shaft(count, rate)
        for _ in range(int(rng.integers(1, 700))):
            now = math.floor(count + rate * (pin_driven.clock + 1 - shaft_clock) + 0.5)
            if now != edge:
                edge = now
                set_encoder_pins(pin_driven, edge)
            pin_driven.advance(1)
        chip.advance((pin_driven.clock - chip.clock) // 2)
        chip.advance(pin_driven.clock - chip.clock)
        for field in set(chip.state.dtype.names) - {"fed", "edge", "seen", "shaft", "shaft_rate", "fresh"}:
            assert np.array_equal(chip.state[field], pin_driven.state[field]), (seed, field)
    assert edge


@pytest.mark.parametrize(
    ("edges_per_turn", "constant", "mode"), [(4096, 12.5, 0), (1000, 0x33_0000 | 2000, DECIMAL), (16_384, 3.125, 0)]
)
def test_the_encoder_factors_of_the_data_sheet_count_51200_per_motor_turn(chip, edges_per_turn, constant, mode):
    from pulsestage_trinamic.tmc5160.host_driver.driver import compute_encoder_registers

    wanted = {"ENC_CONST": constant if mode else round(constant * 65_536), "ENCMODE": mode}
    assert compute_encoder_registers(edges_per_turn) == wanted
    write_registers(chip, **wanted)
    chip.set_shaft(0)
    for turns in (1, -3):
        chip.set_shaft(turns * edges_per_turn)
        chip.advance(1)
        assert chip.values()["X_ENC"] == turns * 51_200


def test_a_journal_records_the_encoder_edges_of_a_shaft_that_rotates_without_the_motor(chip):
    chip.set_shaft(0, 1e-3)
    journal = chip.journal()
    chip.advance(20_000)
    journal.close()
    edges = journal.replay_waveforms(every_pulse=True).edges
    pins = edges["inputs"] & (chip.INPUTS["enca"] | chip.INPUTS["encb"])
    assert np.count_nonzero(np.diff(pins)) == 20


def test_a_negative_encoder_factor_counts_down_including_its_fraction(chip):
    """The factor -25.6 is 0xFFE6 with the decimal fraction 4000."""
    from pulsestage_trinamic.tmc5160.host_driver.driver import compute_encoder_registers

    assert compute_encoder_registers(-2000) == {"ENC_CONST": 0xFFE6_0000 | 4000, "ENCMODE": DECIMAL}
    write_registers(chip, **compute_encoder_registers(-2000))
    chip.set_shaft(0)
    chip.set_shaft(1)
    chip.advance(1)
    assert chip.values()["X_ENC"] == -26, "-25.6, floor"
    chip.set_shaft(5)
    chip.advance(1)
    assert chip.values()["X_ENC"] == -128


@pytest.mark.parametrize("edges", [0, 0.5, 1.99, True, math.nan, 3_400_000_000, 10**10, "many"])
def test_an_encoder_resolution_without_a_valid_factor_is_refused(edges):
    from pulsestage_trinamic.tmc5160.host_driver.driver import compute_encoder_registers

    with pytest.raises(ArgumentError, match="edges a turn"):
        compute_encoder_registers(edges)
    assert compute_encoder_registers(2)["ENC_CONST"] == 25_600 << 16
    assert compute_encoder_registers(3_300_000_000)["ENC_CONST"] == 1


def test_x_enc_follows_the_position_of_the_carriage(x):
    write_registers(x.chip, ENC_CONST=compute_enc_const(x))
    firmware.move(x, 5e-3)
    values = x.chip.values()
    assert values["XACTUAL"] == 25_600
    assert values["X_ENC"] == pytest.approx(
        x.position / x.meters_per_pulse, abs=1 / (EDGES_PER_METER * x.meters_per_pulse)
    )
    assert values["X_ENC"] == pytest.approx(25_600, abs=120)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_deviation_flag_is_set_beyond_the_limit_but_not_at_it(chip, direction):
    write_registers(chip, ENC_DEVIATION=20, X_ENC=20 * direction)
    chip.advance(100)
    assert not chip.values()["ENC_STATUS"] & DEVIATION
    write_registers(chip, X_ENC=21 * direction)
    chip.advance(100)
    assert chip.values()["ENC_STATUS"] & DEVIATION


def test_a_jammed_motor_sets_the_deviation_flag_and_diag0(x):
    write_registers(x.chip, ENC_CONST=compute_enc_const(x), ENC_DEVIATION=600)
    firmware.move(x, 2e-3)
    write_registers(x.chip, RAMP_STAT=0x80)
    assert not x.chip.values()["ENC_STATUS"]
    assert not x.chip.pins.diag0
    with faults.jam(x):
        firmware.move(x, 5e-3)
        write_registers(x.chip, RAMP_STAT=0x80)
    values = x.chip.values()
    assert values["ENC_STATUS"] & DEVIATION
    assert x.chip.pins.diag0
    assert values["XACTUAL"] - values["X_ENC"] == pytest.approx(256 * x.lost_steps, abs=300)


def test_the_index_pulse_makes_the_n_event(x):
    """ENC_LATCH and XLATCH hold the position of the pulse; clr_once acts only once."""
    turn = 51_200
    write_registers(x.chip, ENC_CONST=compute_enc_const(x))
    firmware.move(x, 3e-3)
    write_registers(x.chip, ENCMODE=POL_N | IGNORE_AB | CLR_ONCE | LATCH_X | 1 << 6)
    begin = x.chip.values()["XACTUAL"]
    firmware.move(x, pulses=turn)
    values = x.chip.values()
    assert values["ENC_STATUS"] == N_EVENT
    assert begin < values["XLATCH"] <= begin + turn
    assert values["ENC_LATCH"] == pytest.approx(values["XLATCH"], abs=300)
    assert values["ENCMODE"] == POL_N | IGNORE_AB | LATCH_X | 1 << 6
    first = values["XLATCH"]
    write_registers(x.chip, ENCMODE=POL_N | IGNORE_AB | CLR_CONT | LATCH_X | 1 << 6, ENC_STATUS=N_EVENT)
    firmware.move(x, pulses=turn)
    assert x.chip.values()["XLATCH"] - first == pytest.approx(turn, abs=100), "one a turn"


def test_a_switch_latches_the_encoder_as_well(x):
    x.stage.place(x=-0.14)
    write_registers(x.chip, ENC_CONST=compute_enc_const(x))
    firmware.home(x)
    write_registers(x.chip, SW_MODE=0x220)
    firmware.move(x, 2e-3)
    write_registers(x.chip, SW_MODE=0x220, X_ENC=x.chip.values()["XACTUAL"])
    x.chip.write(0x20, 2)
    x.stage.run_until(lambda: x.chip.pins.refl, timeout=5.0, poll=1e-4)
    x.stage.run(1e-3)
    values = x.chip.values()
    assert values["ENC_LATCH"] == pytest.approx(values["XLATCH"], abs=200)


def test_copies_snapshots_and_journals_continue_to_the_same_bits(x):
    stage = x.stage
    write_registers(x.chip, CHOPCONF=0x100100C3, IHOLD_IRUN=31 << 8, VMAX=2_000_000, AMAX=65_535, RAMPMODE=1)
    write_registers(x.chip, ENC_DEVIATION=5000, ENCMODE=POL_N | CLR_CONT)
    stage.run(0.0123456)
    others = [copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))]
    before, journal = stage.snapshot(), x.chip.journal()
    stage.run(0.02)
    after = stage.snapshot()
    journal.close()
    edges = journal.replay_waveforms(every_pulse=True).edges
    a = (edges["inputs"] & x.chip.INPUTS["enca"] != 0).astype(int)
    lone = x.chip.make_replica(journal.start_state.tobytes())
    for e in journal.entries:
        lone.CORE.run(lone._rows, e.clock)
        e.apply(lone.CORE, lone._rows)
    lone.CORE.run(lone._rows, journal.end_clock)
    assert lone.state.tobytes() == x.chip.state.tobytes()
    counted = x.chip.values()["X_ENC"] - int(journal.start_state["enc"])
    assert counted > 25
    assert abs(np.diff(a)).sum() == pytest.approx(counted / 2, abs=2)
    stage.restore(before)
    for one in (stage, *others):
        one.run(0.02)
        assert one.snapshot().state.tobytes() == after.state.tobytes()


def test_encoder_pins_cannot_be_set_directly_and_chips_without_an_encoder_refuse_a_shaft(chip):
    chip.pins.enca = True
    chip.set_shaft(7.25)
    chip.advance(3)
    assert chip.values()["X_ENC"] == 0, "the first position of a shaft counts no edges"
    chip.pins.encn = True
    with pytest.raises(StageError, match="cannot be set directly"):
        chip.pins.encb = not chip.pins.encb
    with pytest.raises(ArgumentError, match="finite"):
        chip.set_shaft(math.nan)
    with pytest.raises(ArgumentError, match="looks at no encoder"):
        PCL240K().set_shaft(1)


def test_an_encoder_can_be_mounted_on_the_motor():
    stage = Stage("xy", chips="tmc5160", encoders=[Encoder("y", per_turn=4000)], visuals=False)
    y = stage.axes["y"]
    stage.place(y=0.005)
    stage.run(1e-4)
    assert y.chip.values()["X_ENC"] == math.floor(0.005 * 4000 * y.gear / (2 * math.pi) + 0.5)
