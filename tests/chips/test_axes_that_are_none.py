"""Every method of a chip that takes an axis refuses one that the chip does not have.

MCX514().input_word(10**8)
Segmentation fault (core dumped)
"""

import inspect

import pytest

from stage import Stage, StageError
from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX501, MCX512, MCX514, PCL240K, PCL240MK, PCL240MS, STEPDIR

CHIPS = (PCL240K, PCL240MK, PCL240MS, MCX302, MCX304, MCX312, MCX501, MCX512, MCX514, HCTL1100, STEPDIR)
OTHERS = {
    "address": 0,
    "value": 0x11,
    "word": 0,
    "count": 0.0,
    "rate": 0.0,
    "name": "",
    "symbol": "",
    "datum": None,
    "drive": None,
}
OF_THE_CLASS = {"register_cycles", "command_cycles"}  # they need a name, too
COMMON = {"input_word", "output_word", "set_input_word"}
"""Under AXES they have the pins that are no axis', where the chip has such."""


def taking_an_axis(kind):
    """(name, arguments before the axis and behind it) of its public methods."""
    for name in sorted(n for n in dir(kind) if not n.startswith("_") and n not in OF_THE_CLASS):
        method = inspect.getattr_static(kind, name)
        if inspect.isfunction(method) and "axis" in (parameters := list(inspect.signature(method).parameters)):
            yield name, {p: OTHERS[p] for p in parameters if p not in ("self", "axis")}


@pytest.mark.parametrize("kind", CHIPS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("axis", [10**8, -1, 99, True, 0.5, "x", None])
def test_no_method_takes_an_axis_that_is_none(kind, axis):
    chip = kind()
    state, names = chip.state.tobytes(), []
    for name, others in taking_an_axis(kind):
        names.append(name)
        with pytest.raises((StageError, NotImplementedError)):
            getattr(chip, name)(axis=axis, **others)
    assert {"busy", "decoder", "input_word", "journal", "net", "output_word", "set_input_word", "set_shaft"} <= set(
        names
    )
    assert chip.state.tobytes() == state
    assert chip.open_journal is None


@pytest.mark.parametrize("kind", CHIPS, ids=lambda kind: kind.__name__)
def test_cycles_of_an_axis_that_is_none_or_of_what_is_no_name_are_refused(kind):
    """PCL240K.command_cycles(5)
    AttributeError: 'int' object has no attribute 'upper'"""
    register = kind.MAP.registers[0].name
    for axis in (-1, kind.AXES, 10**8, True, "x"):
        with pytest.raises(StageError, match="axis="):
            kind.register_cycles(register, 1, axis)
        for command in kind.MAP.commands[:1]:
            with pytest.raises(StageError, match="axis="):
                kind.command_cycles(command.symbol, axis, 1)
    for name in (5, None, b"R0", ["R0"]):
        for look_up in (lambda n: kind.register_cycles(n, 1), kind.command_cycles, kind.MAP.register, kind.MAP.command):
            with pytest.raises(StageError, match="are called by their names"):
                look_up(name)
    for value in ("x", 1.5, None):
        with pytest.raises(StageError, match=f"^value={value!r}: a whole number"):
            kind.register_cycles(register, value)
    assert kind.register_cycles(register, 1)
    assert kind.register_cycles(register.lower(), 1, kind.AXES - 1)


@pytest.mark.parametrize("kind", CHIPS, ids=lambda kind: kind.__name__)
def test_one_axis_more_has_only_the_pins_that_are_no_axis(kind):
    chip, more = kind(), kind.__name__.startswith("MCX")
    for name, others in taking_an_axis(kind):
        if name in COMMON and more:
            getattr(chip, name)(axis=kind.AXES, **others)
        else:
            with pytest.raises((StageError, NotImplementedError)):
                getattr(chip, name)(axis=kind.AXES, **others)


def test_inputs_of_an_axis_that_is_none_change_no_other_memory():
    """Stage("xyz", chips=MCX514).chips[0].set_input_word(-1, 0xFFFF)"""
    stage = Stage("xyz", chips=MCX514)
    before = stage.snapshot()
    for axis in (-1, 5, 10**8):
        with pytest.raises(StageError, match=f"axis={axis}: an MCX514 has axes 0 to 3"):
            stage.chips[0].set_input_word(axis, 0xFFFF)
        with pytest.raises(StageError, match=f"axis={axis}: the stage has axes 0 to 2"):
            stage.loop.update_switches(axis)
    assert stage.snapshot().state.tobytes() == before.state.tobytes()
