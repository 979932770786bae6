"""Every argument that is a time: what is none is refused in words, what has passed changes nothing, what is long can be ended."""

import os
import signal
import threading

import numpy as np
import pytest

from stage import Stage
from stage.chips import CHIPS, HCTL1100, MCX514, PCL240K
from stage.chips.chip import LAST_CLOCK, MAX_CLOCKS
from stage.errors import ArgumentError
from stage.firmware import Bench

NAN, INFINITE = float("nan"), float("inf")
NO_NUMBERS = (NAN, INFINITE, -INFINITE, "5", None, [5], 1j, np.float64("nan"), np.array([1, 2]))
HUGE = (1 << 63, 1 << 64, 1 << 200, 1e300)
NEGATIVE = (-1, -1 - (1 << 63), -1e300, np.int64(-1))


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", chips=PCL240K, visuals=False)


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_advance_takes_an_integer_number_of_clocks_only(name):
    """chip.advance(nan) raised a bare ValueError; a clock beyond 63 bits ran backwards"""
    chip = CHIPS[name]()
    chip.advance(100)
    before = chip.snapshot().record
    for wrong in (*NO_NUMBERS, *HUGE, *NEGATIVE, 1.5, MAX_CLOCKS + 1):
        for run in (chip.advance, chip.trace):
            with pytest.raises(ArgumentError, match="advances by a whole number of 0 to"):
                run(wrong)
    chip.state["clock"] = LAST_CLOCK - 10
    with pytest.raises(ArgumentError, match="a chip's clock ends at"):
        chip.advance(11)
    chip.advance(10)
    assert chip.clock == LAST_CLOCK
    chip.restore(CHIPS[name]().snapshot())
    chip.advance(100)
    assert chip.snapshot().record == before


@pytest.mark.parametrize("past", [-1, 0, -(1 << 63) - 1, -(1 << 63), -(1 << 64), -1e300])
def test_a_time_that_has_passed_changes_nothing(stage, past):
    """stage.run_to(-2**63 - 1) ran for ever"""
    stage.run(1e-4)
    before = stage.snapshot().state.tobytes()
    stage.run_to(past)
    assert stage.snapshot().state.tobytes() == before


def test_times_of_a_stage_that_are_none_are_refused_and_change_nothing(stage):
    before = stage.snapshot().state.tobytes()
    for wrong in (*NO_NUMBERS, *HUGE, *NEGATIVE):
        runs = [stage.run, stage.step, stage.axes["x"].wait]
        runs += [lambda t: stage.run_until(lambda: True, t), lambda t: stage.run_until(lambda: True, 1.0, t)]
        if not any(wrong is past for past in NEGATIVE):
            runs.append(stage.run_to)
        for run in runs:
            with pytest.raises(ArgumentError):
                run(wrong)
    assert stage.snapshot().state.tobytes() == before


def test_times_of_a_bench_that_are_none_are_refused():
    bench = Bench(PCL240K())
    for wrong in (*NO_NUMBERS, *HUGE, *NEGATIVE):
        with pytest.raises(ArgumentError):
            bench.wait(wrong)
        with pytest.raises(ArgumentError):
            bench.at(wrong, lambda: None)
    chip = bench.axes["x"].chip
    waits = LAST_CLOCK // (chip.clock_hz * 900_000_000)
    for _ in range(waits):
        bench.wait(9e8)
    with pytest.raises(ArgumentError, match="a chip's clock ends at"):
        bench.wait(9e8)
    assert chip.clock == waits * chip.clock_hz * 900_000_000


@pytest.mark.parametrize("number", [NAN, INFINITE, "5", None, 1j])
def test_a_shaft_is_at_a_number(number):
    for make in (MCX514, HCTL1100):
        with pytest.raises(ArgumentError):
            make().set_shaft(number)
        with pytest.raises(ArgumentError):
            make().set_shaft(0, number)


@pytest.mark.skipif(os.name != "posix", reason="sends itself SIGINT")
def test_ctrl_c_interrupts_a_long_advance_and_the_chip_continues_exactly():
    """A servo's samples for weeks of its time: minutes of ours, in one call that nothing could end"""
    chip = HCTL1100()
    chip.write(0x0F, 0)  # the shortest sample
    chip.write(0x05, 0x03)
    chip.set_shaft(0, 0.01)
    before, replica = signal.signal(signal.SIGINT, signal.default_int_handler), chip.make_replica()
    timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            chip.advance(MAX_CLOCKS)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)
    assert 0 < chip.clock < MAX_CLOCKS
    for stop in (chip.clock, chip.clock + 5000):
        chip.advance(stop - chip.clock)
        replica.advance(stop - replica.clock)
        assert chip.snapshot().record == replica.snapshot().record


def test_pulses_that_no_memory_holds_are_refused_before_any_is_traced():
    chip = MCX514()
    for code, value in ((0x04, 8_000_000), (0x05, 8_000_000)):
        chip.write(6, value & 0xFFFF)
        chip.write(7, value >> 16)
        chip.write(0, 0x100 | code)
    chip.write(0, 0x152)
    before = chip.snapshot().record
    with pytest.raises(ArgumentError, match=r"there are \d+ pulses, more than memory holds"):
        chip.trace(MAX_CLOCKS)
    assert chip.snapshot().record == before
