"""The contract between a stage and the cores of its chips, see stage/chips/core_interface.py."""

import random
import subprocess
import sys

import numpy as np
import pytest
from loops.rows import describe_axis
from support import nova_programs, programs, servo_programs
from support.examples import SEED

from stage.chips import CHIPS, FAMILIES, core_interface
from stage.errors import ArgumentError, StageError
from stage.native import ExportedFunction

every_chip = pytest.mark.parametrize("name", CHIPS.built_in)


@every_chip
def test_a_core_gives_every_answer_with_the_types_that_loops_call_it_by(name):
    core = CHIPS[name].CORE
    for answer, (result, *arguments) in core_interface.ANSWERS.items():
        function = getattr(core, answer)
        assert isinstance(function, ExportedFunction), answer
        assert (function.result, *function.arguments) == (result, core.STATE, *arguments), answer


@every_chip
def test_a_state_begins_with_its_clock(name):
    kind, offset = CHIPS[name].CORE.STATE.fields["clock"][:2]
    assert (kind, offset) == (np.dtype("i8"), 0)
    chip = CHIPS[name]()
    chip.advance(123)
    assert report(chip)[0] == 123


def report(chip):
    rows, out = np.zeros(1, core_interface.CHIP), np.zeros(5, np.int64)
    core_interface.fill_chip_record(rows[0], chip.CORE, chip.pointer)
    describe_axis(rows, 0, out)
    return tuple(out.tolist())


@every_chip
def test_a_chip_record_of_any_family_returns_what_its_core_returns(name):
    chip = CHIPS[name]()
    pin = next(iter(chip.INPUTS))
    setattr(chip.axes[0].pins, pin, True)
    chip.advance(1000)
    core, at = chip.CORE, chip._rows[0]
    expected = (1000, core.read_net_count(at, 0), chip.input_word(0), core.read_outputs(at, 0), core.read_status(at, 0))
    assert report(chip) == expected


def test_a_stage_loads_no_family_that_it_does_not_use():
    say = "import sys; from stage import Stage, firmware; Stage('xyz'); print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, check=True).stdout
    loaded = {name for name in FAMILIES if f"stage.chips.{name}" in out.split()}
    assert loaded == {"pcl240"}


LIKELY = (0x08, 0x10, 0x15, 0x12, 0x40, 0x44, 0x80, 0x87, 0x103, 0x104, 0x105, 0x10F, 0x120, 0x121, 0x220, 0x321)


def move(chip, pulses):
    """Start a drive on the first axis."""
    if chip.SERVO:
        servo_programs.move(chip, pulses)
    elif "nova" in chip.CORE.__name__:
        nova_programs.move(chip, pulses)
    elif "stepdir" in chip.CORE.__name__:
        for name, value in {"START": 1000, "RATE": 16_000, "STEPS": abs(pulses)}.items():
            chip.write(*chip.register_cycles(name, value)[0])
        chip.write(*chip.command_cycles("MOVE-" if pulses < 0 else "MOVE+")[0])
    else:
        programs.start_preset(chip, abs(pulses), pulses < 0)
    chip.advance(chip.clock_hz // 20)


def go_on(chip, rng, acts):
    """Make random bus cycles, pin changes and waits, and return all that the chip answered and did."""
    cls, message = type(chip), []
    for _ in range(acts):
        what = rng.integers(0, 20)
        if what < 13:
            likely = what < 5
            address = 0 if likely else rng.integers(0, cls.ADDRESSES)
            chip.write(
                address, rng.choice(LIKELY) if likely else rng.integers(0, cls.DATA_MASK + 1) >> rng.integers(0, 9)
            )
        elif what < 16:
            begin, pulses = chip.clock, chip.trace(int(rng.integers(0, 5_000)))
            message.append((pulses["clock"] - begin, pulses["axis"], pulses["direction"]))
        elif what < 19:
            message.append(chip.read(rng.integers(0, cls.ADDRESSES)))
        else:
            setattr(chip.axes[rng.integers(0, cls.AXES)].pins, rng.choice(list(cls.INPUTS)), bool(rng.integers(0, 2)))
        message.append([chip.output_word(axis) for axis in range(cls.AXES)])
    return [*message, chip.values()], np.array([chip.net(k) for k in range(cls.AXES)])


COMMANDED = {"MCX514": 0x00FF, "MCX304": 0x8000, "MCX302": 0x8000, "MCX312": 0x8000}
"""WR0 that resets."""


@pytest.mark.parametrize(
    ("name", "reset"), [*((name, CHIPS[name].reset) for name in CHIPS.built_in),
                        *((name, lambda chip, word=word: chip.write(0, word)) for name, word in COMMANDED.items())],
    ids=[*CHIPS.built_in, *(f"{name} by a command" for name in COMMANDED)],
)  # fmt: skip
def test_after_a_reset_a_chip_behaves_like_one_that_was_just_switched_on(name, reset):
    make = CHIPS[name]
    for seed in range(SEED, SEED + 4):
        print("seed", seed)
        used, other = make(), make()
        move(used, -3000)
        go_on(used, np.random.default_rng(seed), 40)
        other.advance(used.clock)
        for k in range(make.AXES):
            other.set_input_word(k, used.input_word(k))
        if make.SERVO:
            other.encoder = used.encoder
        net, diagnostics = used.net(), list(used.diagnostics)
        reset(used)
        other.reset()
        assert (used.diagnostics, used.clock) == (diagnostics, other.clock), "the clock and the diagnostics stay"
        assert net != 0 == other.net()
        assert make.SERVO or used.net() == net, "pulses made stay made"
        (mine, pulse_count), (its, its_made) = (
            go_on(chip, np.random.default_rng(seed + 1), 40) for chip in (used, other)
        )
        assert str(mine) == str(its)
        assert make.SERVO or (pulse_count - its_made)[0] == net


@every_chip
def test_the_cycles_that_write_a_register_keep_to_the_bus(name):
    """chip.register_cycles("R2", 8000)"""
    chip = CHIPS[name]()
    axis = chip.AXES - 1
    for register in chip.MAP.registers:
        if "W" in register.access:
            cycles = chip.register_cycles(register.name, register.range[1], axis)
            assert cycles, register.name
            assert all(0 <= address < chip.ADDRESSES and datum <= chip.DATA_MASK for address, datum in cycles)
            assert cycles == CHIPS[name].register_cycles(register.name.lower(), register.range[1], axis)


@every_chip
def test_every_command_of_a_chip_is_sent_as_its_listener_hears_it(name):
    """chip.command_cycles("DRVRL", axis=2): the words of the map, and the axis' name, come back from the bus"""
    make = CHIPS[name]
    axis, chip = make.AXES - 1, make()
    listener = chip.make_describer()
    for command in make.MAP.commands:
        takes = command.choice or (command.bytes if "read" not in command.kind else 0)
        cycles = make.command_cycles(command.symbol.lower(), axis, 1 if takes else None)
        message = [listener.write(*cycle) for cycle in cycles][-1]
        assert command.title in message or command.symbol.removeprefix("R-") in message, (command.symbol, message)
        assert not command.axes or make.AXES == 1 or message.startswith("XYZU"[axis]), message
    for word in make.MAP.words:
        if word.is_written:
            for bits in (*word.sends, (1 << word.fields[-1].high + 1) - 1):
                address, datum = make.command_cycles(word.name, axis, bits)[-1]
                assert (address, datum & bits) == (word.address, bits)
                assert datum <= make.DATA_MASK


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("MCX514", ("DRVR",), "unknown MCX514 command 'DRVR'. Did you mean 'DRVRL'"),
        ("MCX514", ("DV",), "DV takes 32 bits of data: drive speed; none was given"),
        ("MCX514", ("DRVRL", 0, 3), "takes no data, and 3 was given"),
        ("MCX514", ("SYNCEN", 0, 16), "choose among SYNC0, SYNC1, SYNC2, SYNC3; 16 was given"),
        ("MCX514", ("SYNCEN", 0, 0), "one of them at least; 0 was given"),
        ("PCL240K", ("operate", 0, 256), "takes 8 bits: operating mode selection.*256 was given"),
        ("HCTL1100", ("mode", 0, 1.5), "1.5 was given"),
    ],
)
def test_a_command_that_is_none_or_whose_datum_does_not_fit_is_refused(name, arguments, message):
    with pytest.raises(ArgumentError, match=message):
        CHIPS[name].command_cycles(*arguments)


@pytest.mark.parametrize("name", [name for name in CHIPS.built_in if not CHIPS[name].SERVO])
def test_the_values_of_an_axis_are_those_that_were_written_to_it_and_to_no_other(name):
    """chip.axis_values(axis): also of registers that no host can read; looking changes nothing"""
    chip, written = CHIPS[name](), {}
    axis = chip.AXES - 1
    for register in chip.MAP.registers:
        if register.access != "R" and not register.fields:
            written[register.name] = register.range[1] // 3 + 1
            for cycle in chip.register_cycles(register.name, written[register.name], axis):
                chip.write(*cycle)
    before = chip.state.tobytes()
    values_of_axis, there = chip.axis_values(axis), chip.axis_values(0)
    assert chip.state.tobytes() == before
    written.pop("TX", None)  # what is read under this name is the longest way of the segment that runs
    displayed = {k: v for k, v in values_of_axis.items() if k in written}
    assert displayed == {k: v for k, v in written.items() if k in displayed}
    assert len(displayed) >= len(written) - 2, "EM and SM of the MCX314As are kept as what they mean"
    assert axis == 0 or values_of_axis != there
    with pytest.raises(ArgumentError, match="axis"):
        chip.axis_values(chip.AXES)


def test_a_chip_of_a_stage_is_restored_with_its_stage(xy):
    """stage.chips[0].restore(snapshot): the machine and the other chips would be at another time"""
    chip = xy.chips[0]
    with pytest.raises(StageError, match="belongs to a stage: restore the stage"):
        chip.restore(chip.snapshot())


def test_a_restored_chip_has_the_diagnostics_of_its_snapshot():
    chip = CHIPS["PCL240K"]()
    chip.write(0, 0x15)  # a start without a rate
    diagnostics = list(chip.diagnostics)
    assert diagnostics
    before = chip.snapshot()
    chip.reset()
    chip.write(0, 0x15)
    assert len(chip.diagnostics) > len(diagnostics)
    chip.restore(before)
    assert chip.diagnostics == diagnostics


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_a_chip_ignores_address_and_data_bits_beyond_its_lines(name):
    """chip.write(0x40, 0x108) of a PCL-240 is chip.write(0, 8)"""
    near, remote, draw = CHIPS[name](), CHIPS[name](), random.Random(1)
    beyond, full = near.ADDRESS_MASK + 1, near.DATA_MASK + 1
    local, forwarded = near.make_describer(), remote.make_describer()
    for _ in range(150):
        address, value = draw.randrange(beyond), draw.randrange(full)
        assert local.write(address, value) == forwarded.write(address, value + full)
        assert local.read(address, value) == forwarded.read(address, value + full)
        near.write(address, value)
        remote.write(address + beyond * draw.randrange(3), value + full * draw.randrange(3))
        assert near.read(address) == remote.read(address + beyond)
    assert near.state.tobytes() == remote.state.tobytes()
    message = [
        [(d.address, d.value, d.message) for d in chip.diagnostics if "acts as" not in d.message]
        for chip in (near, remote)
    ]
    assert message[0] == message[1]
