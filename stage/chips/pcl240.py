"""Nippon Pulse PCL-240K: the register map as data, and the chip.

Source: PCL-240K data sheet (sections 3 and 4), the normative model for what its lost figures would say.
"""

from __future__ import annotations

from typing import Any, ClassVar

from stage.chips import pcl240_core
from stage.chips.chip import Chip
from stage.chips.register_map import Field, Register, RegisterMap, Word

OPERATING_MODE = Word(
    "operate",
    "operating mode selection, 00xx xxxx at address 0",
    (
        Field("group", 7, 6, "00", access="W"),
        Field("int_at_stop", 5, 5, "1 = /INT at stop; 0 also clears a pending /INT", "S", "W"),
        Field("start", 4, 4, "start, or a speed change while running", "S", "W"),
        Field("stop", 3, 3, "alone (08h): reset command; with start (1Dh, 1Fh): decelerating stop", "S", "W"),
        Field("ramp", 2, 2, "1 = high speed (with ramps), 0 = constant speed", "S", "W"),
        Field("speed", 1, 0, "00 FL, 01 FH1, 11 FH2; 10 acts as FL [I]", "S", "W"),
    ),
)
CONTROL_MODE = Word(
    "control",
    "control mode selection, 01xx xxxx at address 0",
    (
        Field("group", 7, 6, "01", access="W"),
        Field("minus", 3, 3, "direction: 0 plus, 1 minus", "S", "W"),
        Field("preset", 2, 2, "stop when R0 reaches 0", "S", "W"),
        Field("sd", 1, 1, "SD+ and SD- slow a high-speed run", "I", "W"),
        Field("origin", 0, 0, "origin return: stop at ORG", "S", "W"),
    ),
)
REGISTER_SELECT = Word(
    "select",
    "register selection, 10xx xxxx at address 0",
    (Field("group", 7, 6, "10", access="W"), Field("register", 2, 0, "R0 to R7", "S", "W")),
)
OUTPUT_MODE = Word(
    "output",
    "output pulse mode selection, 11xx xxxx at address 0",
    (
        Field("group", 7, 6, "11", access="W"),
        Field("ots", 5, 5, "level of the OTS output", "I", "W"),
        Field("external", 4, 4, "R0 counts: 0 output pulses, 1 rising edges of EXTP", "I", "W"),
        Field("stored", 2, 1, "stored, no effect", "I", "W"),
        Field("independent", 0, 0, "0 common (POUT and PDIR), 1 independent (+ on POUT, - on PDIR)", "I", "W"),
    ),
)
STATUS = Word(
    "status",
    "status byte, read at address 0",
    (
        Field("no_int", 7, 7, "1 = no /INT pending", "H", "R"),
        Field("operating", 6, 6, "1 until the pulse in progress is complete", "S", "R"),
        Field("fkeep", 5, 5, "neither ramping up nor down", "I", "R"),
        Field("lt", 4, 4, "R0 < R6", "I", "R"),
        Field("zero", 3, 3, "R0 = 0", "H", "R"),
        Field("sd", 2, 2, "SD of the current direction asserted", "I", "R"),
        Field("org", 1, 1, "ORG asserted", "I", "R"),
        Field("ins", 0, 0, "INS asserted", "I", "R"),
    ),
)


def _registers() -> tuple[Register, ...]:
    speed, rate = (1, 8191), (2, 16383)
    return (
        Register("R0", 0, 24, "RW", "down counter: pulses left", (0, 16777215), unit="pulses"),
        Register("R1", 1, 13, "W", "FL speed", speed, unit="speed steps"),
        Register("R2", 2, 13, "W", "FH1 speed", speed, unit="speed steps"),
        Register("R3", 3, 13, "W", "FH2 speed", speed, unit="speed steps"),
        Register("R4", 4, 14, "W", "acceleration rate", rate, unit="clocks per speed step"),
        Register("R5", 5, 14, "W", "deceleration rate", rate, unit="clocks per speed step"),
        Register("R6", 6, 20, "W", "ramping-down point", (0, 1048575), unit="pulses"),
        Register("R7", 7, 10, "W", "multiplier: one speed step is clock / (8192 R7)", (2, 1023)),
    )


PCL240K_MAP = RegisterMap(
    "PCL240K",
    "Nippon Pulse PCL-240K pulse generator, one axis, 8-bit bus",
    "data sheet PCL-240K, sections 3 and 4; PDIR as a pin is asserted while low (minus) [I]",
    _registers(),
    (OPERATING_MODE, CONTROL_MODE, REGISTER_SELECT, OUTPUT_MODE, STATUS),
)


class PCL240K(Chip):
    """Nippon Pulse PCL-240K. Bus addresses: 0 command (write) and status (read); 1, 2, 3 the bytes of the selected
    register, low to high (write), and of R0 (read)."""

    MAP: ClassVar = PCL240K_MAP
    CORE: ClassVar = pcl240_core
    INPUTS: ClassVar = pcl240_core.INPUTS
    OUTPUTS: ClassVar = pcl240_core.OUTPUTS
    DEFAULT_CLOCK_HZ: ClassVar = 4_915_200

    def _configure(self, record: Any) -> None:
        for r in self.MAP.registers:
            record["mask"][r.number] = r.mask

    def values(self) -> dict[str, int]:
        return {r.name: int(self._record["reg"][r.number]) for r in self.MAP.registers} | {
            "status": int(pcl240_core.read(self._rows, self._i, 0))
        }

    def _lint(self, address: int, value: int) -> tuple[str, str] | None:
        c = self._record
        return _lint_data(self.MAP, c, address, value) if address else _lint_command(c, value)


def _lint_data(map_: RegisterMap, c: Any, address: int, value: int) -> tuple[str, str] | None:
    r = map_.registers[c["selected"]]
    shift = 8 * (address - 1)
    lost = value << shift & ~r.mask
    if lost:
        return (
            f"{r.name} is {r.bits} bits wide: {value:02X}h at address {address} loses bits {lost:06X}h",
            "section 3 c",
        )
    if c["running"] and c["preset"] and c["ramps"] and r.name in ("R0", "R6"):
        return f"{r.name} written during a high-speed preset run: its bytes do not change together", "Q & A"
    # a register is complete with its low byte, which a host writes last, or whose high bytes are still 0
    whole = int(c["reg"][c["selected"]]) & ~(0xFF << shift) | value << shift
    if r.legal and address == 1 and whole < r.legal[0]:
        return f"{r.name} = {whole}: {r.title} takes {r.legal[0]} to {r.legal[1]}", "section 4"
    return None


def _lint_command(c: Any, value: int) -> tuple[str, str] | None:
    start, stop = value & 0x10, value & 0x08
    if value >> 6 == 2 and value & 0x38:
        return f"register select {value:02X}h: bits 5 to 3 mean nothing on this chip", "section 3 c"
    if value >> 6 == 1 and value & 0x30:
        return f"control mode {value:02X}h: bits 5 and 4 mean nothing on this chip", "section 3 b"
    if value >> 6 or not start or stop:
        return None
    if value & 3 == 2:
        return f"speed select 10 in {value:02X}h is in no table; it acts as FL", "section 3 a"
    if c["running"]:
        return None
    if c["finishing"]:
        return "start while the last pulse is still being completed is ignored: poll status bit 6", "Q & A"
    if not c["armed"]:
        return "start after a stop without the reset command 08h is ignored", "section 3 a"
    r = [int(v) for v in c["reg"]]
    speeds = [r[1], r[2], r[1], r[3]]
    if r[7] < 2:
        return f"start with R7 = {r[7]}: the multiplier does not operate unless it is set", "Q & A"
    if r[1] == 0 or speeds[value & 3] == 0:
        return "start with a speed register at 0: no pulse will come; any data must be set on R1", "Q & A"
    if c["preset"] and r[0] == 0:
        return "start in preset mode with R0 = 0: no pulse, no /INT", "section 4 R0"
    if value & 4 and min(r[4], r[5]) < 2:
        return f"high-speed start with R4 = {r[4]}, R5 = {r[5]}: rates below 2 hold the speed", "section 4 R4"
    return None
