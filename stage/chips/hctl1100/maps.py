"""The register map of the HCTL-1100 as data. Registers are called by their address, as the data sheet does: R0F is address 0Fh.

Sources: the data sheet's page on the sample timer (S), other pages of the manual (D; pages 14, 20, 23, 31, 32 and 35 are in
public text), working drivers (C), memory of the manual (M). What these leave open is inferred (I); docs/hctl1100.md says why.
"""

from __future__ import annotations

from dataclasses import dataclass

from stage.chips.register_map import Field, Register, RegisterMap, Word

# Addresses. All others take them from here.
FLAG, MODE, STATUS, PORT, PWM = 0x00, 0x05, 0x07, 0x08, 0x09
COMMAND_HIGH, COMMAND_MIDDLE, COMMAND_LOW, TIMER = 0x0C, 0x0D, 0x0E, 0x0F
ACTUAL_HIGH, ACTUAL_MIDDLE, ACTUAL_LOW = 0x12, 0x13, 0x14
PRESET_HIGH, PRESET_MIDDLE, PRESET_LOW = 0x15, 0x16, 0x17
RING, PHASE_TIMER, X, Y, OFFSET, MAX_ADVANCE = 0x18, 0x19, 0x1A, 0x1B, 0x1C, 0x1F
ZERO, POLE, GAIN = 0x20, 0x21, 0x22
PROPORTIONAL_LOW, PROPORTIONAL_HIGH = 0x23, 0x24
ACCELERATION_FRACTION, ACCELERATION_WHOLE, MAX_VELOCITY = 0x26, 0x27, 0x28
FINAL_LOW, FINAL_MIDDLE, FINAL_HIGH = 0x29, 0x2A, 0x2B
VELOCITY_LOW, VELOCITY_HIGH, INTEGRAL_VELOCITY = 0x34, 0x35, 0x3C
ADDRESS_COUNT = 64
CLEAR_POSITION_ADDRESS = ACTUAL_MIDDLE
"""Bus address at which any write clears the actual position."""
SEVEN_BITS = (0, 0x7F)


@dataclass(frozen=True)
class RegisterQuantity:
    """Quantity in two or three registers of a byte each, the high byte first.

    Attributes:
        title: Name in words.
        addresses: Addresses of the registers, that of the high byte first.
        unit: Unit in which the quantity is described.
        scale: Value of the registers that corresponds to 1 unit.
        signed: Whether the value is in two's complement.
        waits: Whether written upper bytes take effect only when the low byte is written.
        latched: Whether a read of the low byte latches the upper bytes.
    """

    title: str
    addresses: tuple[int, ...]
    unit: str
    scale: int = 1
    signed: bool = True
    waits: bool = False
    latched: bool = False

    @property
    def low(self) -> int:
        """Address of the register with the low byte."""
        return self.addresses[-1]

    def get_shift(self, address: int) -> int:
        """Return the number of bits by which the byte at an address is shifted in the value: 0 for the low byte, then 8, 16."""
        return 8 * (len(self.addresses) - 1 - self.addresses.index(address))

    def describe(self, bytes_: dict[int, int]) -> str:
        """Describe the value of the quantity in words.

        Args:
            bytes_: Address of a register -> its byte.

        Returns:
            For example "command position = 4112 counts".
        """
        word = sum(bytes_[a] << self.get_shift(a) for a in self.addresses)
        top = 1 << 8 * len(self.addresses)
        number = word - top if self.signed and word >= top // 2 else word
        return f"{self.title} = {number / self.scale:.10g} {self.unit}"


COMMAND_POSITION = RegisterQuantity(
    "command position", (COMMAND_HIGH, COMMAND_MIDDLE, COMMAND_LOW), "counts", waits=True
)
ACTUAL_POSITION = RegisterQuantity("actual position", (ACTUAL_HIGH, ACTUAL_MIDDLE, ACTUAL_LOW), "counts", latched=True)
PRESET_POSITION = RegisterQuantity(
    "preset of the actual position", (PRESET_HIGH, PRESET_MIDDLE, PRESET_LOW), "counts", waits=True
)
PROPORTIONAL_VELOCITY = RegisterQuantity(
    "proportional command velocity", (PROPORTIONAL_HIGH, PROPORTIONAL_LOW), "counts/sample", scale=16
)
ACCELERATION = RegisterQuantity(
    "acceleration", (ACCELERATION_WHOLE, ACCELERATION_FRACTION), "counts/sample2", scale=256, signed=False
)
FINAL_POSITION = RegisterQuantity("final position", (FINAL_HIGH, FINAL_MIDDLE, FINAL_LOW), "counts")
ACTUAL_VELOCITY = RegisterQuantity("actual velocity", (VELOCITY_HIGH, VELOCITY_LOW), "counts/sample")
QUANTITIES = {
    a: q
    for q in (
        COMMAND_POSITION, ACTUAL_POSITION, PRESET_POSITION, PROPORTIONAL_VELOCITY, ACCELERATION, FINAL_POSITION,
        ACTUAL_VELOCITY,
    )
    for a in q.addresses
}  # fmt: skip
"""Quantities of several registers, by the address of each of their registers."""


def _make_bit(name: str, number: int, meaning: str, evidence: str = "D", access: str = "R", **more: object) -> Field:
    """Return a field of one bit. `more` has further attributes of `Field`."""
    return Field(name, number, number, meaning, evidence, access, **more)  # type: ignore[arg-type]


_TRIGGER_CLEAR_NOTE = "a write here clears it once the pin is released"
_FLAGS = (
    _make_bit("f5", 5, "integral velocity mode", note="pages 31, 32"),
    _make_bit("f4", 4, "hold commutator", "M"),
    _make_bit("f3", 3, "proportional velocity mode", note="page 31"),
    _make_bit("f2", 2, "unipolar motor command", "M"),
    _make_bit("f1", 1, "init/idle mode", note="the INIT pin; page 20", pins=("init",)),
    _make_bit(
        "f0", 0, "trapezoid mode", note="cleared when the commanded profile ends; the PROF pin; page 35", pins=("prof",)
    ),
)
_STATUS = (
    _make_bit(
        "limit",
        7,
        "",
        values={0: "LIMIT has triggered", 1: "LIMIT has not triggered"},
        silent=1,
        note=_TRIGGER_CLEAR_NOTE,
    ),
    _make_bit(
        "stop", 6, "", values={0: "STOP has triggered", 1: "STOP has not triggered"}, silent=1, note=_TRIGGER_CLEAR_NOTE
    ),
    _make_bit("init", 5, "init/idle mode", pins=("init",)),
    _make_bit("profile", 4, "the profile flag F0", pins=("prof",)),
    _make_bit("zero", 3, "always 0"),
    _make_bit(
        "full",
        2,
        "",
        access="RW",
        values={0: "the commutator counts quadrature counts", 1: "the commutator counts full counts"},
    ),
    _make_bit("four", 1, "", access="RW", values={0: "three phases", 1: "four phases"}),
    _make_bit(
        "inhibit", 0, "PULSE stays off for one PWM period after a reversal of SIGN", access="RW", note="pages 20, 23"
    ),
)
FLAG_WRITE = Word(
    "flag",
    "what is written to R00: one flag set or cleared",
    (
        _make_bit("set", 3, "", "M", "W", values={0: "clear", 1: "set"}),
        Field("number", 2, 0, "flag number", "M", "W", values={k: f"F{k}" for k in (0, 2, 3, 4, 5)}),
    ),
    address=FLAG,
    sends={
        set_ << 3 | f.low: f"{'set' if set_ else 'clear'} F{f.low}: {f.meaning}"
        for f in reversed(_FLAGS)
        if f.name != "f1"
        for set_ in (1, 0)
    },
)
MODE_WRITE = Word(
    "mode",
    "what is written to R05",
    (
        Field("mode", 7, 0, "", "D", "W", (0, 3), {0: "reset", 1: "Init/Idle", 2: "Align", 3: "control"},
              "Align and control only from init/idle"),
    ),
    address=MODE,
)  # fmt: skip


def _make_register(number: int, access: str, title: str, **more: object) -> Register:
    """Return an 8-bit register. `more` has further attributes of `Register`."""
    return Register(f"R{number:02X}", number, 8, access, title, **{"evidence": "D", **more})  # type: ignore[arg-type]


def _make_number_byte(number: int, access: str, part: str, **more: object) -> Register:
    """Return a register that holds one byte of a number."""
    q = QUANTITIES[number]
    return _make_register(number, access, f"{q.title}, {part}", unit=q.unit, **more)


MAP = RegisterMap(
    "HCTL1100",
    "Agilent HCTL-1100 motion controller with digital filter and profile generator, one axis, 8-bit bus",
    "data sheet HCTL-1100, pages 14, 20, 23, 24, 31, 32 and 35; other pages of the manual; working drivers",
    (
        _make_register(FLAG, "RW", "flags", fields=_FLAGS),
        _make_register(MODE, "W", "program counter", note="mode"),
        _make_register(STATUS, "RW", "status", fields=_STATUS),
        _make_register(PORT, "RW", "motor command port, 80h is 0; written in init/idle only", reset=0x80),
        _make_register(PWM, "RW", "PWM motor command; written in init/idle only", signed=True, legal=(-100, 100), unit="%",
                  evidence="M"),
        _make_number_byte(COMMAND_HIGH, "RW", "high byte; waits for R0E"),
        _make_number_byte(COMMAND_MIDDLE, "RW", "middle byte; waits for R0E"),
        _make_number_byte(COMMAND_LOW, "RW", "low byte; its write latches all three"),
        _make_register(TIMER, "RW", "sample timer: written T, read the running count; a sample is 16 (T + 1) clocks", evidence="S",
                  reset=0x40),
        _make_number_byte(ACTUAL_HIGH, "R", "high byte, as latched"),
        _make_number_byte(ACTUAL_MIDDLE, "RW", "middle byte, as latched; any write clears the position"),
        _make_number_byte(ACTUAL_LOW, "R", "low byte; its read latches the other two"),
        _make_number_byte(PRESET_HIGH, "W", "high byte; init/idle only"),
        _make_number_byte(PRESET_MIDDLE, "W", "middle byte; init/idle only"),
        _make_number_byte(PRESET_LOW, "W", "low byte; its write loads all three"),
        _make_register(RING, "RW", "commutator: ring", legal=SEVEN_BITS, unit="counts"),
        _make_register(PHASE_TIMER, "W", "commutator: velocity timer of the phase advance, 16 (R19 + 1) clocks"),
        _make_register(X, "RW", "commutator: X, one phase alone", legal=SEVEN_BITS, unit="counts"),
        _make_register(Y, "RW", "commutator: Y, two phases together", legal=SEVEN_BITS, unit="counts"),
        _make_register(OFFSET, "RW", "commutator: offset", signed=True, unit="counts"),
        _make_register(MAX_ADVANCE, "RW", "commutator: maximum phase advance", legal=SEVEN_BITS, unit="counts"),
        _make_register(ZERO, "RW", "filter: zero A, in 1/256", reset=0xE5),
        _make_register(POLE, "RW", "filter: pole B, in 1/256", reset=0x40),
        _make_register(GAIN, "RW", "filter: gain K, in 1/4", reset=0x40),
        _make_number_byte(PROPORTIONAL_LOW, "RW", "low byte: 12.4, fraction in b3..0; acts at once"),
        _make_number_byte(PROPORTIONAL_HIGH, "RW", "high byte; acts at once", signed=True),
        _make_number_byte(ACCELERATION_FRACTION, "RW", "fraction /256"),
        _make_number_byte(ACCELERATION_WHOLE, "RW", "whole", legal=SEVEN_BITS),
        _make_register(MAX_VELOCITY, "RW", "maximum velocity", legal=SEVEN_BITS, unit="counts/sample"),
        _make_number_byte(FINAL_LOW, "RW", "low byte"),
        _make_number_byte(FINAL_MIDDLE, "RW", "middle byte"),
        _make_number_byte(FINAL_HIGH, "RW", "high byte"),
        _make_number_byte(VELOCITY_LOW, "R", "low byte; in proportional velocity mode only"),
        _make_number_byte(VELOCITY_HIGH, "R", "high byte"),
        _make_register(INTEGRAL_VELOCITY, "RW", "integral command velocity", signed=True, unit="counts/sample"),
    ),
    (FLAG_WRITE, MODE_WRITE),
)  # fmt: skip

MINIMUM_T = {"position": 0x07, "proportional velocity": 0x07, "trapezoid": 0x0F, "integral velocity": 0x0F}
"""Table 4 of the data sheet: the smallest T of each control mode, and how far the timer counts before commands may be written."""

POSITION_BOUND = 1 << 23  # counts; positions are -TOP to TOP - 1


@dataclass(frozen=True)
class WritableNumber:
    """Number that a host writes by one call of `HCTL1100.register_cycles`, into one or several registers.

    Attributes:
        addresses: Bus addresses of its bytes, in the order in which a host writes them: the high byte first.
        minimum: Smallest value.
        maximum: Largest value.
    """

    addresses: tuple[int, ...]
    minimum: int
    maximum: int


NUMBERS = {
    "timer": WritableNumber((TIMER,), 0, 0xFF),
    "zero": WritableNumber((ZERO,), 0, 0xFF),
    "pole": WritableNumber((POLE,), 0, 0xFF),
    "gain": WritableNumber((GAIN,), 0, 0xFF),
    "command_position": WritableNumber(COMMAND_POSITION.addresses, -POSITION_BOUND, POSITION_BOUND - 1),
    "preset_position": WritableNumber(PRESET_POSITION.addresses, -POSITION_BOUND, POSITION_BOUND - 1),
    "final_position": WritableNumber(FINAL_POSITION.addresses, -POSITION_BOUND, POSITION_BOUND - 1),
    "acceleration": WritableNumber(ACCELERATION.addresses, 0, 0x7FFF),
    "maximum_velocity": WritableNumber((MAX_VELOCITY,), 0, 0x7F),
    "proportional_velocity": WritableNumber(PROPORTIONAL_VELOCITY.addresses, -0x8000, 0x7FFF),
    "integral_velocity": WritableNumber((INTEGRAL_VELOCITY,), -0x80, 0x7F),
    "motor_command": WritableNumber((PWM,), -100, 100),
}
"""What a host writes as one: acceleration in 256ths of counts per sample2, proportional velocity in 16ths of counts per sample, the
other velocities in counts per sample; motor_command in hundredths of full drive, in Init/Idle only."""


def find_reset_value(name: str) -> int:
    """Return the value that a one-byte number has after a reset.

    Args:
        name: Its name in NUMBERS.
    """
    (address,) = NUMBERS[name].addresses
    return next(r.reset for r in MAP.registers if r.number == address) or 0
