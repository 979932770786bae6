"""Promises of `Stage(encoders=)`: the counter of the real position of a NOVA chip counts what the carriage really did."""

import copy
import math
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from board.test_native import collect_results
from chips.test_nova_encoder import real_position
from support import nova_programs as nova
from support.compiled_firmware import firmware

from stage import ArgumentError, Fleet, Program, Stage, faults
from stage.board import Board, NativeHost
from stage.board.devices import HCTL2016, Encoder
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K
from stage.chips.journal_entries import SHAFT, bits_to_float
from stage.cli import main
from stage.sim.encoder import choose_encoders, list_counts_per_unit

PER_METRE = 320_000  # as the pulses of the default drive
LIKE = {"chips": MCX514, "visuals": False}


@pytest.fixture(scope="module")
def encoder_stage():
    return Stage("xy", encoders={"x": PER_METRE, "y": -100_000}, **LIKE)


@pytest.fixture
def fed(encoder_stage):
    encoder_stage.reset()
    return encoder_stage


def read_logical_position(chip, axes=1):
    chip.write(0, axes << 8 | 0x30)
    value = chip.read(6) | chip.read(7) << 16
    return value - (1 << 32) if value >> 31 else value


def finish(stage, chip, axis=0):
    stage.run_until(lambda: not chip.axes[axis].pins.drive, timeout=2.0)
    stage.run(0.3)


def compute_count(axis, per_metre):
    return math.floor(axis.position * per_metre + 0.5)


def test_after_a_move_rp_is_the_true_position_in_counts(fed):
    x, y = fed.axes.values()
    assert real_position(x.chip) == 0
    nova.move(x.chip, 800)
    nova.move(x.chip, 600, axes=2)
    finish(fed, x.chip)
    assert real_position(x.chip) == compute_count(x, PER_METRE) == pytest.approx(800, abs=4)
    assert real_position(x.chip, 2) == compute_count(y, -100_000) == pytest.approx(-600 * 100 / 320, abs=3)
    fed.place(x=0.0123)
    assert real_position(x.chip) == compute_count(x, PER_METRE) == 3936, "the hand that moves it is seen, too"


def test_in_motion_it_counts_with_a_counter_on_the_bus(fed):
    """The same Encoder at the same moment, to a count; a switch of 62.5 ns away."""
    board = Board(copy.copy(fed))
    x = board.stage.axes["x"]
    counter = board.attach_device(HCTL2016(Encoder("x", per_metre=PER_METRE)), 0x320)
    nova.move(x.chip, 2000)
    for _ in range(20):
        board.stage.run(7e-3)
        x.chip.write(0, 0x131)
        observed = counter.counts[0]
        assert abs((x.chip.read(6) | x.chip.read(7) << 16) - observed) <= 1
    assert observed > 100


def test_what_a_jammed_motor_loses_is_the_difference_of_lp_and_rp(fed):
    x = fed.axes["x"]
    with faults.jam(x):
        nova.move(x.chip, 1600)
        finish(fed, x.chip)
    fed.run(0.1)
    assert read_logical_position(x.chip) == 1600
    assert x.lost_steps >= 60
    assert real_position(x.chip) == pytest.approx(1600 - 16 * x.lost_steps, abs=32)


@pytest.mark.parametrize(("mode", "edges"), [(1, 2), (2, 4)])
def test_the_mode_register_divides(fed, mode, edges):
    x = fed.axes["x"]
    x.chip.write(0, 0x11F)
    x.chip.write(3, mode << 8)
    fed.place(x=0.01)
    assert real_position(x.chip) == 3200 // edges


def test_an_mcx304_counts_in_ep_and_an_encoder_may_be_on_the_motor():
    stage = Stage("xy", chips=MCX304, encoders=[Encoder("y", per_turn=2000)], visuals=False)
    y = stage.axes["y"]
    stage.place(y=0.005)
    assert real_position(y.chip, 2) == math.floor(0.005 * 2000 * y.gear / (2 * math.pi) + 0.5) == 1000
    assert real_position(y.chip, 1) == 0


def test_a_comparator_on_rp_acts_where_the_carriage_is(fed):
    x = fed.axes["x"]
    nova.load(x.chip, MR0=400)
    x.chip.write(6, 0b0001)
    x.chip.write(0, 0x120)  # MRM: RP >= MR0
    x.chip.write(0, 0x11F)
    x.chip.write(1, 1)  # an interrupt
    nova.move(x.chip, 800)
    fed.run_until(lambda: x.chip.pins.int0, timeout=1.0, poll=1e-5)
    assert x.position * PER_METRE == pytest.approx(399.5, abs=0.2), "within a poll"


PROGRAM = """
static void put(int code, long value)
{
    ps_out16(PORT + 12, (uint16_t)value), ps_out16(PORT + 14, (uint16_t)(value >> 16)), ps_out16(PORT, (uint16_t)(0x100 | code));
}
static long get(int code)
{
    ps_out16(PORT, (uint16_t)(0x100 | code));
    return (int32_t)(ps_in16(PORT + 12) | (uint32_t)ps_in16(PORT + 14) << 16);
}
PULSESTAGE_MAIN
{
    put(0x04, 4000), put(0x05, 4000), put(0x06, 200), ps_out16(PORT, 0x150);
    while (ps_in16(PORT) & 1)
        ;
    ps_delay_us(30000);
    ps_logf("LP %ld RP %ld", get(0x30), get(0x31));
    return 0;
}
"""


def test_firmware_reads_rp_isolated_or_not_to_the_same_bits(fed, capsys):
    left = []
    for isolated in (False, True):
        host = NativeHost(firmware(PROGRAM, "-DPORT=0x300"), Board(copy.copy(fed)), isolated=isolated)
        assert host.run().code == 0
        left.append(collect_results(host))
    assert left[0] == left[1]
    lp, rp = map(int, host.board.log[-1][1].split()[1::2])
    assert lp == 200
    assert rp == pytest.approx(200, abs=10)
    library = str(firmware(PROGRAM, "-DPORT=0x300"))
    assert main(["run", library, "--model", "xy", "--chips", "mcx514", "--encoder", f"x={-PER_METRE}"]) == 0
    assert f"LP 200 RP {-rp}" in capsys.readouterr().out


def test_a_snapshot_a_copy_a_pickle_and_a_fleet_go_on_to_the_same_bits(fed):
    x = fed.axes["x"]
    nova.move(x.chip, 500)
    fed.run(0.0123456)
    others = [copy.deepcopy(fed), pickle.loads(pickle.dumps(fed)), copy.copy(fed)]
    before = fed.snapshot()
    fed.run(0.02)
    after = fed.snapshot()
    Fleet(others[2:], threads=1).play([Program().wait(0.02)])
    fed.restore(before)
    fed.run(0.02)
    for other in others[:2]:
        other.run(0.02)
    for stage in (fed, *others):
        assert stage.snapshot().state.tobytes() == after.state.tobytes()
    with pytest.raises(ArgumentError, match="encoder"):
        Stage("xy", **LIKE).restore(before)


def test_a_journal_brings_a_chip_on_the_bench_to_the_same_state(fed):
    x = fed.axes["x"]
    journal = x.chip.journal()
    nova.move(x.chip, 300)
    fed.run(0.0300001)
    fed.place(y=0.02)
    fed.run(0.003)
    journal.close()
    lone = x.chip.make_replica(journal.start_state.tobytes())
    for e in journal.entries:
        lone.CORE.run(lone._rows, e.clock)
        e.apply(lone.CORE, lone._rows)
    lone.CORE.run(lone._rows, journal.end_clock)
    internal = {"pulse_clock_sum", "recent_net", "first_pulse_clock"}
    for field in lone.state["ax"].dtype.names:
        assert field in internal or np.array_equal(lone.state["ax"][field], x.chip.state["ax"][field]), field
    shafts = [(e.axis, bits_to_float(e.a)) for e in journal.entries if e.kind == SHAFT]
    assert {axis for axis, _ in shafts} == {0, 1}
    edges = journal.replay_waveforms(every_pulse=True).edges
    a = (edges["inputs"] & MCX514.INPUTS["eca"] != 0).astype(int)
    assert abs(np.diff(a)).sum() == pytest.approx(real_position(x.chip) / 2, abs=20)


def test_without_encoders_rp_stays_and_the_stage_is_the_same(fed):
    """But for the counter and what makes it."""
    bare = Stage("xy", **LIKE)
    for stage in (bare, fed):
        nova.move(stage.axes["x"].chip, 100)
        stage.run(0.05)
    assert (bare.data.qpos == fed.data.qpos).all()
    assert bare.axes["x"].chip.net() == fed.axes["x"].chip.net()
    assert real_position(bare.axes["x"].chip) == 0
    assert not bare.axes["x"].chip.pins.int0


@pytest.mark.parametrize(
    ("encoders", "chips", "message"),
    [
        ({"x": 200_000}, PCL240K, "PCL240K has no input for an encoder; .*MCX514.*HCTL2016"),
        ({"x": 200_000}, HCTL1100, "HCTL1100 has one already, that of the Servo"),
        ({"q": 200_000}, MCX514, "unknown axis 'q'"),
        ({"x": 0}, MCX514, "axis x: 0: a number of counts a metre"),
        ({"x": float("inf")}, MCX514, "axis x: inf: a number of counts a metre"),
        ({"x": "many"}, MCX514, "axis x: 'many': a number of counts a metre"),
        ([Encoder("x", per_turn=4), Encoder("x", per_turn=4)], MCX514, "axis x is given two"),
        (Encoder("x", per_turn=4, zero=0.1), MCX514, "zero= is for devices"),
        ("x", MCX514, "encoders='x': a mapping axis -> counts a metre"),
        (200_000, MCX514, "encoders=200000: a mapping"),
    ],
)
def test_what_is_no_encoder_is_refused_in_words(encoders, chips, message):
    with pytest.raises(ArgumentError, match=message):
        Stage("xy", chips=chips, encoders=encoders, visuals=False)


@pytest.mark.parametrize("text", ["x", "=5", "x=much", "x=0", "x=nan", "x=5/metre"])
def test_an_option_that_is_no_encoder_says_how_to_write_one(text, capsys):
    assert main(["run", "driver.c", "--chips", "mcx514", "--encoder", text]) == 2
    assert "write AXIS=COUNTS" in capsys.readouterr().err


def test_the_option_accepts_encoders_on_the_motor():
    from stage.cli import build_parser, stage_setup

    args = build_parser().parse_args(["run", "a.c", "--model", "xy", "--chips", "mcx514", "--encoder", "x=2000/turn"])
    stage = stage_setup.make_stage(args)
    stage.place(x=0.01)
    assert real_position(stage.axes["x"].chip) == 2000


@pytest.mark.stage("xy", chips="MCX514", encoders={"x": 1000}, record=False)
def test_the_marker_of_a_test_takes_encoders(request):
    from stage.testing.marker_arguments import read_stage_arguments

    assert read_stage_arguments(request.node)["encoders"] == {"x": 1000}


def test_counts_a_turn_have_the_sign_of_the_gear():
    """Encoder("x", per_turn=2000) behind a gear of -100 rad/m, and one of counts a metre beside it"""
    plant = [SimpleNamespace(name=name, gear=gear) for name, gear in (("x", -100.0), ("y", 50.0), ("z", -100.0))]
    counts = list_counts_per_unit([Encoder("x", per_turn=2000), Encoder("z", per_metre=7.0)], plant)
    assert counts == [-2000 * 100 / (2 * math.pi), 0.0, 7.0]


def test_an_encoder_of_a_device_counts_from_the_present_position_and_those_of_a_chip_are_in_the_order_of_the_axes(
    encoder_stage, fed
):
    """board.attach_device(HCTL2016(Encoder("x", per_metre=320_000)), 0x340) with the carriage 5 mm away; Encoder("x", zero=0.0)"""
    fed.place(x=5e-3)
    board = Board(fed)
    for port, encoder in ((0x340, Encoder("x", PER_METRE)), (0x350, Encoder("x", PER_METRE, zero=0.0))):
        board.attach_device(HCTL2016(encoder), port)
    counts = [board.in8(port) << 8 | board.in8(port + 1) for port in (0x340, 0x350)]
    assert counts[0] in (0, 1, 0xFFFF)
    assert counts[1] == pytest.approx(5e-3 * PER_METRE, abs=1)
    axes = [a.chip.axes[a.chip_axis] for a in fed.axes.values()]
    assert [e.axis for e in choose_encoders({"y": 1000, "x": 2000}, ("x", "y"), axes)] == ["x", "y"]


@pytest.mark.parametrize("rate", [True, 0, math.inf])
def test_a_rate_of_an_encoder_is_a_number(rate):
    with pytest.raises(ArgumentError, match="per_metre= or per_turn="):
        Encoder("x", per_metre=rate)
    with pytest.raises(ArgumentError, match="number of counts a metre"):
        choose_encoders({"x": rate}, ("x",), ())
