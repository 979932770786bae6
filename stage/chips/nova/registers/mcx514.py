"""Register map of the NOVA MCX514 as data: parameters and commands; mcx514_words.py has the bits.

Sources: sections 7.2.7 and 7.2.8 of NOVA's manual (data sheet), other pages of it, working drivers. What no page states is
chosen as a reader would expect and marked I, as are all values after reset.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stage.chips.nova.registers.mcx514_words import list_mode_registers, list_words
from stage.chips.register_map import ChipCommand, Field, Register, RegisterMap, make_read_command, make_write_command

JERK, RATE, SPEED = (1, 1_073_741_823), (1, 536_870_911), (1, 8_000_000)
COORDINATE_RANGE_PULSES = (-1_073_741_823, 1_073_741_823)
"""Legal range of TP in interpolation, and of CP."""
MAX_CONTINUOUS_PPS = 4_000_000
"""Highest drive speed in continuous interpolation, pps."""
NO_MAXIMUM = 0xFFFF_FFFF
"""Value of LX and RX with which a position counter does not wrap at a maximum."""
READ_CODES = {
    "LP": 0x30, "RP": 0x31, "MR0": 0x34, "MR1": 0x35, "MR2": 0x36, "MR3": 0x37, "TX": 0x39, "HLV": 0x3B, "MRM": 0x40,
    "P1M": 0x41, "P2M": 0x42, "P3M": 0x49, "AC": 0x43, "SV": 0x44, "DV": 0x45, "TP": 0x46, "SP1": 0x47,
}  # fmt: skip
"""Codes of the commands that read back a register, by the name of the register."""
CHIP_REGISTER_NAMES = ("TX", "HLN", "HLV", "CHLN", "IPM", "UI")
"""Registers of the chip, not of an axis: their commands carry no axis bits."""


def _make_parameter(
    code: int, name: str, title: str, legal: tuple[int, int] | None = None, unit: str = "", reset: int = 0, **more: Any
) -> Register:
    """Return a parameter, whose number is the code of the command that writes it. `more` has further attributes of `Register`."""
    access = "RW" if name in READ_CODES else "W"
    return Register(
        name, code, more.pop("bits", 32), access, title, legal, unit=unit, reset=reset, **{"evidence": "C", **more}
    )


_SPLIT = (
    Field("WIDTH", 31, 16, "pulse width", "C", legal=(1, 65534), note="1 to 65534 drive pulses"),
    Field("CYCLE", 15, 0, "cycle length", "C", legal=(2, 65535), note="2 to 65535 drive pulses"),
)
PARAMETERS = (
    _make_parameter(0x00, "JK", "jerk", JERK, "pps/s2", 1),
    _make_parameter(0x01, "DJ", "deceleration increasing rate", JERK, "pps/s2", 1, note="used with DSNDE"),
    _make_parameter(0x02, "AC", "acceleration", RATE, "pps/s", 1),
    _make_parameter(0x03, "DC", "deceleration", RATE, "pps/s", 1, note="used with DSNDE"),
    _make_parameter(0x04, "SV", "initial speed", SPEED, "pps", 1),
    _make_parameter(0x05, "DV", "drive speed", SPEED, "pps", 1, note="can be changed while driving"),
    _make_parameter(0x06, "TP", "drive pulse number", (-2_147_483_646, 2_147_483_646), "pulses", evidence="S", signed=True,
               note=f"or finish point (interpolation: {COORDINATE_RANGE_PULSES[0]} to {COORDINATE_RANGE_PULSES[1]}), "
               "or bit pattern; the other way stops a drive [I]",
               section="7.2.7"),
    _make_parameter(0x07, "DP", "manual deceleration point", (0, 4_294_967_292), "pulses", evidence="S", note="used with MANLD",
               section="7.2.8"),
    _make_parameter(0x08, "CP", "circular center", COORDINATE_RANGE_PULSES, "pulses", signed=True, note="relative"),
    _make_parameter(0x09, "LP", "logical position counter", None, "pulses", signed=True),
    _make_parameter(0x0A, "RP", "real position counter", None, "pulses", signed=True),
    _make_parameter(0x0B, "SP", "software limit +", None, "pulses", signed=True),
    _make_parameter(0x0C, "SM", "software limit -", None, "pulses", signed=True),
    _make_parameter(0x0D, "AO", "acceleration counter offset", (-32768, 32767), "pulses", bits=16, signed=True),
    _make_parameter(0x0E, "LX", "LP maximum of the ring", (1, 2_147_483_647), "pulses", NO_MAXIMUM, also=(NO_MAXIMUM,),
               note="FFFFFFFFh: no ring"),
    _make_parameter(0x0F, "RX", "RP maximum of the ring", (1, 2_147_483_647), "pulses", NO_MAXIMUM, also=(NO_MAXIMUM,),
               note="FFFFFFFFh: no ring"),
    *(_make_parameter(0x10 + m, f"MR{m}", f"multi-purpose register {m}", signed=True) for m in range(4)),
    _make_parameter(0x14, "HV", "home search speed", SPEED, "pps", 1),
    _make_parameter(0x15, "IV", "speed increasing / decreasing value", (1, 1_000_000), "pps", 1),
    _make_parameter(0x16, "TM", "timer value", (1, 2_147_483_647), "us", 1, note="at 16 MHz"),
    _make_parameter(0x17, "SP1", "split pulse cycle and width", None, "pulses", 0x0001_0002, fields=_SPLIT),
    _make_parameter(0x18, "SP2", "split pulse count", (0, 65535), bits=16, note="0: endless"),
    _make_parameter(0x19, "TX", "maximum finish point of interpolation", (1, 1_073_741_823), "pulses", 1, evidence="D"),
    _make_parameter(0x1A, "HLN", "helical rotation number", (0, 65535), bits=16),
    _make_parameter(0x1B, "HLV", "helical calculation value", (1, 2_147_483_646), reset=1,
               note="ticks, each of one pulse of Z and U at most [I]"),
)  # fmt: skip
READ_ONLY_REGISTERS = (
    Register("CV", 0x32, 32, "R", "current speed", evidence="S", unit="pps"),
    Register("CA", 0x33, 32, "R", "current acceleration / deceleration", evidence="C", unit="pps/s"),
    Register("CT", 0x38, 32, "R", "current timer value", evidence="D", unit="us", note="0 while it is stopped"),
    Register("CHLN", 0x3A, 16, "R", "current helical rotation number", evidence="C"),
    Register(
        "UI", 0x48, 32, "R", "general inputs", evidence="C", note="RR7 the PIN pins, RR6 the data bus pins in I2C mode"
    ),
)
"""Registers that a host can only read."""
_READ_COMMAND_EVIDENCE = {"DV": "S", "TX": "D"}


def _make_read_commands(registers: tuple[Register, ...]) -> tuple[ChipCommand, ...]:
    """Return the commands 30h to 49h, by which a host reads registers of the chip or of an axis."""
    present = {r.name for r in READ_ONLY_REGISTERS}
    back = [r for r in registers if r.name in READ_CODES]
    found = [
        *(
            make_read_command(
                r, READ_CODES[r.name], _READ_COMMAND_EVIDENCE.get(r.name, "C"), axes=r.name not in CHIP_REGISTER_NAMES
            )
            for r in back
        ),
        *(make_read_command(r, axes=r.name not in CHIP_REGISTER_NAMES) for r in registers if r.name in present),
        *(ChipCommand(0x3C + k, f"R-WR{k}", f"read WR{k}", "data read", 2, evidence="C") for k in (1, 2, 3)),
    ]
    return tuple(sorted(found, key=lambda c: c.code))


def _make_drive_command(code: int, symbol: str, title: str, starts: bool = False, note: str = "") -> ChipCommand:
    """Return a command of the MCX514's kind that drives axes."""
    return ChipCommand(code, symbol, title, "drive", evidence="C", starts=starts, note=note)


def _make_interpolation_command(code: int, symbol: str, title: str) -> ChipCommand:
    """Return an interpolation command, which is not sent to axes."""
    return ChipCommand(code, symbol, title, "interpolation", evidence="C", axes=False)


def _make_segment_command(code: int, symbol: str, title: str, *axes: int, points: bool = True) -> ChipCommand:
    """Return the command of a segment. `axes` has the possible numbers of axes, which IPM selects."""
    return replace(_make_interpolation_command(code, symbol, title), starts=True, together=axes, points=points)


def _make_command(code: int, symbol: str, title: str, axes: bool = True) -> ChipCommand:
    """Return a command of the MCX514's kind that has no data."""
    return ChipCommand(code, symbol, title, "other", evidence="C", axes=axes)


def _make_sync_command(code: int, symbol: str, verb: str) -> ChipCommand:
    """Return a command for the synchronous action sets that its `choice` bits select."""
    note, chooses = "bits 0 to 3 of the code", tuple(f"SYNC{m}" for m in range(4))
    return ChipCommand(code, symbol, verb, "sync", evidence="C", choice=0x0F, note=note, chooses=chooses)


_DATALESS_COMMANDS = (
    _make_drive_command(0x50, "DRVRL", "relative position drive", True),
    _make_drive_command(0x51, "DRVNR", "counter relative position drive", True, "the sign of TP inverted"),
    _make_drive_command(0x52, "DRVVP", "+ direction continuous drive", True),
    _make_drive_command(0x53, "DRVVM", "- direction continuous drive", True),
    _make_drive_command(0x54, "DRVAB", "absolute position drive", True),
    _make_drive_command(0x56, "DRVSBRK", "decelerating stop"),
    _make_drive_command(0x57, "DRVFBRK", "instant stop"),
    _make_drive_command(0x58, "DIRCP", "direction signal + (pulse and direction)"),
    _make_drive_command(0x59, "DIRCM", "direction signal - (pulse and direction)"),
    _make_drive_command(0x5A, "HMSRC", "automatic home search", True),
    _make_segment_command(0x60, "LHK1", "1-axis linear interpolation (multichip)", 1),
    _make_segment_command(0x61, "LHK2", "2-axis linear interpolation", 2),
    _make_segment_command(0x62, "LHK3", "3-axis linear interpolation", 3),
    _make_segment_command(0x63, "LHK4", "4-axis linear interpolation", 4),
    _make_segment_command(0x64, "CHKCW", "CW circular interpolation", 2),
    _make_segment_command(0x65, "CHKCCW", "CCW circular interpolation", 2),
    _make_segment_command(0x66, "BHK2", "2-axis bit pattern interpolation", 2, points=False),
    _make_segment_command(0x67, "BHK3", "3-axis bit pattern interpolation", 3, points=False),
    _make_segment_command(0x68, "BHK4", "4-axis bit pattern interpolation", 4, points=False),
    _make_segment_command(0x69, "HLCW", "CW helical interpolation", 3, 4),
    _make_segment_command(0x6A, "HLCCW", "CCW helical interpolation", 3, 4),
    _make_interpolation_command(0x6B, "HLPCW", "CW helical calculation"),
    _make_interpolation_command(0x6C, "HLPCCW", "CCW helical calculation"),
    _make_interpolation_command(0x6D, "DECEN", "deceleration enable"),
    _make_interpolation_command(0x6E, "DECDIS", "deceleration disable"),
    _make_interpolation_command(0x6F, "CLRSTEP", "interpolation interrupt clear, or single step"),
    _make_command(0x70, "VINC", "speed increase by IV"),
    _make_command(0x71, "VDEC", "speed decrease by IV"),
    _make_command(0x72, "DCC", "deviation counter clear output"),
    _make_command(0x73, "TMSTA", "timer start"),
    _make_command(0x74, "TMSTP", "timer stop"),
    _make_command(0x75, "SPSTA", "split pulse start"),
    _make_command(0x76, "SPSTP", "split pulse stop"),
    _make_command(0x77, "DHOLD", "drive start hold"),
    _make_command(0x78, "DFREE", "drive start hold release"),
    _make_command(0x79, "R2CLR", "error and finishing status clear (RR2)"),
    _make_command(0x7A, "RR3P0", "RR3 shows page 0"),
    _make_command(0x7B, "RR3P1", "RR3 shows page 1"),
    _make_command(0x7C, "MFPC", "maximum finish point clear", axes=False),
    _make_sync_command(0x80, "SYNCEN", "enable"),
    _make_sync_command(0x90, "SYNCDIS", "disable"),
    _make_sync_command(0xA0, "SYNCACT", "activate"),
    _make_command(0xFF, "RST", "command reset", axes=False),
)

_NEEDS_INTERPOLATION = ("CP", "TX", "IPM", "MFPC")
_NEEDS_HELICES = ("HLN", "HLV", "CHLN", "HLCW", "HLCCW", "HLPCW", "HLPCCW")
"""Registers and commands of interpolation, and of helices."""


def _make_register_map(chip: str, axes: int, title: str) -> RegisterMap:
    """Return the register map of the MCX514, MCX512 or MCX501 by the number of axes."""
    lacks = {*(_NEEDS_HELICES if axes < 3 else ()), *(_NEEDS_INTERPOLATION if axes < 2 else ())}
    registers = tuple(r for r in (*PARAMETERS, *list_mode_registers(axes), *READ_ONLY_REGISTERS) if r.name not in lacks)

    def is_on_chip(c: ChipCommand) -> bool:
        if c.symbol in lacks or (c.kind == "interpolation" and axes < 2):
            return False
        return not c.together or min(c.together) <= axes

    modes_of = {r.name for r in list_mode_registers(axes)}
    present = {r.name for r in READ_ONLY_REGISTERS}
    commands = (
        *(
            make_write_command(r, axes=r.name not in CHIP_REGISTER_NAMES)
            for r in registers
            if r.name not in modes_of | present
        ),
        _make_command(0x1F, "NOP", "axis selection only"),
        *(
            make_write_command(r, "mode write", axes=r.name not in CHIP_REGISTER_NAMES)
            for r in registers
            if r.name in modes_of
        ),
        *_make_read_commands(registers),
        *(c for c in _DATALESS_COMMANDS if is_on_chip(c)),
    )
    return RegisterMap(
        chip,
        f"NOVA {chip} pulse generator {title}, 16-bit bus",
        "manual MCX514, 7.2.7 and 7.2.8 (data sheet) and other pages; working drivers; names of mode bits from memory",
        registers,
        list_words(axes),
        commands,
        axes=axes,
    )


MCX514_MAP = _make_register_map("MCX514", 4, "with interpolation, four axes")
MCX512_MAP = _make_register_map("MCX512", 2, "with interpolation, two axes")
MCX501_MAP = _make_register_map("MCX501", 1, "of one axis")
MCX514_GENERATION_MAPS = (MCX514_MAP, MCX512_MAP, MCX501_MAP)
"""What the two smaller ones lack, and P3M, are of working drivers [C]; that they are alike otherwise is inferred."""
