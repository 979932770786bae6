"""The contract between a stage and the cores of its chips, see stage/chips/cores.py."""

import subprocess
import sys

import numpy as np
import pytest
from loops.rows import told

from stage.chips import CHIPS, FAMILIES, cores
from stage.native import Exported

every_chip = pytest.mark.parametrize("name", CHIPS)


@every_chip
def test_a_core_gives_every_answer_with_the_types_that_loops_call_it_by(name):
    core = CHIPS[name].CORE
    for answer, (result, *arguments) in cores.ANSWERS.items():
        function = getattr(core, answer)
        assert isinstance(function, Exported), answer
        assert (function.result, *function.arguments) == (result, core.STATE, *arguments), answer


@every_chip
def test_a_state_begins_with_its_clock(name):
    kind, offset = CHIPS[name].CORE.STATE.fields["clock"][:2]
    assert (kind, offset) == (np.dtype("i8"), 0)
    chip = CHIPS[name]()
    chip.advance(123)
    assert tell(chip)[0] == 123


def tell(chip):
    rows, out = np.zeros(1, cores.CHIP), np.zeros(5, np.int64)
    cores.fill(rows[0], chip.CORE, chip._at)
    told(rows, 0, out)
    return tuple(out.tolist())


@every_chip
def test_a_loop_is_told_by_a_row_of_any_family_what_the_core_says_itself(name):
    chip = CHIPS[name]()
    pin = next(iter(chip.INPUTS))
    setattr(chip.axes[0].pins, pin, True)
    chip.advance(1000)
    core, at = chip.CORE, chip._rows[0]
    expected = (1000, core.net(at, 0), chip.INPUTS[pin], core.outputs(at, 0), core.status(at, 0))
    assert tell(chip) == expected


def test_a_stage_loads_no_family_that_it_does_not_use():
    say = "import sys; from stage import Stage, firmware; Stage('xyz'); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, check=True).stdout
    loaded = {name for name in FAMILIES if f"stage.chips.{name}" in out.split()}
    assert loaded == {"pcl240"}
