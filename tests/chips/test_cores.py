"""The contract between a stage and the cores of its chips, see stage/chips/cores.py."""

import subprocess
import sys

import numpy as np
import pytest

from stage import Stage, engine
from stage.chips import CHIPS, FAMILIES, HCTL1100, MCX304, PCL240K, cores
from stage.compiled import COMPILED, hot
from stage.sealed import Sealed

every_chip = pytest.mark.parametrize("name", CHIPS)


@every_chip
def test_a_core_gives_every_answer_with_the_types_that_loops_call_it_by(name):
    core = CHIPS[name].CORE
    for answer, (result, *arguments) in cores.ANSWERS.items():
        function = getattr(core, answer)
        assert isinstance(function, Sealed), answer
        assert (function.result, *function.arguments) == (result, core.STATE, *arguments), answer


@every_chip
def test_a_state_begins_with_its_clock(name):
    kind, offset = CHIPS[name].CORE.STATE.fields["clock"][:2]
    assert (kind, offset) == (np.dtype("i8"), 0)
    chip = CHIPS[name]()
    chip.advance(123)
    assert told(row(chip), 0)[0] == 123


def row(chip):
    rows = np.zeros(1, cores.CHIP)
    cores.fill(rows[0], chip.CORE, chip._at)
    return rows


@hot
def told(rows, axis):
    c = rows[0]
    return cores.clock(c), cores.net(c, axis), cores.inputs(c, axis), cores.outputs(c, axis), cores.status(c, axis)


@every_chip
def test_a_loop_is_told_by_a_row_of_any_family_what_the_core_says_itself(name):
    chip = CHIPS[name]()
    pin = next(iter(chip.INPUTS))
    setattr(chip.axes[0].pins, pin, True)
    chip.advance(1000)
    core, at = chip.CORE, chip._rows[0]
    expected = (1000, core.net(at, 0), chip.INPUTS[pin], core.outputs(at, 0), core.status(at, 0))
    assert told(row(chip), 0) == expected


@pytest.mark.skipif(not COMPILED, reason="counts what is compiled")
def test_the_loops_are_compiled_once_for_all_chips():
    for chips in (PCL240K, MCX304, HCTL1100, {"x": HCTL1100, "y": PCL240K, "z": MCX304}):
        Stage("xyz", chips=chips, visuals=False).run(0.001)
    assert len(engine.run.overloads) <= 1
    assert len(told.overloads) <= 1


def test_a_stage_loads_no_family_that_it_does_not_use():
    say = "import sys; from stage import Stage, firmware; Stage('xyz'); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, check=True).stdout
    loaded = {name for name in FAMILIES if f"stage.chips.{name}" in out.split()}
    assert loaded == {"pcl240"}
