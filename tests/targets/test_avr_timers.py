"""Timers of an ATmega328P in normal and CTC mode count as its data sheet says, to the cycle."""

import ctypes
import random
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.avr_timer_scripts import (
    ICF,
    OCFA,
    OCFB,
    RESULTS,
    TIMERS,
    TOV,
    align_accesses,
    assemble,
    read,
    run_on_reference,
    wait,
    write,
)  # fmt: skip

from stage import Stage
from stage.board import Board
from stage.errors import StageError
from stage.targets import TargetHost, simavr_structure_offsets, supported_processors
from stage.targets.elf import AVR, Elf

pytestmark = [
    pytest.mark.skipif(
        not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
    ),
    pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc"),
]
each_timer = pytest.mark.parametrize("timer", TIMERS, ids=lambda r: f"timer {r.number}")


def run_on_simavr(elf: Path, n_results: int) -> list[int]:
    """Run a program to its end on simavr with exact timers, and return its results."""
    from stage.targets.simavr import _open_library
    from stage.targets.simavr_register_handlers import SimavrRegisterHandlers
    from stage.targets.simavr_structure_offsets import AVR_T as AVR_STRUCTURE
    from stage.targets.simavr_structure_offsets import view_structure

    simavr = _open_library(False)
    library, avr = simavr.library, simavr.make_avr(b"atmega328p")
    simavr.init_avr(avr)
    program = Elf(elf, AVR, "atmega328p", "")
    for segment in program.segments:
        library["avr_loadcode"](ctypes.c_void_p(avr), segment.content, len(segment.content), segment.at)
    library["avr_reset"](ctypes.c_void_p(avr))
    overlay = SimavrRegisterHandlers(library, avr)
    state = view_structure(avr, AVR_STRUCTURE)
    while state["pc"] != program.symbols["done"]:
        library["avr_run"](ctypes.c_void_p(avr))
    memory = ctypes.string_at(int(state["data"]) + RESULTS, n_results)
    library["avr_terminate"](ctypes.c_void_p(avr))
    del overlay
    return list(memory)


def check_script(script, timer, folder) -> list[int]:
    """Check that a script reads the same on simavr and on the reference; return the values."""
    values = run_on_simavr(*assemble(script, folder / "script"))[:-1]
    steps = [f"{name} {a:02X}h" for name, a, _ in script if name == "read"]
    expected = zip(steps, run_on_reference(script, timer), strict=True)
    assert list(zip(steps, values, strict=True)) == list(expected)
    return values


def count_up(timer):
    script = timer.select(False, 1)
    for n in range(12):
        script += [*timer.read_count(), wait(n)]
    return script


def overflow(timer):
    script = []
    for n in range(3, 9):
        script += [*timer.select(False, 1), *timer.write_word(timer.count, timer.max - 4), wait(n), read(timer.flags)]
        script += [*timer.read_count(), write(timer.flags, 0xFF)]
    return script


def repeat_period(timer):
    script = [*timer.write_word(timer.compare[0], 20), *timer.select(True, 1)]
    for n in range(8):
        script += [wait(n), read(timer.flags), *timer.read_count(), write(timer.flags, OCFA)]
    return script


def start_with_compare_value_0(timer):
    script = [*timer.select(True, 1), wait(9), read(timer.flags), *timer.read_count()]
    script += [*timer.write_word(timer.compare[0], 30), write(timer.flags, OCFA), read(timer.flags)]
    for n in range(8):
        script += [wait(n), *timer.read_count(), read(timer.flags)]
    return script


def write_count_while_stopped(timer):
    script = [*timer.write_word(timer.count, timer.max - 3), wait(5), *timer.read_count(), *timer.select(False, 2)]
    for n in range(8):
        script += [wait(n), *timer.read_count(), read(timer.flags)]
    return script


def change_prescaler(timer):
    script = []
    for clock in (1, 2, 3, 1, 4, 2, 0, 5, 1):
        script += [*timer.select(False, clock), wait(77), *timer.read_count(), wait(123), *timer.read_count()]
    return script


def lower_compare_value_below_count(timer):
    script = [*timer.write_word(timer.compare[0], 200), *timer.write_word(timer.count, 150), *timer.select(True, 1)]
    script += [*timer.write_word(timer.compare[0], 100), wait(40), *timer.read_count(), read(timer.flags)]
    script += [*timer.write_word(timer.count, timer.max - 9), wait(60), *timer.read_count(), read(timer.flags)]
    for n in range(6):
        script += [wait(20 + n), *timer.read_count(), read(timer.flags)]
    return script


def match_two_units(timer):
    script = [*timer.write_word(timer.compare[0], 40), *timer.write_word(timer.compare[1], 25), *timer.select(True, 1)]
    for n in range(10):
        script += [wait(n), read(timer.flags), write(timer.flags, OCFA if n % 2 else OCFB), read(timer.flags)]
    return script


def clear_flags(timer):
    script = [*timer.write_word(timer.compare[0], 5), *timer.write_word(timer.compare[1], 6), *timer.select(False, 1)]
    script += [wait(20), *timer.select(False, 0), read(timer.flags), write(timer.flags, 0), read(timer.flags)]
    return [*script, write(timer.flags, OCFB), read(timer.flags), write(timer.flags, OCFA), read(timer.flags)]


def strobe_output(timer):
    """Force matches of output A in each of its modes; TCCRnB must show no FOC bit."""
    begin = [write(timer.output_register + 1, 1 << timer.output), *timer.write_word(timer.compare[0], 99)]
    script = [*begin, *timer.select(False, 0, output_mode=1)]
    for mode in (1, 1, 3, 1, 2, 3, 2):
        script += [*timer.select(False, 0, output_mode=mode), write(timer.strobes, 0x80), wait(4)]
        script += [read(timer.output_register), read(timer.flags), read(timer.b)]
    return script


def toggle_output(timer):
    script = [write(timer.output_register + 1, 1 << timer.output), *timer.write_word(timer.compare[0], 9)]
    script += timer.select(True, 2, output_mode=1)
    for n in range(8):
        script += [wait(40 + 3 * n), read(timer.output_register)]
    return align_accesses(script)


GROUPS = (
    count_up, overflow, repeat_period, start_with_compare_value_0, write_count_while_stopped, change_prescaler,
    lower_compare_value_below_count, match_two_units, clear_flags,
)  # fmt: skip


@each_timer
def test_the_count_increases_at_each_cycle(timer, tmp_path):
    check_script(count_up(timer), timer, tmp_path)


@each_timer
def test_a_normal_timer_overflows_one_clock_after_its_maximum(timer, tmp_path):
    values = check_script(overflow(timer), timer, tmp_path)
    assert {value & TOV for value in values[:: 3 if timer.is_wide else 2]} == {0, TOV}


@each_timer
def test_a_ctc_timer_has_a_period_of_its_compare_value_plus_one(timer, tmp_path):
    check_script(repeat_period(timer), timer, tmp_path)


@each_timer
def test_a_ctc_timer_that_started_with_a_compare_value_of_0_takes_a_new_one(timer, tmp_path):
    check_script(start_with_compare_value_0(timer), timer, tmp_path)


@each_timer
def test_a_stopped_timer_keeps_the_count_that_is_written(timer, tmp_path):
    check_script(write_count_while_stopped(timer), timer, tmp_path)


@each_timer
def test_a_count_continues_with_another_prescaler(timer, tmp_path):
    check_script(change_prescaler(timer), timer, tmp_path)


@each_timer
def test_a_compare_value_below_the_count_matches_after_the_maximum(timer, tmp_path):
    check_script(lower_compare_value_below_count(timer), timer, tmp_path)


@each_timer
def test_two_compare_units_set_their_flags_independently(timer, tmp_path):
    values = check_script(match_two_units(timer), timer, tmp_path)
    assert {value & (OCFA | OCFB) for value in values} == {0, OCFA, OCFB, OCFA | OCFB}


@each_timer
def test_writing_1_clears_a_flag_and_writing_0_does_not(timer, tmp_path):
    assert check_script(clear_flags(timer), timer, tmp_path) == [OCFA | OCFB, OCFA | OCFB, OCFA, 0]


@each_timer
def test_a_strobe_changes_the_output_and_sets_no_flag(timer, tmp_path):
    values = check_script(strobe_output(timer), timer, tmp_path)
    assert [value >> timer.output for value in values[::3]] == [1, 0, 1, 0, 0, 1, 0]


@each_timer
def test_each_match_toggles_the_output(timer, tmp_path):
    check_script(toggle_output(timer), timer, tmp_path)


@each_timer
def test_a_count_written_as_the_compare_value_does_not_match(timer, tmp_path):
    script = [*timer.write_word(timer.compare[0], 50), *timer.select(True, 2), *timer.write_word(timer.count, 50)]
    script += [wait(64), *timer.read_count(), read(timer.flags)]
    values = check_script(script, timer, tmp_path)
    assert values[0] > 50
    assert not values[-1] & OCFA


@each_timer
def test_an_interrupt_whose_flag_is_set_already_comes_when_it_is_enabled(timer, tmp_path):
    script = [*timer.write_word(timer.compare[0], 3), *timer.select(False, 1), wait(20), *timer.select(False, 0)]
    script += [read(timer.flags), write(timer.enables, OCFA), wait(20), read(timer.flags)]
    *flags, count = run_on_simavr(*assemble(script, tmp_path / "script", timer.vectors[0]))
    assert (flags, count) == ([OCFA | OCFB, OCFB], 1)


@each_timer
def test_each_match_is_one_interrupt(timer, tmp_path):
    """An interrupt takes 12 cycles, so the wait of 5000 cycles lasts for 26 periods of 200 cycles."""
    script = [*timer.write_word(timer.compare[0], 199), write(timer.enables, OCFA), *timer.select(True, 1), wait(5_000)]
    *_, count = run_on_simavr(*assemble(script, tmp_path / "script", timer.vectors[0]))
    assert count == 26


@each_timer
def test_an_interrupt_takes_four_cycles_to_its_vector(timer, tmp_path):
    """The jump there takes 3 cycles, and LDS reads the count, which was 0 when the flag was set, in its second."""
    script = [*timer.write_word(timer.compare[0], 99), write(timer.enables, OCFA), *timer.select(True, 1)]
    script += [*(wait(10) for _ in range(15)), write(timer.enables, 0)]
    *_, count = run_on_simavr(*assemble(script, tmp_path / "script", timer.vectors[0], f"lds r20, {timer.count}"))
    assert count == 4 + 3 + 1


def test_a_uart_without_transmitter_keeps_its_empty_data_register(tmp_path):
    control, status, empty, enable = 0xC1, 0xC0, 0x20, 8
    script = [
        write(control, enable),
        read(status),
        write(control, 0),
        read(status),
        write(control, enable),
        read(status),
    ]
    assert run_on_simavr(*assemble(script, tmp_path / "script"))[:-1] == [empty, empty, empty]


@pytest.mark.parametrize("structure", ["AVR_T", "AVR_MODULE_T", "AVR_TIMER_T", "AVR_IRQ_T", "AVR_UART_T"])
@pytest.mark.parametrize("distance", [4, 8, 64])
def test_a_library_with_another_layout_is_refused_with_its_version(structure, distance, monkeypatch):
    usual = getattr(simavr_structure_offsets, structure)
    formats, offsets = zip(*(usual.fields[name][:2] for name in usual.names), strict=True)
    moved = {"names": usual.names, "formats": formats, "offsets": [at + distance for at in offsets]}
    monkeypatch.setattr(simavr_structure_offsets, structure, np.dtype(moved | {"itemsize": usual.itemsize + distance}))
    monkeypatch.setattr(simavr_structure_offsets, "_checked", {})
    message = r"simavr\S* is simavr 1\.6 or 1\.7, built in another way, and exact timers need simavr 1\.6 or 1\.7 "
    with pytest.raises(StageError, match=message + r"\(.*\): .* is not where they have it\."):
        simavr_structure_offsets.check_layout(supported_processors.load_simavr())


@pytest.mark.parametrize("address", [0, 8, 1 << 40, (1 << 64) - 64])
def test_the_check_of_the_layout_takes_an_address_without_memory(address):
    assert simavr_structure_offsets._read_structure(address, simavr_structure_offsets.AVR_TIMER_T) is None


SEI_PROGRAM = r"""
#include <avr/interrupt.h>
#include <avr/io.h>

static volatile int count;

ISR(TIMER1_COMPA_vect) { count++; }

int main(void)
{
    OCR1A = 199; TCCR1B = 1 << WGM12 | 1 << CS10; TIMSK1 = 1 << OCIE1A;
    for (int n = 0; n < 1000; n++)
        __asm__ volatile("sei\n\t" BETWEEN "cli");
    return count > 30 ? 30 : count;
}
"""


@pytest.mark.parametrize(("between", "code"), [(r"nop\n\t", 30), ("", 0)], ids=["another instruction", "CLI"])
def test_an_interrupt_follows_the_instruction_after_sei(between, code, tmp_path):
    elf = tmp_path / "sei.elf"
    command = ["avr-gcc", "-mmcu=atmega328p", "-Os", f'-DBETWEEN="{between}"', "-x", "c", "-", "-o", elf]
    subprocess.run(command, input=SEI_PROGRAM, text=True, check=True)
    board = Board(Stage("xyz", chips="stepdir", drives="ideal"))
    assert TargetHost(elf, board, mcu="atmega328p", pins="x.step=D2,x.dir=D5", isolated=False).run().code == code


FAST_PWM_8_BITS = {0: (3, 0), 1: (1, 8), 2: (3, 0)}
"""Mode bits in TCCRnA and TCCRnB by the number of the timer; simavr runs these modes."""


@each_timer
def test_a_timer_in_a_pwm_mode_overflows(timer, tmp_path):
    """An interrupt takes 12 cycles, so the wait of 5000 cycles lasts for 20 periods of 256 cycles."""
    a, b = FAST_PWM_8_BITS[timer.number]
    script = [write(timer.a, a), write(timer.enables, TOV), write(timer.b, b | 1), wait(5000)]
    *_, count = run_on_simavr(*assemble(script, tmp_path / "script", timer.vectors[2]))
    assert count == 20


@each_timer
def test_a_timer_that_leaves_a_pwm_mode_counts_on(timer, tmp_path):
    a, b = FAST_PWM_8_BITS[timer.number]
    script = [write(timer.a, a), write(timer.b, b | 1), wait(90), *timer.select(False, 0)]
    script += [read(timer.count), wait(50), read(timer.count), *timer.select(False, 1)]
    script += [read(timer.count), wait(50), read(timer.count), write(timer.a, a), write(timer.b, b | 1), wait(300)]
    script += [*timer.select(False, 1), read(timer.count), wait(50), read(timer.count)]
    stopped, still, begin, end, again, last, _ = run_on_simavr(*assemble(script, tmp_path / "script"))
    assert 90 <= stopped <= 100
    assert (still, begin, end) == (stopped, stopped + 1, stopped + 55)
    assert last - again == 54


def test_an_edge_of_the_capture_pin_copies_the_count(tmp_path):
    """The program drives the pin itself, as it may on the processor."""
    timer, port, direction, pin = TIMERS[1], 0x25, 0x24, 1
    script = [write(direction, pin), write(port, pin), *timer.write_word(timer.count, 1000), *timer.select(False, 1)]
    script += [wait(300), write(port, 0), read(timer.icr), read(timer.icr + 1), *timer.read_count(), read(timer.flags)]
    elf, n_results = assemble(align_accesses(script), tmp_path / "script")
    low, high, count_low, count_high, flags, _ = run_on_simavr(elf, n_results)
    capture, count = low | high << 8, count_low | count_high << 8
    assert count - capture == 3, "three accesses later, each in another tick"
    assert flags & ICF


def make_random_script(seed, timer):
    """Return a script that changes all registers of a timer and reads them at random times."""
    rng = random.Random(seed)
    lows = [timer.count, *timer.compare, *([timer.icr] if timer.is_wide else [])]
    registers = [timer.flags, timer.a, timer.b, *lows, *((low + 1 for low in lows) if timer.is_wide else ())]
    modes = [0, 8, 24] if timer.is_wide else [0]
    script = []
    for _ in range(100):
        action = rng.randrange(8)
        if action == 0:
            script.append(write(timer.b, rng.choice(modes) | rng.choice([0, 1, 1, 1, 2, 2, 3])))
        elif action == 1 and not timer.is_wide:
            script.append(write(timer.a, rng.choice([0, 2])))
        elif action == 2:
            value = rng.choice([0, 1, 5, 30, 90, timer.max, timer.max - 1, timer.max - 20])
            script += timer.write_word(rng.choice(lows), value)
        elif action == 3:
            script.append(write(timer.flags, rng.choice([OCFA, OCFB, TOV, ICF, 0xFF])))
        elif action == 4:
            script.append(wait(rng.choice([0, 1, 2, 3, 10, 50, 200, 400])))
        elif action == 5 and timer.is_wide:
            script.append(write(rng.choice(lows) + rng.randrange(2), rng.randrange(256)))
        else:
            script.append(read(rng.choice(registers)))
    return script


@each_timer
@pytest.mark.parametrize("seed", range(8))
def test_any_accesses_give_the_values_of_the_data_sheet(seed, timer, tmp_path):
    print(f"seed {seed}")
    check_script(make_random_script(seed, timer), timer, tmp_path)


def run_on_yasimavr(elf: Path, n_results: int, cycles: int) -> list[int]:
    """Run a program for a number of cycles on yasimavr, and return its results."""
    import yasimavr.lib.core as yasimavr
    from yasimavr.device_library import load_device

    device = load_device("atmega328p")
    loop = yasimavr.SimLoop(device)
    firmware = yasimavr.Firmware.read_elf(str(elf))
    firmware.frequency = 16_000_000
    device.load_firmware(firmware)
    loop.set_fast_mode(True)
    loop.run(cycles)
    return list(bytes(yasimavr.DeviceDebugProbe(device).read_data(RESULTS, n_results)))


@pytest.mark.skipif(find_spec("yasimavr") is None, reason="there is no yasimavr (pip install yasimavr)")
@each_timer
@pytest.mark.parametrize("group", GROUPS, ids=lambda f: f.__name__)
def test_yasimavr_gives_the_same(group, timer, tmp_path):
    """yasimavr counts from the cycle of a write on, so accesses are between the clocks of the timer."""
    elf, n_results = assemble(align_accesses(group(timer)), tmp_path / "script")
    assert run_on_simavr(elf, n_results) == run_on_yasimavr(elf, n_results, 100_000)
