"""Timers of an ATmega328P in normal and CTC mode count as its data sheet says, to the cycle."""

import ctypes
import shutil
from pathlib import Path

import pytest
from support.avr_timer_scripts import (
    OCFA,
    OCFB,
    RESULTS,
    TIMERS,
    TOV,
    assemble,
    read,
    run_on_reference,
    wait,
    write,
)

from stage.targets import mcus
from stage.targets.elf import AVR, Elf

pytestmark = [
    pytest.mark.skipif(not mcus.has_simavr(), reason=f"there is no {mcus.SIMAVR}"),
    pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc"),
]
each_timer = pytest.mark.parametrize("timer", TIMERS, ids=lambda r: f"timer {r.number}")


def run_on_simavr(elf: Path, n_results: int) -> list[int]:
    """Run a program to its end on simavr with exact timers, and return its results."""
    from stage.targets.simavr import _open_library
    from stage.targets.simavr_layout import AVR as AVR_STRUCTURE
    from stage.targets.simavr_layout import view
    from stage.targets.simavr_overlay import TimerOverlay

    simavr = _open_library(False)
    library, avr = simavr.library, simavr.make_avr(b"atmega328p")
    simavr.init_avr(avr)
    program = Elf(elf, AVR, "atmega328p", "")
    for segment in program.segments:
        library["avr_loadcode"](ctypes.c_void_p(avr), segment.content, len(segment.content), segment.at)
    library["avr_reset"](ctypes.c_void_p(avr))
    overlay = TimerOverlay(library, avr)
    state = view(avr, AVR_STRUCTURE)
    while state["pc"] != program.symbols["done"]:
        library["avr_run"](ctypes.c_void_p(avr))
    memory = ctypes.string_at(int(state["data"]) + RESULTS, n_results)
    library["avr_terminate"](ctypes.c_void_p(avr))
    del overlay
    return list(memory)


def check_script(script, folder) -> list[int]:
    """Check that a script reads the same on simavr and on the reference; return the values."""
    expected, _ = run_on_reference(script)
    values = run_on_simavr(*assemble(script, folder / "script"))[:-1]
    steps = [f"{name} {a:02X}h" for name, a, _ in script if name == "read"]
    assert list(zip(steps, values, strict=True)) == list(zip(steps, expected, strict=True))
    return values


@each_timer
def test_the_count_increases_at_each_cycle(timer, tmp_path):
    script = timer.select(False, 1)
    for n in range(12):
        script += [*timer.read_count(), wait(n)]
    check_script(script, tmp_path)


@each_timer
def test_a_normal_timer_overflows_one_clock_after_its_maximum(timer, tmp_path):
    top = 0xFFFF if timer.is_wide else 0xFF
    script = []
    for n in range(3, 9):
        script += [*timer.select(False, 1), *timer.write_word(timer.count, top - 4), wait(n), read(timer.flags)]
        script += [*timer.read_count(), write(timer.flags, 0xFF)]
    values = check_script(script, tmp_path)
    assert {value & TOV for value in values[:: 3 if timer.is_wide else 2]} == {0, TOV}


@each_timer
def test_a_ctc_timer_has_a_period_of_its_compare_value_plus_one(timer, tmp_path):
    script = [*timer.write_word(timer.compare[0], 20), *timer.select(True, 1)]
    for n in range(8):
        script += [wait(n), read(timer.flags), *timer.read_count(), write(timer.flags, OCFA)]
    check_script(script, tmp_path)


@each_timer
def test_a_ctc_timer_that_started_with_a_compare_value_of_0_takes_a_new_one(timer, tmp_path):
    script = [*timer.select(True, 1), wait(9), read(timer.flags), *timer.read_count()]
    script += [*timer.write_word(timer.compare[0], 30), write(timer.flags, OCFA), read(timer.flags)]
    for n in range(8):
        script += [wait(n), *timer.read_count(), read(timer.flags)]
    check_script(script, tmp_path)


@each_timer
def test_a_stopped_timer_keeps_the_count_that_is_written(timer, tmp_path):
    top = 0xFFFF if timer.is_wide else 0xFF
    script = [*timer.write_word(timer.count, top - 3), wait(5), *timer.read_count(), *timer.select(False, 2)]
    for n in range(8):
        script += [wait(n), *timer.read_count(), read(timer.flags)]
    check_script(script, tmp_path)


@each_timer
def test_a_count_continues_with_another_prescaler(timer, tmp_path):
    script = []
    for clock in (1, 2, 3, 1, 4, 2, 0, 5, 1):
        script += [*timer.select(False, clock), wait(77), *timer.read_count(), wait(123), *timer.read_count()]
    check_script(script, tmp_path)


@each_timer
@pytest.mark.parametrize("clock", [1, 2])
def test_a_compare_value_below_the_count_matches_after_the_maximum(timer, clock, tmp_path):
    top, once = (0xFFFF, 66_000) if timer.is_wide else (0xFF, 256)
    script = [*timer.write_word(timer.compare[0], 200), *timer.write_word(timer.count, 150), *timer.select(True, clock)]
    script += [*timer.write_word(timer.compare[0], 100), wait(60), *timer.read_count(), read(timer.flags)]
    script += [wait(once), *timer.read_count(), read(timer.flags)]
    script += [
        *timer.write_word(timer.count, top - 2),
        wait(150 << 3 * (clock - 1)),
        *timer.read_count(),
        read(timer.flags),
    ]
    check_script(script, tmp_path)


@each_timer
def test_two_compare_units_set_their_flags_independently(timer, tmp_path):
    script = [*timer.write_word(timer.compare[0], 40), *timer.write_word(timer.compare[1], 25), *timer.select(True, 1)]
    for n in range(10):
        script += [wait(n), read(timer.flags), write(timer.flags, OCFA if n % 2 else OCFB), read(timer.flags)]
    values = check_script(script, tmp_path)
    assert {value & (OCFA | OCFB) for value in values} == {0, OCFA, OCFB, OCFA | OCFB}


@each_timer
def test_writing_1_clears_a_flag_and_writing_0_does_not(timer, tmp_path):
    script = [*timer.write_word(timer.compare[0], 5), *timer.write_word(timer.compare[1], 6), *timer.select(False, 1)]
    script += [wait(20), *timer.select(False, 0), read(timer.flags), write(timer.flags, 0), read(timer.flags)]
    script += [write(timer.flags, OCFB), read(timer.flags), write(timer.flags, OCFA), read(timer.flags)]
    assert check_script(script, tmp_path) == [OCFA | OCFB, OCFA | OCFB, OCFA, 0]


@each_timer
def test_a_count_written_as_the_compare_value_does_not_match(timer, tmp_path):
    script = [*timer.write_word(timer.compare[0], 50), *timer.select(True, 2), *timer.write_word(timer.count, 50)]
    script += [wait(64), *timer.read_count(), read(timer.flags)]
    values = check_script(script, tmp_path)
    assert values[0] > 50
    assert not values[-1] & OCFA


@each_timer
def test_an_interrupt_whose_flag_is_set_already_comes_when_it_is_enabled(timer, tmp_path):
    vector = timer.vectors[0]
    script = [*timer.write_word(timer.compare[0], 3), *timer.select(False, 1), wait(20), *timer.select(False, 0)]
    script += [read(timer.flags), write(timer.enables, OCFA), wait(20), read(timer.flags)]
    *flags, count = run_on_simavr(*assemble(script, tmp_path / "script", counted_vector=vector))
    assert (flags, count) == ([OCFA | OCFB, OCFB], 1)


@each_timer
def test_each_match_is_one_interrupt(timer, tmp_path):
    """The routine takes 8 to 12 cycles, so the wait of 5000 cycles lasts for 26 periods of 200 cycles."""
    script = [*timer.write_word(timer.compare[0], 199), write(timer.enables, OCFA), *timer.select(True, 1), wait(5_000)]
    *_, count = run_on_simavr(*assemble(script, tmp_path / "script", counted_vector=timer.vectors[0]))
    assert count == 26
