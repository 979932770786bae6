"""The waveforms, read back by a parser of their own and held against the chips."""

import random
from fractions import Fraction

import numpy as np
import pytest
from support.programs import load_registers
from support.recording_bench import drive, make_bench
from support.vcd_parser import parse

from stage import Stage, faults
from stage.chips import MCX514, PCL240K
from stage.recording import pin_signals
from stage.recording.vcd_writer import to_nanoseconds

HZ = PCL240K.DEFAULT_CLOCK_HZ


def clock(ns):
    """The tick that a time stands for, as the documentation says."""
    return (2 * ns * HZ + 10**9) // (2 * 10**9)


def wild(bench, seed, steps=120):
    """A program that touches everything; returns pulses (as chip.trace has them) and looks: (clock, pins, status, R0)."""
    rng, chip = random.Random(seed), bench.chip
    pulses, observers = [], []
    for _ in range(steps):
        kind = rng.randrange(8)
        if kind == 0:
            setattr(chip.pins, rng.choice(list(chip.INPUTS)), rng.random() < 0.4)
        elif kind == 1:
            chip.write(0, rng.choice((0x40, 0x44, 0x48, 0x4C, 0x42, 0x41)))
        elif kind == 2:
            chip.write(0, rng.choice((0xC0, 0xC1 if seed % 2 else 0xD0, 0xE0)))
        elif kind == 3:
            for pin in chip.INPUTS:
                setattr(chip.pins, pin, False)
            r0 = rng.choice((3, 40, 100_000))
            load_registers(
                chip, R0=r0, R1=60, R2=rng.randint(60, 4000), R4=7, R5=9, R6=rng.choice((0, 20)), R7=rng.randint(2, 9)
            )
            for command in (0x08, rng.choice((0x15, 0x11, 0x35))):
                chip.write(0, command)
        elif kind == 4:
            chip.write(0, rng.choice((0x1D, 0x14, 0x17, 0x08, 0x28)))
        elif kind == 5 and rng.random() < 0.2:
            chip.reset()
        pulses.append(chip.trace(rng.randint(1, 30_000)))
        observers.append((chip.clock, chip.pins.as_dict(), chip.read(0), chip.values()["R0"]))
        pulses.append(chip.trace(1))  # what comes next is at another clock than the look
    bench.recording.close()
    return np.concatenate(pulses), observers


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_pulses_pins_status_and_counter_are_those_of_the_chip_to_the_clock(tmp_path, seed):
    bench = make_bench()
    pulses, observers = wild(bench, seed)
    assert len(pulses) > 300, "the program does something"
    vcd = parse(bench.recording.to_vcd(tmp_path / "x.vcd"))
    independent = any(v & 1 for t, v in vcd.changes["x.bus.D"] if isinstance(v, int) and v >> 6 == 3)
    plus = [clock(t) for t in vcd.edges("x.POUT_n", 0)]
    if not independent:
        assert plus == pulses["clock"].tolist()
        assert [vcd.at("x.PDIR", to_nanoseconds(int(p["clock"]), HZ)) for p in pulses] == (
            pulses["direction"] > 0
        ).tolist()
    for now, pins, status, r0 in observers:
        ns = to_nanoseconds(now, HZ)
        assert vcd.at("x.R0", ns) == r0
        for pin, on in pins.items():
            name, asserted = pin_signals.find_wire_name_and_level(bench.chip, pin)
            assert vcd.at(f"x.{name}", ns) == (asserted if on else 1 - asserted), (seed, now, pin)
        for field in PCL240K.MAP.word("status").fields:
            assert vcd.at(f"x.status.{field.name}", ns) == field.extract(status), (seed, now, field.name)


def test_hold_is_1_at_rest_and_0_in_operation_in_the_waveforms(tmp_path, bench):
    """HOLD is active high: 1 when no pulse is output (data sheet, pin 29)."""
    chip = bench.chip
    load_registers(chip, R0=5, R1=60, R2=60, R3=60, R7=2)
    chip.advance(1000)
    for command in (0x08, 0x44, 0x11):
        chip.write(0, command)
    chip.advance(10_000)
    bench.recording.close()
    vcd = parse(bench.recording.to_vcd(tmp_path / "x.vcd"))
    assert [level for _, level in vcd.changes["x.HOLD"]] == [1, 0, 1]
    assert [clock(t) for t in vcd.edges("x.HOLD", 0)] == [1000], "the start"
    last = clock(vcd.edges("x.POUT_n", 1)[-1])
    assert [clock(t) for t in vcd.edges("x.HOLD", 1)] == [last], "POUT is high again after the fifth pulse"


def test_in_independent_mode_minus_pulses_are_on_pdir(tmp_path, bench):
    load_registers(bench.chip, R0=50, R1=400, R7=3)
    for command in (0xC1, 0x4C, 0x10):
        bench.chip.write(0, command)
    pulses = bench.chip.trace(1_000_000)
    bench.recording.close()
    vcd = parse(bench.recording.to_vcd(tmp_path / "x.vcd"))
    assert len(pulses) == 50
    assert [clock(t) for t in vcd.edges("x.PDIR", 0)] == pulses["clock"].tolist()
    assert vcd.edges("x.POUT_n", 0) == []


def test_the_bus_writes_and_resets_are_events_with_address_and_data(tmp_path, bench):
    rng = random.Random(5)
    wrote = []
    for _ in range(200):
        bench.chip.advance(rng.randint(1, 500))
        a, d = rng.randrange(4), rng.randrange(256)
        wrote.append((bench.chip.clock, a, d))
        bench.chip.write(a, d)
    bench.chip.advance(10)
    bench.chip.reset()
    bench.recording.close()
    vcd = parse(bench.recording.to_vcd(tmp_path / "x.vcd"))
    times = [t for t, _ in vcd.changes["x.bus.WR"]]
    assert [(clock(t), vcd.at("x.bus.A", t), vcd.at("x.bus.D", t)) for t in times] == wrote
    assert [clock(t) for t, _ in vcd.changes["x.bus.RESET"]] == [bench.chip.clock]
    assert vcd.timescale == "1 ns"


def test_a_lost_write_is_a_separate_event(tmp_path, bench):
    chip, at = bench.chip, []
    with faults.lost_write(chip, value=2):
        for value in (1, 2, 3):
            chip.advance(100)
            at.append(chip.clock)
            chip.write(1, value)
    chip.advance(100)
    bench.recording.close()
    vcd = parse(bench.recording.to_vcd(tmp_path / "x.vcd"))
    events = {
        name: [(clock(t), vcd.at("x.bus.A", t), vcd.at("x.bus.D", t)) for t, _ in vcd.changes[f"x.bus.{name}"]]
        for name in ("WR", "LOST")
    }
    assert events == {"WR": [(at[0], 1, 1), (at[2], 1, 3)], "LOST": [(at[1], 1, 2)]}


def test_after_the_reset_pin_the_direction_is_plus_and_the_sd_bit_that_of_its_switch(tmp_path, bench):
    chip, observers = bench.chip, []
    chip.pins.sd_minus = True
    for act in (lambda: chip.write(0, 0x48), chip.reset, lambda: chip.write(0, 0x48)):
        chip.advance(100)
        act()
        chip.advance(100)
        observers.append((chip.clock, chip.read(0) >> 2 & 1))
    chip.advance(1)
    bench.recording.close()
    vcd = parse(bench.recording.to_vcd(tmp_path / "x.vcd"))
    assert [on for _, on in observers] == [1, 0, 1]
    assert [vcd.at("x.status.sd", to_nanoseconds(at, HZ)) for at, _ in observers] == [1, 0, 1]


def test_a_stage_has_a_scope_for_each_axis_and_one_time_for_all(run, tmp_path):
    vcd = parse(run.recording.to_vcd(tmp_path / "x.vcd"))
    assert {name.split(".")[0] for name in vcd.changes} == {"x", "y", "z"}
    assert vcd.end == pytest.approx(run.stage.time * 1e9, abs=300)
    assert len(vcd.edges("y.POUT_n", 0)) == 1500
    assert vcd.edges("z.POUT_n", 0) == []
    (el,) = vcd.edges("x.EL_MINUS_n", 0)
    sampled = run.recording.column("x/el_minus")
    assert run.recording.column("time")[np.argmax(sampled)] == pytest.approx(el * 1e-9, abs=1e-3)
    low = run.recording.column("x/rate")
    assert max(v for _, v in vcd.changes["x.RATE"]) == pytest.approx(low.max())


def test_another_reader_takes_the_file_too(run, tmp_path):
    tokens = pytest.importorskip("vcd.reader").tokenize
    with open(run.recording.to_vcd(tmp_path / "x.vcd"), "rb") as file:
        kinds = [token.kind.name for token in tokens(file)]
    assert kinds.count("VAR") == 3 * 31
    assert kinds.count("CHANGE_SCALAR") > 2 * 3500


def test_a_later_recording_begins_at_the_stages_time(tmp_path):
    stage = Stage("xy", chips=PCL240K)
    stage.run(0.5)
    with stage.record() as recording:
        stage.axes["x"].chip.write(0, 0x81)
        stage.run(0.01)
    vcd = parse(recording.to_vcd(tmp_path / "x.vcd"))
    assert vcd.changes["x.HOLD"][0][0] == pytest.approx(0.5e9, abs=300)
    assert vcd.end == pytest.approx(0.510001e9, abs=300)


def test_chips_of_several_clocks_begin_at_the_earliest_of_their_clocks(tmp_path):
    """Stage("xy", chips={"x": PCL240K, "y": MCX514}): 4.9152 and 16 MHz after 1.2345678 ms"""
    stage = Stage("xy", chips={"x": PCL240K, "y": MCX514}, visuals=False)
    stage.run(1.2345678e-3)
    with stage.record() as recording:
        stage.run(1e-4)
    starts = [
        to_nanoseconds(int(j.start_state["clock"]), recording.axes[n].chip.clock_hz)
        for n, j in recording.journals.items()
    ]
    assert len(set(starts)) == 2
    first = next(line for line in recording.to_vcd(tmp_path / "x.vcd").read_text().splitlines() if line.startswith("#"))
    assert int(first[1:]) == min(starts)


def test_ticks_come_back_from_nanoseconds_after_a_century():
    for hz in (1, 4_915_200, 9_830_400, 99_999_999, 100_000_000):
        ticks = np.array([0, 1, 2, hz - 1, hz, 100 * 365 * 86400 * hz + 12345], np.int64)
        ns = to_nanoseconds(ticks, hz)
        assert [to_nanoseconds(int(t), hz) for t in ticks] == ns.tolist()
        assert [(2 * int(t) * hz + 10**9) // (2 * 10**9) for t in ns] == ticks.tolist()


@pytest.mark.parametrize("hz", [1, 3, 4_915_200, 9_830_400, 99_999_999])
def test_times_are_the_nearest_nanoseconds(hz):
    """recording.to_vcd("x.vcd"): #203 for a tick of 203.45 ns, #306 for 305.18"""
    ticks = [*range(2000), hz - 1, hz, 10**8 * hz + 7]
    for t, ns in zip(ticks, to_nanoseconds(np.array(ticks, np.int64), hz).tolist(), strict=True):
        assert -1 < 2 * (ns - Fraction(t * 10**9, hz)) <= 1
        assert to_nanoseconds(t, hz) == ns


def test_the_pieces_of_a_recording_are_the_recording(bench):
    wild(bench, 3)
    journal = bench.recording.journals["x"]
    for every_pulse in (False, True):
        parts = list(journal.replay_in_pieces(every_pulse, size=100))
        assert max(map(len, parts)) <= 100
        assert np.array_equal(np.concatenate(parts), journal.replay_waveforms(every_pulse).edges)


def test_the_waveforms_do_not_depend_on_the_size_of_pieces(tmp_path, bench, monkeypatch):
    """many changes lie where one piece ends and the next begins"""
    wild(bench, 3, steps=10)
    complete = bench.recording.to_vcd(tmp_path / "whole.vcd").read_bytes()
    monkeypatch.setattr("stage.recording.vcd_writer.MAX_EDGES_AT_ONCE", 70)
    assert bench.recording.to_vcd(tmp_path / "pieces.vcd").read_bytes() == complete


def test_reads_that_change_something_are_events_and_others_are_not(tmp_path):
    stage = Stage("xyz", chips=MCX514, visuals=False)
    chip = stage.chips[0]
    with stage.record() as recording:
        for address in (0, 1, 2, 1):
            word, ticks = chip.read(address), chip.clock
    vcd = parse(recording.to_vcd(tmp_path / "x.vcd"))
    times = [t for t, _ in vcd.changes["x.bus.RD"]]
    assert len(times) == 2
    assert times[-1] == to_nanoseconds(ticks, chip.clock_hz)
    assert (vcd.at("x.bus.A", times[-1]), vcd.at("x.bus.D", times[-1])) == (1, word)


def test_the_same_run_makes_the_same_file(tmp_path):
    def file(name):
        stage = Stage("xyz", chips=PCL240K)
        with stage.record() as recording:
            drive(stage)
        return recording.to_vcd(tmp_path / name).read_bytes()

    assert file("a.vcd") == file("b.vcd")
