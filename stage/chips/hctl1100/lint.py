"""Rules of the HCTL-1100's manual that a bus write can break, for diagnostics.

`chip` is the state of the chip before the write, a record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from stage.chips.hctl1100 import maps, state
from stage.chips.write_diagnostics import Finding, Rule

# every write
NO_REGISTER = Rule("no-register", "register table")
READ_ONLY = Rule("read-only", "register table")
NOT_IN_IDLE = Rule("not-in-idle", "R05")
VALUE_RANGE = Rule("value-range", "register table")
# R00, flags
CHIP_SETS_F1 = Rule("chip-sets-f1", "flags")
NO_FLAG = Rule("no-flag", "flags")
SEVERAL_MODE_FLAGS = Rule("several-mode-flags", "flags")
# R05, program counter
UNKNOWN_MODE = Rule("unknown-mode", "R05")
LIMIT_TRIGGERED = Rule("limit-triggered", "status")
ALIGN_WITHOUT_RING = Rule("align-without-ring", "Align")
ALIGN_FROM_ELSEWHERE = Rule("align-from-elsewhere", "Align")
NO_ACCELERATION = Rule("no-acceleration", "trapezoid")
NO_MAX_VELOCITY = Rule("no-max-velocity", "trapezoid")
SAMPLE_TOO_SHORT = Rule("sample-too-short", "Table 4, page 24")
RING_IS_NOT_PHASES = Rule("ring-is-not-phases", "commutator")
ADVANCE_RANGE = Rule("advance-range", "commutator")
# data in a control mode
PROFILE_IN_PROGRESS = Rule("profile-in-progress", "trapezoid")
SAMPLE_IN_COMPUTATION = Rule("sample-in-computation", "page 24")
STOP_TRIGGERED = Rule("stop-triggered", "status")
VELOCITY_STEP = Rule("velocity-step", "R3C")
TWICE_IN_SAMPLE = Rule("twice-in-sample", "page 24")

REGISTERS = {r.number: r for r in maps.MAP.registers}
MODE_FLAGS = state.F0 | state.F3 | state.F5
COMMAND_ADDRESSES_BY_MODE = {
    state.POSITION: (maps.COMMAND_LOW,), state.TRAPEZOID: (maps.COMMAND_LOW,),
    state.INTEGRAL: (maps.COMMAND_LOW, maps.INTEGRAL_VELOCITY), state.PROPORTIONAL: maps.PROPORTIONAL_VELOCITY.addresses,
}  # fmt: skip
PROFILE_DATA = (
    *maps.COMMAND_POSITION.addresses,
    *maps.ACCELERATION.addresses,
    maps.MAX_VELOCITY,
    *maps.FINAL_POSITION.addresses,
)
IDLE_ONLY = (maps.PORT, maps.PWM, *maps.PRESET_POSITION.addresses)
MODE_FIELD = maps.MODE_WRITE.fields[0]
RESET, INIT, ALIGN = (MODE_FIELD.find_code(name) for name in ("reset", "Init/Idle", "Align"))
SET, NUMBER = maps.FLAG_WRITE.fields


def lint_write(chip: Any, read_encoder: Callable[[], int], address: int, value: int) -> Iterator[Finding]:
    """Yield every rule that a write breaks, with a message.

    Args:
        chip: State of the chip before the write, a record.
        read_encoder: Function that returns the encoder's raw count.
        address: Number of the register.
        value: The byte.
    """
    r = REGISTERS.get(address)
    if r is None:
        yield NO_REGISTER, f"there is no register at address {address:02X}h"
        return
    if r.access == "R":
        yield READ_ONLY, f"{r.name} can only be read: the write does nothing"
        return
    if address in IDLE_ONLY and chip["mode"] != state.IDLE:
        yield NOT_IN_IDLE.with_source(r.name), f"{r.name} is written outside of Init/Idle: ignored"
    if address == maps.FLAG:
        yield from _lint_flag(chip, value)
    elif address == maps.MODE:
        yield from _lint_mode(chip, read_encoder, value)
    elif address == maps.TIMER:
        yield from _lint_timer(value, state.find_control_mode(int(chip["flag_bits"])))
    elif r.legal and not r.allows(r.value(value)):
        message = f"{r.name} = {r.value(value)}: {r.title} takes {r.legal[0]} to {r.legal[1]}"
        yield VALUE_RANGE.with_source(r.name), message
    if chip["mode"] == state.CONTROL:
        yield from _lint_data_in_control(chip, address, value)


def _lint_flag(chip: Any, value: int) -> Iterator[Finding]:
    """Check a write to R00, the flag register of the HCTL-1100."""
    number = NUMBER.extract(value)
    bit, on = 1 << number, SET.extract(value)
    if bit == state.F1:
        yield CHIP_SETS_F1, "F1 is set and cleared by the chip alone: write R05"
        return
    if bit > state.F5:
        yield NO_FLAG, f"{value:02X}h: there is no flag {number}"
        return
    others = int(chip["flag_bits"]) & MODE_FLAGS & ~bit
    if on and bit & MODE_FLAGS and others:
        names = " and ".join(f"F{k}" for k in range(6) if (others | bit) >> k & 1)
        yield SEVERAL_MODE_FLAGS, f"{names} are set: only one of F0, F3 and F5 may be"
    if on and chip["mode"] == state.CONTROL:
        yield from _lint_control_mode(chip, int(chip["flag_bits"]) | bit)


def _lint_mode(chip: Any, read_encoder: Callable[[], int], value: int) -> Iterator[Finding]:
    """Check a write to R05, the program counter, which selects the mode of the HCTL-1100."""
    if value not in MODE_FIELD.values:
        known = ", ".join(f"{v:02X}h {mode}" for v, mode in MODE_FIELD.values.items())
        yield UNKNOWN_MODE, f"R05 = {value:02X}h is no mode: {known}"
        return
    if value in (RESET, INIT):
        return
    begins = chip["mode"] == state.IDLE and not chip["limit_triggered"]
    if chip["mode"] != state.IDLE:
        yield NOT_IN_IDLE, f"R05 = {value:02X}h outside of Init/Idle: ignored"
    if chip["limit_triggered"]:
        message = f"R05 = {value:02X}h while LIMIT has triggered: release the pin and write R07 first"
        yield LIMIT_TRIGGERED, message
    if begins and value == ALIGN:
        if not chip["reg"][maps.RING]:
            yield ALIGN_WITHOUT_RING, "Align turns the motor by the commutator, whose ring R18 is 0"
        if (
            chip["flag_bits"] & MODE_FLAGS
            or chip["command"]
            or state.to_signed(read_encoder() - int(chip["position_origin"]), 24)
        ):
            yield ALIGN_FROM_ELSEWHERE, "Align begins with F0, F3, F5 clear and both positions 0"
    elif begins:
        yield from _lint_control_mode(chip, int(chip["flag_bits"]))
    if begins:
        yield from _lint_commutator(chip)


def _lint_control_mode(chip: Any, flags: int) -> Iterator[Finding]:
    """Check the registers of the HCTL-1100's control mode that begins, the one that `flags` select."""
    reg = chip["reg"]
    if flags & state.F0 and not (reg[maps.ACCELERATION_FRACTION] or reg[maps.ACCELERATION_WHOLE]):
        yield NO_ACCELERATION, "a trapezoid with acceleration 0 (R27, R26) does not move and never ends"
    if flags & state.F0 and not reg[maps.MAX_VELOCITY]:
        yield NO_MAX_VELOCITY, "a trapezoid with maximum velocity 0 (R28) does not move and never ends"
    yield from _lint_timer(int(reg[maps.TIMER]), state.find_control_mode(flags))


def _lint_timer(timer: int, mode: int) -> Iterator[Finding]:
    """Check that the value of the sample timer is large enough for a control mode of the HCTL-1100."""
    if timer < state.MIN_TIMER_VALUES[mode]:
        least = state.MIN_TIMER_VALUES[mode]
        message = f"T = {timer:02X}h is below {least:02X}h, the least for {state.CONTROL_MODES[mode]} control"
        yield SAMPLE_TOO_SHORT, message


def _lint_commutator(chip: Any) -> Iterator[Finding]:
    """Check that the registers of the HCTL-1100's commutator agree with each other."""
    reg = chip["reg"]
    ring = int(reg[maps.RING])
    offset = state.to_signed(int(reg[maps.OFFSET]), 8)
    max_advance = int(reg[maps.MAX_ADVANCE])
    phases = 4 if chip["status"] & state.FOUR else 3
    if ring and phases * (int(reg[maps.X]) + int(reg[maps.Y])) != ring:
        message = f"the ring R18 = {ring} is not {phases} (X + Y) = {phases} ({reg[maps.X]} + {reg[maps.Y]})"
        yield RING_IS_NOT_PHASES, message
    if ring and not -128 <= 1.5 * ring + offset - max_advance <= 1.5 * ring + offset + max_advance <= 127:
        message = f"1.5 ring + offset +- maximum advance = {1.5 * ring + offset:g} +- {max_advance} leaves -128 to 127"
        yield ADVANCE_RANGE, message


def _lint_data_in_control(chip: Any, address: int, value: int) -> Iterator[Finding]:
    """Check the moment of a write in a control mode, and the step of a velocity."""
    mode = state.find_control_mode(int(chip["flag_bits"]))
    if mode == state.TRAPEZOID and address in PROFILE_DATA:
        message = f"R{address:02X} is written while PROF is high: the profile in progress takes it"
        yield PROFILE_IN_PROGRESS, message
    if address in COMMAND_ADDRESSES_BY_MODE[mode] and chip["clock"] < chip["computing_until"]:
        when = f"wait until R0F has counted down by {state.MIN_TIMER_VALUES[mode]}"
        yield SAMPLE_IN_COMPUTATION, f"R{address:02X} is written while the sample is computed: {when}"
    if address == maps.INTEGRAL_VELOCITY and mode == state.INTEGRAL:
        step = state.to_signed(value, 8) - state.to_signed(int(chip["reg"][address]), 8)
        if chip["stop_triggered"]:
            message = "R3C is written while STOP has triggered: it stays 0. Release the pin and write R07 first"
            yield STOP_TRIGGERED, message
        elif abs(step) > 127:
            yield VELOCITY_STEP, f"R3C changes by {step}: successive command velocities may differ by 127"
    if (
        address in COMMAND_ADDRESSES_BY_MODE[mode]
        and chip["command_sample_end"] == chip["sample_end"]
        and int(chip["command_writes"]) >> state.COMMAND_ADDRESSES.index(address) & 1
    ):
        message = f"R{address:02X} is written twice in one sample: the later command counts, and the sheet allows one"
        yield TWICE_IN_SAMPLE, message
