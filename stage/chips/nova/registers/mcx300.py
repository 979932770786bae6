"""Register maps of the NOVA MCX304, MCX302 and MCX312 as data: one table, with the chips that have each row.

Sources: NOVA's failure notice of 2006 (data sheet), working drivers, the manuals from memory; mcx300_words.py has the bits.
Statements without a source are marked I, as are all values after reset but AO's [C]. m is the multiple, 8,000,000 / R.
"""

from __future__ import annotations

from dataclasses import replace

from stage.chips.nova.registers.mcx300_words import EM, HM, list_mcx314as_words, list_words
from stage.chips.register_map import ChipCommand, Register, RegisterMap, make_read_command, make_write_command

UNIT_MULTIPLE_RANGE = 8_000_000
"""Value of the range register R for which the multiple is 1."""
SPEED, CURVE = (1, 8000), (1, 65535)
RESET = 0x8000
"""Value of WR0 that resets the chip."""
CHIPS = ("MCX304", "MCX302", "MCX312")
INTERPOLATING_CHIP_NAMES = ("MCX312",)
NO_SYNC_ACTION_TEXT = "no synchronous action comes"


def _make_speed_register(code: int, name: str, title: str, note: str, legal: tuple[int, int] = SPEED) -> Register:
    """Return a register for a speed in multiples of R."""
    return Register(name, code, 16, "W", title, legal, evidence="C", reset=1, note=note)


def _make_position_register(
    code: int, name: str, title: str, note: str = "", access: str = "W", evidence: str = "C", signed: bool = True
) -> Register:
    """Return a 32-bit register for a position or a number of pulses."""
    return Register(name, code, 32, access, title, evidence=evidence, unit="pulses", signed=signed, reset=0, note=note)


PARAMETERS = (
    Register(
        "R",
        0x00,
        32,
        "W",
        "range",
        (16_000, UNIT_MULTIPLE_RANGE),
        evidence="C",
        reset=UNIT_MULTIPLE_RANGE,
        note=f"m = {UNIT_MULTIPLE_RANGE} / R",
    ),
    _make_speed_register(0x01, "K", "jerk", "62500000 m / K pps/s2", CURVE),
    _make_speed_register(0x02, "A", "acceleration", "125 m A pps/s"),
    _make_speed_register(0x03, "D", "deceleration", "125 m D pps/s, used with DSNDE"),
    _make_speed_register(0x04, "SV", "initial speed", "m SV pps"),
    _make_speed_register(0x05, "V", "drive speed", "m V pps; can be changed while driving"),
    _make_position_register(
        0x06, "P", "output pulses", "in interpolation the finish point, signed", evidence="M", signed=False
    ),
    _make_position_register(0x07, "DP", "manual deceleration point", "used with MANLD", signed=False),
    _make_position_register(0x08, "C", "circular center", "relative", evidence="M"),
    _make_position_register(0x09, "LP", "logical position counter", access="RW"),
    _make_position_register(0x0A, "EP", "real position counter", access="RW"),
    _make_position_register(0x0B, "CP", "COMP+", "compared with the counter, software limit +"),
    _make_position_register(0x0C, "CM", "COMP-", "compared with the counter, software limit -"),
    Register(
        "AO", 0x0D, 16, "W", "acceleration counter offset", (-32768, 32767), (), "C", "pulses", signed=True, reset=8
    ),
    _make_speed_register(0x0E, "L", "deceleration increasing rate", "62500000 m / L pps/s2, used with DSNDE", CURVE),
    HM,
    _make_speed_register(0x61, "HV", "home search speed", "m HV pps"),
)
READ_ONLY_REGISTERS = (
    Register("CV", 0x12, 16, "R", "current speed", evidence="C", note="m CV pps"),
    Register("CA", 0x13, 16, "R", "current acceleration / deceleration", evidence="C", note="125 m CA pps/s"),
)
"""Registers that a host can only read."""
INTERPOLATION_REGISTERS = ("C", "L")
"""Registers that only interpolating chips have."""


def _make_drive_command(code: int, symbol: str, title: str, starts: bool = False) -> ChipCommand:
    """Return a command that drives axes."""
    return ChipCommand(code, symbol, title, "drive", evidence="C", starts=starts)


def _make_interpolation_command(code: int, symbol: str, title: str, note: str = "") -> ChipCommand:
    """Return an interpolation command, which is not sent to axes."""
    return ChipCommand(code, symbol, title, "interpolation", evidence="C", axes=False, note=note)


def _make_segment_command(code: int, symbol: str, title: str, points: bool = True) -> ChipCommand:
    """Return the command of a segment of the two axes that WR5 selects."""
    return replace(_make_interpolation_command(code, symbol, title), starts=True, together=(2,), points=points)


_BY_NAME = {r.name: r for r in PARAMETERS}
COMMANDS = (
    *(make_write_command(r) for r in PARAMETERS if r.number < 0x0F),
    ChipCommand(0x0F, "NOP", "axis selection only", "other", evidence="C"),
    make_read_command(_BY_NAME["LP"], 0x10),
    make_read_command(_BY_NAME["EP"], 0x11),
    *(make_read_command(r) for r in READ_ONLY_REGISTERS),
    _make_drive_command(0x20, "F_DRV_P", "+ direction fixed pulse drive", True),
    _make_drive_command(0x21, "F_DRV_M", "- direction fixed pulse drive", True),
    _make_drive_command(0x22, "C_DRV_P", "+ direction continuous drive", True),
    _make_drive_command(0x23, "C_DRV_M", "- direction continuous drive", True),
    _make_drive_command(0x24, "START_HOLD", "drive start hold"),
    _make_drive_command(0x25, "START_FREE", "drive start hold release, and end status clear"),
    _make_drive_command(0x26, "STOP_DEC", "decelerating stop"),
    _make_drive_command(0x27, "STOP_SUDDEN", "sudden stop"),
    _make_segment_command(0x30, "IP_2ST", "2-axis linear interpolation"),
    _make_segment_command(0x32, "IP_CW", "CW circular interpolation"),
    _make_segment_command(0x33, "IP_CCW", "CCW circular interpolation"),
    _make_segment_command(0x34, "IP_2BP", "2-axis bit pattern interpolation", points=False),
    _make_interpolation_command(0x36, "BP_ENABLED", "BP register write enable", "WR2 to WR5 are BP1P to BP2M"),
    _make_interpolation_command(0x37, "BP_DISABLED", "BP register write disable"),
    _make_interpolation_command(0x38, "BP_STACK", "BP data stack"),
    _make_interpolation_command(0x39, "BP_CLR", "BP data clear"),
    _make_interpolation_command(0x3A, "IP_1STEP", "interpolation single step"),
    _make_interpolation_command(0x3B, "IP_DEC_VALID", "interpolation decelerates at the end"),
    _make_interpolation_command(0x3C, "IP_DEC_INVALID", "interpolation does not decelerate at the end"),
    _make_interpolation_command(0x3D, "IP_INTRPT_CLR", "interpolation interrupt clear"),
    make_write_command(HM, "mode write"),
    make_write_command(_BY_NAME["HV"]),
    _make_drive_command(0x62, "HOME_EXEC", "automatic home search", True),
    ChipCommand(0x63, "DEVCTR_CLR", "deviation counter clear output", "other", evidence="C"),
)


def find_chips_with(row: Register | ChipCommand) -> tuple[str, ...]:
    """Return the names of the chips of the family that have a register or command."""
    name = row.symbol if isinstance(row, ChipCommand) else row.name
    only = name in INTERPOLATION_REGISTERS or (isinstance(row, ChipCommand) and row.kind == "interpolation")
    return INTERPOLATING_CHIP_NAMES if only else CHIPS


def _make_register_map(chip: str, axes: int) -> RegisterMap:
    """Return the register map of the MCX304, MCX302 or MCX312."""
    interpolates = chip in INTERPOLATING_CHIP_NAMES
    return RegisterMap(
        chip,
        f"NOVA {chip} pulse generator{' with interpolation' if interpolates else ''}, {axes} axes, 16-bit bus",
        "failure notice of 2006-11-21 (data sheet); working drivers; names from NOVA's MC8000P library and from memory",
        tuple(r for r in (*PARAMETERS, *READ_ONLY_REGISTERS) if chip in find_chips_with(r)),
        list_words(axes, interpolates),
        tuple(c for c in COMMANDS if chip in find_chips_with(c)),
        axes,
    )


MCX304_MAP = _make_register_map("MCX304", 4)
MCX302_MAP = _make_register_map("MCX302", 2)
MCX312_MAP = _make_register_map("MCX312", 2)


def _make_mcx314as_map() -> RegisterMap:
    """Return the map of the MCX314As: that of an MCX312 for four axes, with lines of three axes, EM in place of HM, and SYNC."""
    registers = tuple(EM if r.name == "HM" else r for r in (*PARAMETERS, *READ_ONLY_REGISTERS))
    sync = Register("SM", 0x64, 32, "W", "synchronous actions", None, (), "C", reset=0)
    buffer = Register("BR", 0x14, 32, "R", "synchronous action buffer", evidence="C")
    more = (
        _make_segment_command(0x31, "IP_3ST", "3-axis linear interpolation"),
        _make_segment_command(0x35, "IP_3BP", "3-axis bit pattern interpolation", points=False),
        make_write_command(EM, "mode write"),
        replace(make_write_command(sync, "mode write"), lacking=f"not modeled (its bits are not known): {NO_SYNC_ACTION_TEXT}"),
        replace(make_read_command(buffer), lacking=f"not modeled: it reads 0, as {NO_SYNC_ACTION_TEXT}"),
        ChipCommand(0x65, "SYNC_ACT", "synchronous action activation", "other", evidence="C",
        lacking=f"not modeled: {NO_SYNC_ACTION_TEXT}"),
    )  # fmt: skip
    three = {"IP_3ST", "IP_3BP"}
    found = [*(c for c in COMMANDS if c.symbol != "HM"), *more]
    return RegisterMap(
        "MCX314AS",
        "NOVA MCX314As pulse generator with interpolation, 4 axes, 16-bit bus",
        "failure notice of 2006-11-21 (data sheet); working drivers; what it shares with the MCX312",
        (*registers, sync, buffer),
        list_mcx314as_words(),
        tuple(replace(c, together=(3,)) if c.symbol in three else c for c in sorted(found, key=lambda c: c.code)),
        4,
    )


MCX314AS_MAP = _make_mcx314as_map()
