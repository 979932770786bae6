"""The compiled PCL-240K and the tick-by-tick reference agree to the clock on any program.

A failing program is printed with the clock of each operation and its bus writes in hex. PULSESTAGE_EXAMPLES scales
the number of programs.
"""

from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, example, given, seed, settings
from hypothesis import strategies as st
from reference.pcl240 import INPUTS, ReferencePCL240K
from support.examples import EXAMPLES, SEED, scaled
from support.pcl240k_bench import commands
from support.pcl240k_programs import (
    OPERATING,
    Pair,
    chaotic_programs,
    driver_program,
    flatten,
    real_programs,
    register,
    wide_programs,
)
from support.programs import load_registers

from stage.chips import PCL240K

random_programs = settings(
    max_examples=EXAMPLES,
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@random_programs
@given(chaotic_programs, st.booleans())
def test_any_program_agrees_to_the_clock(program, observe):
    Pair(observe).play(program)


@random_programs
@given(real_programs, st.booleans())
def test_programs_as_drivers_write_them_agree_to_the_clock(program, observe):
    """Without looks, nothing but pulses and the end is compared: a read must not be what makes the product right."""
    Pair(observe).play(program)


@settings(random_programs, max_examples=max(EXAMPLES // 10, 10))
@given(wide_programs)
def test_registers_of_any_legal_value_agree_over_long_runs(program):
    Pair().play(program)


@random_programs
@given(real_programs, st.lists(st.integers(1, 900), min_size=1, max_size=8))
@example(driver_program(0, 32, (50, 500, 500), (2, 2), 17, 2, 68, 192, 21, [], []), [1, 1, 30, 900, 1])
def test_advancing_in_pieces_is_advancing_at_once(program, pieces):
    one, many = Pair(compare_each=False), Pair(compare_each=False)
    for pair in (one, many):
        for operation in program:
            if operation[0] in ("advance", "trace"):
                break
            pair.do(operation)
    assert one.chip.advance(sum(pieces)) == sum(many.chip.advance(n) for n in pieces)
    assert one.chip.snapshot().record == many.chip.snapshot().record


def test_the_same_trace_has_the_same_bytes_to_the_padding():
    chip = PCL240K()
    load_registers(chip, R0=500, R1=400, R7=2)
    commands(chip, 0x44, 0x10)
    before, observed = chip.snapshot(), []
    for filler in (0x00, 0xFF):
        chip.restore(before)
        used = np.full(500 * chip.CORE.PULSE.itemsize, filler, np.uint8)
        del used  # memory that the trace is likely to be given
        observed.append(chip.trace(1 << 20))
    assert len(observed[0]) == 500
    assert observed[0].tobytes() == observed[1].tobytes()


def test_a_long_random_program_agrees():
    entropy = SEED
    print("seed", entropy)
    rng = np.random.default_rng(entropy)
    pair = Pair()
    for _ in range(scaled(100)):
        kind = rng.integers(0, 6)
        if kind == 0:
            program = register(int(rng.integers(0, 8)), int(rng.integers(0, 1 << int(rng.integers(1, 14)))))
        elif kind == 1:
            program = [("write", 0, int(rng.choice(OPERATING)))]
        elif kind == 2:
            program = [("write", 0, 0x08), ("write", 0, 0x15)]
        elif kind == 3:
            program = [("pin", str(rng.choice(INPUTS)), bool(rng.integers(0, 2)))]
        else:
            program = [("trace", int(rng.integers(1, 3000)))]
        pair.play(program)


def test_a_preset_run_on_external_pulses_whose_counter_is_written_0_stops_at_its_next_pulse():
    """Step 2 at its word: in preset mode a pulse that finds R0 = 0 stops the run, whoever counts."""
    program = flatten(
        [register(1, 400), register(7, 2), register(0, 40), [("write", 0, v) for v in (0xD0, 0x44, 0x10)]]
    )
    pair = Pair()
    pair.play([*program, ("trace", 10), *register(0, 0)])
    assert pair.model.running
    assert pair.model.registers[0] == 0
    assert pair.chip.advance(1000) == pair.model.advance(1000) == 1


def facts(program):
    """Return the names of the features that a program shows on the reference, stop by stop."""
    model, observed = ReferencePCL240K(), set()
    for kind, *rest in program:
        moving = model.running
        if kind in ("advance", "trace"):
            for _ in range(*rest):
                observed |= facts_of_a_tick(model)
        elif kind == "pin":
            setattr(model.pins, *rest)
        else:
            getattr(model, kind)(*rest)
        if moving and kind in ("write", "reset"):
            observed.add("written or reset in motion")
            if not model.running:
                observed.add("stopped by a write" + (" inside a pulse" if model.finishing else ""))
    return observed


def facts_of_a_tick(model):
    running, pending, counter, irq = model.running, model.stop_pending, model.registers[0], model.int_pending
    direction, out = model.tick(), model.outputs()
    observed = {name for name in ("fup", "fdown") if out[name]}
    if direction:
        observed |= {"pulses", "plus" if direction > 0 else "minus"}
    if model.int_pending and not irq:
        observed.add("/INT")
    if counter == 0 and model.registers[0]:
        observed.add("counter wraps")
    if model.external and model.registers[0] != counter:
        observed.add("counts EXTP")
    if running and not model.running:
        limit = model.pins.el_minus if model.control & 8 else model.pins.el_plus
        if limit:
            observed.add("stopped by EL")
        elif model.control & 1 and model.pins.org:
            observed.add("stopped by ORG")
        elif pending:
            observed.add("decelerated to a stop")
        else:
            assert model.registers[0] == 0, "a stop for which there is no reason"
            observed.add("stopped at R0 = 0")
    return observed


def census(strategy, programs=400):
    """Count how many random programs of a fixed seed show each feature."""
    count = Counter()

    @seed(240)
    @settings(random_programs, max_examples=programs, database=None, phases=[Phase.generate])
    @given(strategy)
    def draw(program):
        count.update(facts(program))

    draw()
    return count


@pytest.mark.slow
def test_programs_as_drivers_write_them_have_teeth():
    count = census(real_programs)
    floor = {"pulses": 300, "plus": 150, "minus": 100, "fup": 130, "fdown": 60, "written or reset in motion": 150}
    floor |= {"stopped at R0 = 0": 50, "stopped by EL": 50, "stopped by ORG": 15, "decelerated to a stop": 15}
    floor |= {"stopped by a write": 100, "stopped by a write inside a pulse": 80, "/INT": 60, "counts EXTP": 40}
    assert {name: count[name] for name in floor if count[name] < floor[name]} == {}, dict(count)


@pytest.mark.slow
def test_chaotic_programs_have_teeth():
    count = census(chaotic_programs)
    floor = {"pulses": 50, "plus": 40, "minus": 6, "fup": 25, "fdown": 20, "written or reset in motion": 120}
    floor |= {"stopped by a write": 60, "counter wraps": 40, "counts EXTP": 3, "stopped by EL": 4, "/INT": 4}
    assert {name: count[name] for name in floor if count[name] < floor[name]} == {}, dict(count)


def test_a_read_changes_nothing():
    quiet, nosy = PCL240K(), PCL240K()
    program = flatten(
        [*map(register, range(8), (50, 400, 8000, 8000, 3, 3, 20, 2)), [("write", 0, 0x44), ("write", 0, 0x15)]]
    )
    for chip in (quiet, nosy):
        for _, address, value in program:
            chip.write(address, value)
    traces = [], []
    for n in range(300):
        for address in (0, 1, 2, 3):
            nosy.read((address + n) & 3)
        for chip, trace in zip((quiet, nosy), traces, strict=True):
            trace.extend(chip.trace(1 + n % 40).tolist())
    assert traces[0] == traces[1] != []
