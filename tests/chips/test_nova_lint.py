"""Diagnostics of the NOVA chips: each rule that a host breaks is named, and correct writes pass."""

import random
import re

import pytest
from reference.nova_profile import SECOND
from support.covers import covers
from support.nova_bench import command, load, put

from stage.chips import MCX304, MCX514
from stage.chips.nova import lint
from stage.chips.nova.registers.mcx300 import MCX302_MAP, MCX304_MAP, MCX312_MAP
from stage.chips.nova.registers.mcx514 import COORDINATE_RANGE_PULSES, MCX501_MAP, MCX514_MAP

MIN_TP, MAX_TP = COORDINATE_RANGE_PULSES
X, Y, Z, U = 0x100, 0x200, 0x400, 0x800
MAPS = (MCX514_MAP, MCX304_MAP, MCX302_MAP, MCX312_MAP)
every_chip = pytest.mark.parametrize("chip", MAPS, ids=lambda m: m.chip)


class Contents:
    """Contents of a chip before a write, as the lint reads them; a mask of axes has bit 0 for X."""

    command_data = driving_axes = relative_drive_axes = absolute_drive_axes = interpolated_axes = multichip_role = (
        helix_ticks
    ) = 0
    has_unused_data = is_interpolating = is_queue_full = is_loading_pattern = is_wired_to_other_chips = (
        has_master_started
    ) = False
    drive_speeds = tp_values = ()

    def __init__(self, **contents):
        vars(self).update(contents)

    def find_axes_of_interpolation(self, command):
        return self.interpolated_axes

    def find_refused_axes(self, value):
        return {}


def find(chip, value, address=0, **contents):
    """Return key -> message of the diagnostics of a write."""
    findings = list(lint.lint_write(chip, Contents(**contents), address, value))
    assert all(rule.source and message for rule, message in findings)
    return {rule.key: message for rule, message in findings}


def text(chip, value, address=0, **contents):
    """Return the messages of a write, or ""."""
    return "; ".join(find(chip, value, address, **contents).values())


def data(value):
    return {"command_data": value, "has_unused_data": True}


# a write, what the chip holds, and what is said of it; then a write next to it that is right
WRONG_WRITES = [
    ("a code that is no command", MCX514_MAP, X | 0x1C, {}, "1Ch is no command of the MCX514", X | 0x1F, {}),
    ("a sync command that chooses no set", MCX514_MAP, X | 0x80, {}, "80h is no command", X | 0x81, {}),
    ("reserved bits of WR0", MCX514_MAP, 0x9050 | X, {}, "bits 15 and 12 must be 0", X | 0x50, {}),
    ("reserved bits of WR0 beside the reset", MCX304_MAP, 0x1020 | X, {}, "bit 12 must be 0", 0x8000, {}),
    ("a reset with more", MCX304_MAP, 0x8020, {}, "resets the chip: leave bit 5 0", 0x8000, {}),
    ("no axis", MCX514_MAP, 0x50, {}, r"50h \(relative position drive\) needs axis bits and has none", X | 0x50, {}),
    ("an axis that is absent", MCX302_MAP, X | U | 0x20, {}, "to U: the MCX302 has 2 axes", X | Y | 0x20, {}),
    ("axes for TX", MCX514_MAP, X | 0x19, data(5), "carries no axis bits: X given", 0x19, data(5)),
    ("axes for HLN", MCX514_MAP, X | Y | 0x1A, data(5), "carries no axis bits: X, Y given", 0x1A, data(5)),
    ("axes for IPM", MCX514_MAP, X | 0x2A, data(3), "carries no axis bits", 0x2A, data(3)),
    ("axes for an interpolation", MCX514_MAP, X | 0x61, {"interpolated_axes": 3}, "carries no axis bits", 0x61,
     {"interpolated_axes": 3}),
    ("axes for an interpolation of the MCX312", MCX312_MAP, Y | 0x30, {"interpolated_axes": 3}, "carries no axis bits", 0x30,
     {"interpolated_axes": 3}),
    ("an interpolation of a chip that has none", MCX304_MAP, 0x30, {}, "30h is no command of the MCX304", X | 0x20, {}),
    ("a reading code to write with", MCX514_MAP, X | 0x30, data(7), "takes no data: what was written to WR6", X | 0x09, data(7)),
    ("a reading code to write with on the MCX304", MCX304_MAP, X | 0x10, data(7), "takes no data", X | 0x09, data(7)),
    ("a reading of several axes", MCX514_MAP, X | Y | 0x30, {}, "reads one axis: of X, Y only the first", Y | 0x30, {}),
    ("JK above its range", MCX514_MAP, X, data(1_073_741_824), "JK = 1073741824: jerk takes 1 to 1073741823", X, data(1)),
    ("DV of 0", MCX514_MAP, X | 0x05, data(0), "DV = 0: .* takes 1 to 8000000", X | 0x05, data(8_000_000)),
    ("a drive with TP below its range", MCX514_MAP, X | 0x50, {"tp_values": (-2_147_483_647, 0, 0, 0)},
     r"50h \(relative position drive\) with TP = -2147483647 of X: drive pulse number takes -2147483646 to 2147483646", X | 0x50,
     {"tp_values": (-2_147_483_646, -2_147_483_647, 0, 0)}),
    ("an absolute drive with TP above its range", MCX501_MAP, 0x54, {"tp_values": (2_147_483_647,)},
     "with TP = 2147483647 of X",
     0x52, {"tp_values": (2_147_483_647,)}),
    ("TP below its range in a drive", MCX514_MAP, Y | 0x06,
     {**data(-2_147_483_648), "relative_drive_axes": 2, "tp_values": (0, -5, 0, 0)},
     "TP = -2147483648 while driving: drive pulse number takes", Y | 0x06,
     {**data(-2_147_483_646), "relative_drive_axes": 2, "tp_values": (0, -5, 0, 0)}),
    ("a helix with more pulses along its axis than ticks", MCX514_MAP, 0x69,
     {"interpolated_axes": 0b1101, "tp_values": (0, 0, 0, -333), "helix_ticks": 283},
     "with TP = -333 of U: the 283 ticks of HLV make one pulse each at most; the other 50 are lost", 0x6A,
     {"interpolated_axes": 0b1101, "tp_values": (900, 0, 900, -283), "helix_ticks": 283}),
    ("LX above its range", MCX514_MAP, X | 0x0E, data(0x8000_0000), "LX = 2147483648", X | 0x0E, data(0xFFFF_FFFF)),
    ("CP below its range", MCX514_MAP, X | 0x08, data(-1_073_741_824), "CP = -1073741824", X | 0x08, data(-1_073_741_823)),
    ("a split pulse of width 0", MCX514_MAP, X | 0x17, data(0x0000_0005), "WIDTH = 0", X | 0x17, data(0x0001_0005)),
    ("a split pulse of length 1", MCX514_MAP, X | 0x17, data(0x0001_0001), "CYCLE = 1", X | 0x17, data(0x0001_0002)),
    ("an action that does not exist", MCX514_MAP, X | 0x26, data(0x19 << 4), "ACT = 25", X | 0x26, data(0x18 << 4)),
    ("the filter of EMG on another axis than X", MCX514_MAP, Y | U | 0x25, data(0x0F01),
     r"FLM = 0F01h to Y, U: FE0 \(filter of EMG\) acts on X only", X | Y | 0x25, data(0x0F01)),
    ("a mode bit that does not exist", MCX514_MAP, 0x2A, data(0x2023), "IPM = 2023h: it has no bits 13 and 5", 0x2A, data(3)),
    ("R below its range", MCX304_MAP, X, data(15_999), "R = 15999: .* takes 16000 to 8000000", X, data(16_000)),
    ("V above its range", MCX304_MAP, X | 0x05, data(8001), "V = 8001: .* takes 1 to 8000", X | 0x05, data(8000)),
    ("a drive while driving", MCX514_MAP, X | Y | 0x52, {"driving_axes": 2}, r"while Y is driving \(n-DRV = 1\)", X | 0x52,
     {"driving_axes": 2}),
    ("a home search while driving", MCX304_MAP, X | 0x62, {"driving_axes": 1}, "while X is driving", X | 0x26,
     {"driving_axes": 1}),
    ("TP in absolute driving", MCX514_MAP, X | 0x06, {**data(9), "absolute_drive_axes": 1},
     "in absolute position driving: it cannot",
     Y | 0x06, {**data(9), "absolute_drive_axes": 1}),
    ("TP the other way", MCX514_MAP, Y | 0x06, {**data(-9), "relative_drive_axes": 2, "tp_values": (0, 5, 0, 0)},
     "TP = -9 while Y drives",
     Y | 0x06, {**data(0), "relative_drive_axes": 2, "tp_values": (0, 5, 0, 0)}),
    ("a continuous interpolation above 4 Mpps", MCX514_MAP, 0x61,
     {"interpolated_axes": 6, "is_interpolating": True, "drive_speeds": (1, 4_000_001, 1, 1)}, "with DV = 4000001: 4000000 is",
     0x61,
     {"interpolated_axes": 6, "is_interpolating": True, "drive_speeds": (5_000_000, 4_000_000, 5_000_000, 1)}),
    ("DV above 4 Mpps in a continuous interpolation", MCX514_MAP, X | 0x05,
     {**data(4_000_001), "interpolated_axes": 3, "is_interpolating": True}, "DV = 4000001 in continuous interpolation", X | 0x05,
     {**data(4_000_000), "interpolated_axes": 3, "is_interpolating": True}),
    ("a speed beyond that of continuous interpolation, of another axis", MCX514_MAP, X | 0x05,
     {**data(4_000_001), "interpolated_axes": 3, "is_interpolating": True}, "DV = 4000001 in continuous interpolation", Y | 0x05,
     {**data(4_000_001), "interpolated_axes": 3, "is_interpolating": True}),
    ("an interpolation with too many axes", MCX514_MAP, 0x61, {"interpolated_axes": 7}, "with 3 axes chosen: X, Y, Z", 0x62,
     {"interpolated_axes": 7}),
    ("an interpolation without axes", MCX514_MAP, 0x64, {}, "with 0 axes chosen", 0x64, {"interpolated_axes": 0b1010}),
    ("an interpolation while an axis drives", MCX514_MAP, 0x61, {"interpolated_axes": 3, "driving_axes": 2},
     "while Y is driving", 0x61,
     {"interpolated_axes": 3, "driving_axes": 4}),
    ("a segment too many", MCX514_MAP, 0x61,
     {"interpolated_axes": 3, "is_interpolating": True, "driving_axes": 3, "is_queue_full": True},
     "pre-buffer is full", 0x61, {"interpolated_axes": 3, "is_interpolating": True, "driving_axes": 3}),
    ("a finish point of 32 bits", MCX514_MAP, 0x61, {"interpolated_axes": 3, "tp_values": (0, 1_073_741_824, 0, 0)},
     "TP = 1073741824 of Y",
     0x66, {"interpolated_axes": 3, "tp_values": (0, 0x7FFF_FFFF, 0, 0)}),
    ("a finish point of 32 bits, to plus", MCX514_MAP, 0x61, {"interpolated_axes": 3, "tp_values": (1_073_741_824, 0, 0, 0)},
     "TP = 1073741824 of X", 0x61,
     {"interpolated_axes": 3, "tp_values": (MAX_TP, MIN_TP, MIN_TP - 1, 0)}),
    ("a finish point of 32 bits, to minus", MCX514_MAP, 0x61,
    {"interpolated_axes": 3, "tp_values": (MIN_TP - 1, 0, 0, 0)},
     f"TP = {MIN_TP - 1} of X", 0x61,
     {"interpolated_axes": 2 | 4, "tp_values": (MAX_TP + 1, MIN_TP, MAX_TP, 0)}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("chip", "value", "previous", "message", "right", "right_held"),
    [m[1:] for m in WRONG_WRITES],
    ids=[m[0] for m in WRONG_WRITES],
)
def test_a_wrong_write_has_a_diagnostic_and_the_right_write_has_none(chip, value, previous, message, right, right_held):
    assert re.search(message, text(chip, value, **previous)), text(chip, value, **previous)
    assert text(chip, right, **right_held) == ""


@pytest.mark.parametrize(
    ("chip", "address", "value", "message"),
    [
        (MCX514_MAP, 3, 0x8000, "WR3 = 8000h: the MCX514 has no bit 15 there"),
        (MCX304_MAP, 2, 0x0C00, "WR2 = 0C00h: PIND = 3"),
        (MCX304_MAP, 5, 0x0001, "WR5 = 0001h: the MCX304 has no bit 0 there"),
        (MCX302_MAP, 4, 0xFF00, "has no bits 15 and 14 and 13 and 12 and 11 and 10 and 9 and 8 there"),
        (MCX312_MAP, 5, 0x0008, "WR5 = 0008h: AX2 = 2"),
    ],
    ids=[
        "a bit of WR3",
        "an invalid division",
        "WR5 without interpolation",
        "outputs of absent axes",
        "an absent axis",
    ],
)
def test_bits_that_a_register_does_not_have_are_named(chip, address, value, message):
    assert message in text(chip, value, address)


def test_wr2_to_wr5_take_anything_while_they_are_bp_registers():
    for address in range(2, 6):
        assert text(MCX312_MAP, 0xFFFF, address, is_loading_pattern=True) == ""
    assert text(MCX312_MAP, 0x0C00, 2) != ""


def test_a_write_that_breaks_several_rules_has_a_diagnostic_of_each():
    """WR0 with a reserved bit and a command of an absent axis; a mode with bits that are not there and a field out of range."""
    assert list(find(MCX302_MAP, 0x1000 | X | U | 0x20, driving_axes=1)) == [
        "reserved-bits",
        "absent-axes",
        "already-driving",
    ]
    drive = {"driving_axes": 1, "tp_values": (-2_147_483_647, 0, 0, 0)}
    assert list(find(MCX514_MAP, X | 0x50, **drive)) == ["already-driving", "pulse-number"]
    line = {"interpolated_axes": 7, "driving_axes": 2, "tp_values": (0, MAX_TP + 1, 0, 0)}
    assert list(find(MCX514_MAP, 0x61, **line)) == ["number-of-axes", "axis-drives", "finish-point-range"]
    assert list(find(MCX312_MAP, 0x0208, 5)) == ["field-range"], "AX2 = 2"
    assert list(find(MCX312_MAP, 0x2208, 5)) == ["unused-bits", "field-range"]


@every_chip
def test_every_command_with_legal_data_to_one_resting_axis_passes(chip):
    for c in chip.commands:
        previous = {"interpolated_axes": {1: 1, 3: 7, 4: 15}.get((c.together or (2,))[0], 3)}
        if c.kind in ("data write", "mode write"):
            r = chip.register(c.symbol)
            lows = sum(f.legal[0] << f.low for f in r.fields if f.legal)
            previous |= data(r.legal[0] if r.legal else lows)
        for code in c.codes:
            assert text(chip, code | (X if c.axes else 0), **previous) == "", c


@every_chip
def test_no_write_raises_and_every_diagnostic_has_a_message_and_a_section(chip):
    seed = random.randrange(2**32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    for _ in range(3000):
        contents = {
            name: rng.getrandbits(4)
            for name in ("driving_axes", "relative_drive_axes", "absolute_drive_axes", "interpolated_axes")
        }
        names = (
            "has_unused_data",
            "is_interpolating",
            "is_queue_full",
            "is_loading_pattern",
            "is_wired_to_other_chips",
            "has_master_started",
        )
        contents |= {name: rng.random() < 0.5 for name in names}
        contents |= {"command_data": rng.getrandbits(32), "role": rng.randrange(4), "helix_ticks": rng.randrange(4000)}
        contents["drive_speeds"] = [rng.getrandbits(24) for _ in range(4)]
        contents["tp_values"] = [rng.getrandbits(32) - 2**31 for _ in range(4)]
        find(chip, rng.getrandbits(16), rng.choice((0, 0, 0, rng.randrange(8))), **contents)


@every_chip
def test_every_parameter_takes_the_ends_of_its_range_and_nothing_beyond(chip):
    looked = 0
    for c in chip.commands:
        r = chip.register(c.symbol) if c.kind == "data write" else None
        if r is None or r.legal is None or r.fields or r.name == "TP":  # of a bit pattern TP takes any number
            continue
        looked += 1
        low, high = r.legal
        word, name = c.code | (X if c.axes else 0), f"{r.name} = "
        for value in (low, high, *r.also):
            assert not text(chip, word, **data(value)).startswith(name), (r.name, value)
        for value in (low - 1, high + 1):
            if r.value(value & r.mask) == value:  # it fits the register
                assert text(chip, word, **data(value)).startswith(name), (r.name, value)
    assert looked >= 8


def test_reading_a_parameter_has_no_diagnostic_unless_data_was_written_for_it():
    """R-LP, a data reading command, takes nothing from WR6 and WR7."""
    chip = MCX514()
    chip.write(0, 0x0130)
    assert list(chip.diagnostics) == []
    chip.write(6, 1234)
    chip.write(0, 0x0130)
    assert len(chip.diagnostics) == 1


@pytest.mark.parametrize(("make", "word", "enable", "drive"), [(MCX514, 2, 0x08, 0x52), (MCX304, 1, 0x08, 0x22)])
def test_a_drive_that_an_active_stop_input_ends_at_once_has_a_diagnostic(make, word, enable, drive):
    for active, enabled, notes in ((True, enable, 1), (True, 0, 0), (False, enable, 0)):
        chip = make()
        chip.axes[0].pins.stop1 = active
        chip.write(0, X | 0x1F if make is MCX514 else X | 0x0F)
        chip.write(word, enabled)
        chip.write(0, X | drive)
        assert len(chip.diagnostics) == notes
        assert all("starts no drive: X: STOP1 is active and enabled" in d.message for d in chip.diagnostics)


@covers("MCX514", "TP", "BHK2")
@pytest.mark.parametrize("bits", [0x8000_0000, 0x8000_0001, 0x7FFF_FFFF, 0xFFFF_FFFF, 0xAAAA_5555])
def test_any_32_bits_are_data_of_a_bit_pattern(bits):
    """Data sheet 7.2.7: the upper 16 bits are those of the - direction. 80000000h was called a wrong number of pulses."""
    chip = MCX514()
    load(chip, SV=10_000, DV=10_000)
    load(chip, IPM=3)
    for axis, value in ((1, bits), (2, 0x0000_FFFF)):
        put(chip, 0x06, value, axis)
    command(chip, 0x66, 0)
    chip.advance(SECOND)
    assert chip.diagnostics == []
    plus, minus = bits & 0xFFFF, bits >> 16
    ends = [k for k in range(16) if plus >> k & minus >> k & 1]
    steps = range(ends[0] if ends else 16)
    assert chip.net(0) == sum((plus >> k & 1) - (minus >> k & 1) for k in steps)
    assert chip.net(1) == len(steps)
