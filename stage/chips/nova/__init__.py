"""NOVA MCX514, MCX512, MCX501, MCX314As, MCX304, MCX302, MCX312: one family with one core.

The variants differ by their register maps and their bus.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from stage.chips.chip import Chip, Pins, make_cycle_error
from stage.chips.exclusive_access import exclusive
from stage.chips.nova import core, state
from stage.chips.nova.cycle_descriptions import CycleDescriber, Decoder
from stage.chips.nova.functions import encoder
from stage.chips.nova.lint import LintState, Mcx312LintState, Mcx314asLintState, lint_write
from stage.chips.nova.registers.mcx300 import MCX302_MAP, MCX304_MAP, MCX312_MAP, MCX314AS_MAP
from stage.chips.nova.registers.mcx514 import MCX501_MAP, MCX512_MAP, MCX514_MAP
from stage.chips.register_map import Word
from stage.chips.write_diagnostics import Finding
from stage.errors import StageError
from stage.support.argument_checks import explain_arguments

__all__ = ["MCX302", "MCX304", "MCX312", "MCX314AS", "MCX501", "MCX512", "MCX514", "Nova"]

FIRST_BYTE_ADDRESS = 16
_HIGH_CODE_REGISTERS = {"HM": ("mode", state.HM), "HV": ("reg", state.HV)}
"""Fields and indices of the registers that commands from 60h on write in the older chips."""
AX1, AX2, AX3 = (MCX314AS_MAP.field("WR5", f"AX{k}") for k in (1, 2, 3))


class Nova(Chip):
    """Base class of the NOVA chips. Bus address n, 0 to 7, is the 16-bit word WRn for writes and RRn for reads."""

    CORE: ClassVar = core
    INPUTS: ClassVar = state.INPUTS
    OUTPUTS: ClassVar = state.OUTPUTS
    WIRING: ClassVar = {"el_plus": "lmt_plus", "el_minus": "lmt_minus", "org": "stop1", "ez": "stop2"}
    PHASES: ClassVar = {"asnd": "up", "cnst": "keep", "dsnd": "down"}
    DEFAULT_CLOCK_HZ: ClassVar = 16_000_000
    CLOCK_RANGE: ClassVar = (1, 16_000_000)
    CLOCK_SOURCE: ClassVar = "AC characteristics, CLK"
    ADDRESSES: ClassVar = 8
    DATA_MASK: ClassVar = 0xFFFF
    BUSY: ClassVar = (0, 1)
    COUNTER: ClassVar = ("LP", 32)
    AXES: ClassVar = 4
    ENCODERS: ClassVar = True
    IRQ: ClassVar = (-1, sum(state.COMMON_OUTPUTS.values()))
    DRIVER: ClassVar = "stage.firmware.nova.mcx300_driver:Mcx300Driver"
    VARIANT: ClassVar[int] = state.FIRST_GENERATION
    ADDRESS_MASK: ClassVar = 31

    def _configure(self, record: Any) -> None:
        record["variant"], record["axes"] = self.VARIANT, self.AXES

    def write(self, address: int, value: int) -> None:
        try:
            on_the_bus = int(address) & 7, int(value) & self.DATA_MASK
        except (TypeError, ValueError, OverflowError):
            raise make_cycle_error("write", address, value) from None
        self._write(*on_the_bus, (address, value))

    def read(self, address: int) -> int:
        try:
            n = int(address) & 7
        except (TypeError, ValueError, OverflowError):
            raise make_cycle_error("read", address) from None
        return super().read(n)

    @property
    def pins(self) -> Pins:
        """Pins that belong to no axis: the emergency stop and the interrupts."""
        return Pins(self, self.AXES, state.COMMON_INPUTS, state.COMMON_OUTPUTS)

    def net(self, axis: int = 0) -> int:
        self._check_axis(axis)
        return int(self.state["ax"][axis]["net"])

    def _check_pins(self, axis: int) -> None:
        if axis is True or axis != self.AXES:  # there are those that are no axis', see `pins`
            super()._check_pins(axis)

    def get_shaft(self, axis: int) -> tuple[float, float]:
        self._check_axis(axis)
        x = self.state["ax"][axis]
        return float(x["shaft_edges"]), float(x["shaft_rate"])

    def set_input_word(self, axis: int, word: int) -> None:
        self._check_pins(axis)
        if self._record["encoder_axes"] >> axis & 1 and (word ^ self.input_word(axis)) & encoder.PINS:
            raise StageError(f"ECA and ECB of axis {axis} are those of its encoder, and cannot be driven by hand.")
        super().set_input_word(axis, word)

    def lint(self, address: int, value: int) -> Iterable[Finding]:
        if address >= FIRST_BYTE_ADDRESS:  # of the 8-bit bus only the low byte of WR0 acts
            if address != FIRST_BYTE_ADDRESS:
                return ()
            address, value = 0, int(self._record["command_high_byte"]) & 0xFF00 | value
        return lint_write(self.MAP, self._make_lint_state(), address, value)

    def _make_lint_state(self) -> LintState:
        return LintState(self._record, self.AXES, self._find_interpolated_axes)

    def _find_interpolated_axes(self) -> int:
        """Return the axes that the registers select for interpolation, as bits; bit 0 is X."""
        return 0

    @classmethod
    @explain_arguments
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        """Return the writes to WR6, to WR7 for a register of more than 16 bits, and the command that writes the register.

        Source: manual, data writing commands.

        Args:
            name: Name of the register.
            value: Its value.
            axis: Axis of the chip, where each axis has the register.
        """
        cls._check_axis(axis)
        r = cls.MAP.register(name)
        data = [(6, value & 0xFFFF), (7, value >> 16 & 0xFFFF)]
        select = 1 << axis << 8 if cls.MAP.command(name).axes else 0
        return [*data[: 2 if r.bits > 16 else 1], (0, select | r.number)]

    @classmethod
    @explain_arguments
    def command_cycles(cls, symbol: str, axis: int = 0, datum: int | None = None) -> list[tuple[int, int]]:
        """Return the writes of data to WR6 and WR7, then of the code to WR0 with the axis' bit.

        WR1 to WR3, which each axis has, follow a NOP that selects the axis. Source: manual, axis assignment.

        Args:
            symbol: Symbol of the command, or name of the word.
            axis: Axis of the chip.
            datum: Its data.
        """
        cls._check_axis(axis)
        what, datum = cls.MAP.find_command_or_word(symbol, datum)
        if isinstance(what, Word):
            cycles = super().command_cycles(symbol, axis, datum)
            return [*cls.command_cycles("NOP", axis), *cycles] if 1 <= cycles[0][0] <= 3 else cycles
        select = 1 << axis << 8 if what.axes and cls.AXES > 1 else 0
        if what.choice:
            return [(0, select | what.code | datum)]
        data = [(6, datum & 0xFFFF), (7, datum >> 16)]
        takes = (what.bytes + 1) // 2 if "read" not in what.kind else 0
        return [*data[:takes], (0, select | what.code)]

    def decoder(self, axis: int = 0) -> Decoder:
        self._check_axis(axis)
        return Decoder(self.MAP, axis)

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber(self.MAP, self.state)

    def values(self) -> dict[str, int]:
        words = (w.name for w in self.MAP.words if w.name.startswith("RR"))
        return {name: core.read_register_value.with_gil(self.pointer, int(name[2]), name == "RR3-1") for name in words}

    def axis_values(self, axis: int = 0) -> dict[str, int]:
        """Return the registers of an axis by name, and its words as a host reads them when it has selected the axis.

        A register that cannot be read has the value that was last written.
        """
        self._check_axis(axis)
        chip, map_, values = self.make_replica(), self.MAP, {}
        c: Any = chip.state
        select = 1 << axis << 8
        core.write.with_gil(chip.pointer, 0, select | map_.command("NOP").code)
        for w in map_.words:
            n = w.address
            if n and w.is_written:
                common = {4: "outputs4", 5: "outputs5", 6: "data_low", 7: "data_high"}
                values[w.name] = int(c["ax"][axis]["wr"][n]) if n <= 3 else int(c[common[n]])
            elif n is not None and w.fields and not w.is_written:
                values[w.name] = core.read_register_value.with_gil(chip.pointer, n, w.name == "RR3-1")
        reads = {k.symbol.removeprefix("R-"): k for k in map_.commands if k.kind == "data read"}
        for r in map_.registers:
            if (read := reads.get(r.name)) is not None:
                core.write.with_gil(chip.pointer, 0, (select if read.axes else 0) | read.code)
                values[r.name] = r.value(int(c["read_high"]) << 16 | int(c["read_low"]))
            elif (place := self._find_register_field(r.name)) is not None:
                name, k = place
                has_each_axis = map_.command(r.name).axes
                values[r.name] = r.value(int(c["ax"][axis if has_each_axis else 0][name][k]))
        return values

    @classmethod
    def _find_register_field(cls, name: str) -> tuple[str, int] | None:
        """Find the field of an axis' state that stores a register which a host cannot read.

        Returns:
            Name of the field and index in it; None if the state does not store the value that was written.
        """
        number = cls.MAP.register(name).number
        if number < state.REGISTERS:
            return "reg", number
        k = number - state.MODE_FIRST
        return ("mode", k) if 0 <= k < state.MODE_REGISTER_COUNT else _HIGH_CODE_REGISTERS.get(name)


class MCX514(Nova):
    """NOVA MCX514: four axes, interpolation, synchronous actions."""

    MAP: ClassVar = MCX514_MAP
    CLOCK_RANGE: ClassVar = (1, 20_000_000)
    VARIANT: ClassVar = state.MCX514_TYPE
    DRIVER: ClassVar = "stage.firmware.nova.mcx514_driver:Mcx514Driver"
    MULTICHIP: ClassVar = True
    # RR1, the interrupt factors
    READING_ACTS: ClassVar = frozenset({1, FIRST_BYTE_ADDRESS | 2, FIRST_BYTE_ADDRESS | 3})

    @property
    def linked(self) -> bool:
        """Whether the chip is wired to other chips for multichip interpolation, see `Stage(multichip=...)`."""
        return bool(self.state["wire_word"])

    def _find_interpolated_axes(self) -> int:
        return int(self._record["ax"][0]["mode"][state.IPM]) & 15

    @exclusive
    def write_byte(self, address: int, value: int) -> None:
        """Make a write cycle of the 8-bit bus.

        Args:
            address: 0 for the low byte of WR0, 1 for its high byte, and so on to 15. The low byte of WR0 makes the chip act.
            value: The byte.

        Raises:
            ArgumentError: The address or the value is no number.
        """
        try:
            at, byte = int(address) & 15, int(value) & 0xFF
        except (TypeError, ValueError, OverflowError):
            raise make_cycle_error("write_byte", address, value) from None
        self._write(FIRST_BYTE_ADDRESS | at, byte, (FIRST_BYTE_ADDRESS | at if at == address else address, value))

    @exclusive
    def read_byte(self, address: int) -> int:
        """Make a read cycle of the 8-bit bus.

        Args:
            address: 0 for the low byte of RR0, 1 for its high byte, and so on to 15.

        Raises:
            ArgumentError: The address is no number.
        """
        try:
            at = int(address) & 15
        except (TypeError, ValueError, OverflowError):
            raise make_cycle_error("read_byte", address) from None
        return Chip.read(self, FIRST_BYTE_ADDRESS | at)


class MCX512(MCX514):
    """NOVA MCX512: two axes of the MCX514's kind, interpolation without helices, PIO8 to PIO13."""

    MAP: ClassVar = MCX512_MAP
    AXES: ClassVar = 2
    INPUTS: ClassVar = state.INPUTS_512
    OUTPUTS: ClassVar = state.OUTPUTS_512


class MCX501(MCX514):
    """NOVA MCX501: one axis of the MCX514's kind, no interpolation. Its commands need no axis bits."""

    MAP: ClassVar = MCX501_MAP
    AXES: ClassVar = 1
    MULTICHIP: ClassVar = False


class _ErratumChip(Nova):
    """Base class of the MCX304, MCX302 and MCX312, which have an erratum.

    Args:
        clock_hz: Reference clock; default: that of the data sheet.
        errata: Whether to emulate the chip as it was sold, with the S-curve failure that NOVA's notice describes.
    """

    INPUTS: ClassVar = state.INPUTS_300
    READING_ACTS: ClassVar = frozenset({3})  # RR3, the interrupt factors

    def __init__(self, clock_hz: int | None = None, errata: bool = True):
        self.errata = bool(errata)
        super().__init__(clock_hz)

    def options(self) -> dict[str, Any]:
        return super().options() | {"errata": self.errata}

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        record["errata"] = self.errata


class MCX304(_ErratumChip):
    """NOVA MCX304: four axes."""

    MAP: ClassVar = MCX304_MAP


class MCX302(_ErratumChip):
    """NOVA MCX302: two axes."""

    MAP: ClassVar = MCX302_MAP
    AXES: ClassVar = 2


class MCX312(_ErratumChip):
    """NOVA MCX312: two axes, interpolation."""

    MAP: ClassVar = MCX312_MAP
    AXES: ClassVar = 2

    def _find_interpolated_axes(self) -> int:
        word = int(self._record["outputs5"])
        return 1 << AX1.extract(word) | 1 << AX2.extract(word)

    def _make_lint_state(self) -> LintState:
        return Mcx312LintState(self._record, self.AXES, self._find_interpolated_axes)

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        record["has_l"] = 1


class MCX314AS(Nova):
    """NOVA MCX314As: four axes of the first generation, interpolation of two and three, no S-curve failure."""

    MAP: ClassVar = MCX314AS_MAP
    INPUTS: ClassVar = state.INPUTS_314
    READING_ACTS: ClassVar = frozenset({3})  # RR3, the interrupt factors

    def _find_interpolated_axes(self, count: int = 3) -> int:
        axes = [f.extract(int(self._record["outputs5"])) for f in (AX1, AX2, AX3)]
        return sum(1 << j for j in {*axes[:count]})

    def _make_lint_state(self) -> LintState:
        return Mcx314asLintState(self._record, self.AXES, self._find_interpolated_axes)

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        record["has_l"] = record["extended"] = 1
