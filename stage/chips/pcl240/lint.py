"""Lint of the PCL-240 chips: the rules of their data sheets that a bus write breaks.

`chip` is the state of the chip before the write, a record; `map_` is its register map. The rules for a start command form two
groups: obstacles that keep the chip from making pulses, and rules about ramps. If the lint finds an obstacle, it does not check the
rules about ramps. A start command while the chip runs is a speed change: the rules for a start do not apply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from stage.chips.pcl240.maps import COMMAND_WORD_NAMES
from stage.chips.pcl240.state import (
    EL_MINUS,
    EL_PLUS,
    EZ_COUNT,
    EZ_FROM_FL,
    EZ_RETURN,
    FH1,
    FH2,
    GROUP,
    INT_AT_STOP,
    LINEAR,
    MAP,
    MAX_EZ_COUNT,
    MINUS,
    ORG,
    ORG_POSITIVE,
    R13,
    R14,
    R15,
    RAMP,
    SPAN,
    SPEED,
    START,
    STOP,
    SYNI_SHIFT,
    UNCORRECTED,
)
from stage.chips.register_map import RegisterMap
from stage.chips.write_diagnostics import Finding, Rule

# a byte to a register
BITS_LOST = Rule("bits-lost", "section 3 c")
READ_ONLY_BITS = Rule("read-only-bits", "MS section 2-4")
NO_S_CURVES = Rule("no-s-curves", "MS section 1")
TORN_BYTES = Rule("torn-bytes", "Q & A")
AUTOMATIC_POINT_ENDS = Rule("automatic-point-ends", "MS section 3-5")
VALUE_RANGE = Rule("value-range", "section 4")
# a byte to address 0
UNUSED_BITS = Rule("unused-bits", "section 3")
DIRECTION_IN_MOTION = Rule("direction-in-motion", "section 3 b")
UNKNOWN_SPEED = Rule("unknown-speed", "section 3 a")
UNKNOWN_MODE = Rule("unknown-mode", "section 3 a")
TOO_FAST = Rule("too-fast", "section 1", once=True)
# a start that makes no pulse
START_WHILE_FINISHING = Rule("start-while-finishing", "Q & A")
NO_RESET_COMMAND = Rule("no-reset-command", "section 3 a")
NO_PULSES_LEFT = Rule("no-pulses-left", "section 4 R0")
LIMIT_AHEAD = Rule("limit-ahead", "pins 23 and 24")
STARTS_ON_ORG = Rule("starts-on-org", "section 5 f")
NO_MULTIPLIER = Rule("no-multiplier", "Q & A")
FL_IS_0 = Rule("fl-is-0", "Q & A")
FH_IS_0 = Rule("fh-is-0", "section 4 R1 to R3")
# the way the pulses go
RATE_BELOW_2 = Rule("rate-below-2", "section 4 R4")
EZ_NOT_SELECTED = Rule("ez-not-selected", "MS section 2-4")
FL_ABOVE_FH = Rule("fl-above-fh", "section 4 R1")
AUTOMATIC_WITHOUT_PRESET = Rule("automatic-without-preset", "section 3 b")
SPAN_OF_LINEAR_RAMP = Rule("span-of-linear-ramp", "MS section 2-2")
NO_RAMP_DOWN_POINT = Rule("no-ramp-down-point", "section 4 R6")
OFFSET_TOO_NEGATIVE = Rule("offset-too-negative", "MS section 3-4")
UNEQUAL_SPANS = Rule("unequal-spans", "MS section 3-4")
MOVE_TOO_SHORT = Rule("move-too-short", "MS section 3-4")

MAX_RATE_PPS = 245_730
"""Maximum output rate: 8191 speed steps of 30 pps, the greatest multiplier (data sheet, sections 1 and 4)."""
MISSING_PULSES_THRESHOLD = 16
"""A move is reported as too short if at the speed at which it stops so many pulses are missing of a ramp that ends at FL, or a
tenth of the ramp: some pulses are always missing, see docs/ramp_down.md."""
_SPEEDS = MAP.field("operate", "speed").values
_FH_REGISTER_BY_SPEED = {FH1: 2, FH2: 3}
"""Number of the register for each speed select code; R1 for every other code."""
_DATA_MASK = (1 << 24) - 1
"""Mask of the bits in the three data bytes of a register."""
_RAMPING = ("R1", "R4", "R5", "R14", "R15")


class EffectPredictors(NamedTuple):
    """Functions that predict the effect of a command if neither a write nor a change of an input follows it.

    Attributes:
        makes_pulses: Function of a command that returns whether it leads to pulses.
        predict_last_speed: Function of a command that returns the speed, in speed steps, at the end of the run; None if the run
            does not begin or does not end.
        clock_hz: Reference clock.
    """

    makes_pulses: Callable[[int], bool]
    predict_last_speed: Callable[[int], int | None]
    clock_hz: int


def lint_data(map_: RegisterMap, chip: Any, address: int, value: int) -> Iterator[Finding]:
    """Yield every rule that a byte to address 1, 2 or 3 breaks, with a message.

    Args:
        map_: Register map of the chip.
        chip: State of the chip before the write.
        address: Bus address.
        value: The byte.
    """
    k = int(chip["selected_register"])
    r = map_.registers[k]
    shift = 8 * (address - 1)
    written, word = value << shift, int(chip["reg"][k]) & ~(0xFF << shift) | value << shift
    if chip["collective"]:
        if address != 1:
            return
        written = word = int(chip["high_byte"]) << 16 | int(chip["middle_byte"]) << 8 | value
    if lost := written & ~r.mask & ~_find_sign_extension(r.name, chip, written):
        yield BITS_LOST, f"{r.name} is {r.bits} bits wide: {value:02X}h at address {address} loses bits {lost:06X}h"
    if fixed := written & r.mask & ~r.writable:
        yield READ_ONLY_BITS, f"{r.name} bits {fixed:06X}h are read only"
    if r.name in ("R14", "R15") and not chip["s_curves"] and written & r.mask & SPAN:
        yield NO_S_CURVES, f"{r.name}: this chip has no S-curves; the value is stored and means nothing"
    if chip["running"] and chip["preset"] and chip["uses_ramps"]:
        if r.name in ("R0", "R6"):
            yield TORN_BYTES, f"{r.name} written during a high-speed preset run: its bytes do not change together"
        if r.name in _RAMPING and chip["automatic_ramp_down"] and not chip["automatic_off"]:
            message = f"{r.name} written in motion switches the automatic ramp-down point off for this run"
            yield AUTOMATIC_POINT_ENDS, message
    # a register is complete with its low byte, which a host writes last, or whose high bytes are still 0
    if r.legal and address == 1 and word < r.legal[0] and word not in r.also:  # a start tells of R0 = 0 and R6 = 0
        yield VALUE_RANGE, f"{r.name} = {word}: {r.title} takes {r.legal[0]} to {r.legal[1]}"


def _find_sign_extension(name: str, chip: Any, written: int) -> int:
    """Find the bits of a written byte, or of a collective write, that only repeat the sign of R6 as an offset.

    These bits do not fit the register, but no information is lost without them.
    """
    sign = _DATA_MASK & ~(int(chip["offset_sign_bit"]) - 1)
    return sign if name == "R6" and chip["extended"] and written & sign == sign else 0


def lint_command(map_: RegisterMap, chip: Any, predictions: EffectPredictors, value: int) -> Iterator[Finding]:
    """Yield every rule that a byte to address 0 breaks, with a message.

    Args:
        map_: Register map of the chip.
        chip: State of the chip before the write.
        predictions: Functions that predict the effect of the command.
        value: The byte.
    """
    word = map_.word(COMMAND_WORD_NAMES[value & GROUP])
    if word.name != "operate":
        if unused := value & ~word.used:
            bits = " and ".join(str(k) for k in range(7, -1, -1) if unused >> k & 1)
            message = f"{word.name} mode {value:02X}h: bit {bits} means nothing on this chip"
            yield UNUSED_BITS.with_source(word.section), message
        if word.name == "control":
            yield from _lint_direction(chip, value)
        return
    if value & SPEED not in _SPEEDS and value & START and not value & STOP:
        yield UNKNOWN_SPEED, f"speed select {value & SPEED:02b} in {value:02X}h is in no table; it acts as FL"
    elif value not in word.sends and (value & ~INT_AT_STOP not in word.sends or value & ~INT_AT_STOP == STOP):
        yield UNKNOWN_MODE, f"operating mode {value:02X}h is in no table; {_describe_effect(chip, value)}"
    if value & START and not value & STOP:
        if not chip["running"]:
            yield from _lint_start(chip, predictions, value)
        yield from _lint_rate(chip, predictions.clock_hz, value)


def _lint_direction(chip: Any, value: int) -> Iterator[Finding]:
    """Find a control mode that changes the direction before status bit 6 is 0."""
    if bool(value & MINUS) == bool(chip["minus"]) or not (chip["running"] or chip["finishing"]):
        return
    effect = (
        "the next pulse goes the other way, without a ramp" if chip["running"] else "PDIR changes within the last pulse"
    )
    message = f"control mode {value:02X}h changes the direction in motion: {effect}; wait until status bit 6 is 0"
    yield DIRECTION_IN_MOTION, message


def _describe_effect(chip: Any, value: int) -> str:
    """Describe the effect of a command of group 00 that the tables of the data sheet do not contain."""
    if value & STOP and value & START:
        if not chip["running"]:
            return "nothing runs that it could stop"
        ramps = value & RAMP or chip["uses_ramps"]
        return f"it acts as a {'decelerating stop (1Dh, 1Fh)' if ramps else 'stop at once'}"
    if value & STOP:
        return "it acts as the reset command" + (", with /INT" if value & INT_AT_STOP else "")
    return "it does nothing but " + ("ask for /INT at the stop" if value & INT_AT_STOP else "take /INT back")


def _lint_rate(chip: Any, clock_hz: int, value: int) -> Iterator[Finding]:
    """Check that the speed which a start or a speed change selects is within the maximum of the data sheet."""
    multiplier = int(chip["multiplier"])
    selected = _FH_REGISTER_BY_SPEED.get(value & SPEED, 1)
    k = max([1, selected] if value & RAMP else [selected], key=lambda k: chip["reg"][k])
    steps = int(chip["reg"][k])
    if multiplier < 2 or steps * clock_hz <= MAX_RATE_PPS * 8192 * multiplier:
        return
    pps, unit = steps * clock_hz / (8192 * multiplier), clock_hz / (8192 * multiplier)
    yield (
        TOO_FAST,
        f"output above {MAX_RATE_PPS:,} pps, the most of this chip: R{k} = {steps} asks for {pps:,.0f} pps with R7 = {multiplier}, "
        f"a multiplier of {unit:g} (30 at most reaches every speed)",
    )


def _lint_start(chip: Any, predictions: EffectPredictors, value: int) -> Iterator[Finding]:
    """Check a start command while no run is in progress."""
    registers = [int(v) for v in chip["reg"]]
    obstacles = list(_find_obstacles(chip, registers, predictions, value))
    yield from obstacles
    yield from _lint_registers(chip, registers, value)
    if value & RAMP and not obstacles:
        yield from _lint_ramps(chip, registers, value & SPEED)
        yield from _lint_triangle(chip, registers, value, predictions)


def _find_obstacles(chip: Any, registers: list[int], predictions: EffectPredictors, value: int) -> Iterator[Finding]:
    """Find the obstacles that keep a start command from making pulses, or that end the pulses at speed 0.

    Ramps start from FL, and a decelerating stop ends at FL, whatever speed is selected, so R1 must not be 0.
    """
    if chip["finishing"]:
        message = "start while the last pulse is still being completed is ignored: poll status bit 6"
        yield START_WHILE_FINISHING, message
    if not chip["armed"]:
        yield NO_RESET_COMMAND, "start after a stop without the reset command 08h is ignored"
    if chip["preset"] and registers[0] == 0:
        yield NO_PULSES_LEFT, "start in preset mode with R0 = 0: no pulse, no /INT"
    if chip["active_inputs"] & (EL_MINUS if chip["minus"] else EL_PLUS):
        yield LIMIT_AHEAD, "start towards an asserted limit switch: no pulse comes; drive the other way"
    if chip["origin_return"] and chip["active_inputs"] & ORG:
        logic = ", or clear R13 bit 23, which reads a high pin as ORG" if registers[R13] & ORG_POSITIVE else ""
        yield STARTS_ON_ORG, f"origin return that starts on ORG: no pulse comes; leave ORG first{logic}"
    if chip["multiplier"] < 2:
        place = "R7 of the chip at SYNI" if chip["inputs"] >> SYNI_SHIFT else "R7"
        why = "no pulse comes; the multiplier does not operate unless it is set"
        yield NO_MULTIPLIER, f"start with {place} = {chip['multiplier']}: {why}"
    if zero := [k for k in sorted({1, _FH_REGISTER_BY_SPEED.get(value & SPEED, 1)}) if registers[k] == 0]:
        message = f"start with {' and '.join(f'R{k} = 0' for k in zero)}: "
        message += (
            "the pulses end where a ramp leads to speed 0" if predictions.makes_pulses(value) else "no pulse comes"
        )
        yield (FL_IS_0, f"{message}; any data must be set on R1") if 1 in zero else (FH_IS_0, message)


def _lint_registers(chip: Any, registers: list[int], value: int) -> Iterator[Finding]:
    """Find the registers of a start that do not have the effect for which they are set."""
    if value & RAMP and min(registers[4], registers[5]) < 2:
        yield (
            RATE_BELOW_2,
            f"high-speed start with R4 = {registers[4]}, R5 = {registers[5]}: rates below 2 hold the speed",
        )
    if (
        chip["extended"]
        and chip["origin_return"]
        and not registers[R13] & EZ_RETURN
        and registers[R13] & (MAX_EZ_COUNT << EZ_COUNT | EZ_FROM_FL)
    ):
        yield EZ_NOT_SELECTED, "R13 counts EZ, but its bit 21 is 0: the origin return ends at ORG"


def _lint_triangle(chip: Any, registers: list[int], value: int, predictions: EffectPredictors) -> Iterator[Finding]:
    """Find an S-curve move that is too short for its FH, which the chip does not correct, and which stops above FL."""
    fh = _FH_REGISTER_BY_SPEED.get(value & SPEED)
    corrected = chip["automatic_ramp_down"] and not registers[R14] & UNCORRECTED
    if (
        not fh
        or not chip["s_curves"]
        or registers[R14] & LINEAR
        or not chip["preset"]
        or corrected
        or registers[fh] <= registers[1]
    ):
        return
    height = registers[fh] - registers[1]
    rate = registers[4 if chip["automatic_ramp_down"] else 5]
    multiplier = int(chip["multiplier"])
    up, down = (s if 0 < 2 * s < height else height / 2 for s in (registers[R14] & SPAN, registers[R15] & SPAN))
    ramps = (height + 2 * up) * registers[4] + (height + 2 * down) * rate
    if registers[0] * 32768 * multiplier > (registers[1] + registers[fh]) * ramps:
        return
    last = predictions.predict_last_speed(value)
    allowed = min(
        _compute_steps_above_fl(MISSING_PULSES_THRESHOLD * 8192 * multiplier, registers[1], rate, down), height / 10
    )
    if last is None or last - registers[1] <= allowed:
        return
    last_pps, fl_pps = (k * predictions.clock_hz / (8192 * multiplier) for k in (last, registers[1]))
    why = "FH correction is off (R14 bit 15)"
    if not chip["automatic_ramp_down"]:
        why = "there is no FH correction without the automatic point"
    message = f"R0 = {registers[0]} is too short for R{fh} = {registers[fh]}, and {why}: "
    yield MOVE_TOO_SHORT, f"{message}it stops at {last_pps:,.0f} pps, FL is {fl_pps:,.0f} pps"


def _compute_steps_above_fl(phase: float, fl: int, rate: int, span: float) -> float:
    """Compute how far above FL an S-curve down to FL is when the phase that remains up to its end has a given value.

    At k speed steps above FL the ramp still takes rate sqrt(k span) clocks, at a mean speed of FL + k / 3.

    Args:
        phase: Remaining phase of the pulse generator: speed times clocks.
        fl: FL in speed steps, R1.
        rate: Rate of the ramp, R4 or R5.
        span: Speed steps of the curved end.

    Returns:
        Speed steps above FL, k.
    """
    low, high = 0.0, 8191.0
    for _ in range(20):
        k = (low + high) / 2
        low, high = (k, high) if rate * math.sqrt(k * span) * (fl + k / 3) < phase else (low, k)
    return high


def _lint_ramps(chip: Any, registers: list[int], speed_select: int) -> Iterator[Finding]:
    """Find contradictions about the ramps of a high-speed start."""
    fh, extended = _FH_REGISTER_BY_SPEED.get(speed_select), bool(chip["extended"])
    if extended and fh and registers[1] > registers[fh]:
        yield FL_ABOVE_FH, f"R1 = {registers[1]} is above R{fh} = {registers[fh]}: the ramp leads down to FH"
    if extended and chip["automatic_ramp_down"] and not chip["preset"]:
        message = "automatic ramp-down without preset mode: there is no point to ramp down at"
        yield AUTOMATIC_WITHOUT_PRESET, message
    if (
        extended
        and fh
        and registers[1] != registers[fh]
        and chip["s_curves"]
        and registers[R14] & LINEAR
        and (registers[R14] | registers[R15]) & SPAN
    ):
        yield SPAN_OF_LINEAR_RAMP, "R14 bit 12 selects linear ramps: the spans of R14 and R15 mean nothing"
    if not chip["preset"] or not fh or registers[1] >= registers[fh]:
        return
    if not chip["automatic_ramp_down"]:
        if registers[6] == 0:
            why, section = (". 08h clears R6 on this chip", "MS section 3-4") if extended else ("", "")
            message = f"R6 = 0 in a high-speed preset move: it stops without ramping down{why}"
            yield NO_RAMP_DOWN_POINT.with_source(section), message
        return
    yield from _lint_automatic_point(chip, registers, fh)


def _lint_automatic_point(chip: Any, registers: list[int], fh_number: int) -> Iterator[Finding]:
    """Find settings that make the automatic ramp-down point come too late, in a move that ramps up from FL to FH.

    Args:
        chip: State of the chip before the write.
        registers: Values of the registers by number.
        fh_number: Number of the register with FH, 2 or 3.
    """
    height = registers[fh_number] - registers[1]
    linear = not chip["s_curves"] or registers[R14] & LINEAR
    up, down = (0 if linear or not 0 < 2 * s < height else s for s in (registers[R14] & SPAN, registers[R15] & SPAN))
    offset = (
        registers[6] - 2 * int(chip["offset_sign_bit"]) if registers[6] & int(chip["offset_sign_bit"]) else registers[6]
    )
    rising = (
        (registers[1] + registers[fh_number])
        * (height + 2 * up if up else 2 * height)
        * registers[4]
        // (32768 * int(chip["multiplier"]))
    )
    if offset < 0 and -offset >= min(registers[0], rising):
        message = f"R6 = {offset} as offset: the move ends before the automatic ramp-down begins"
        yield OFFSET_TOO_NEGATIVE, message
    if not linear and (up or height / 2) < (down or height / 2):
        yield UNEQUAL_SPANS, "R14 is below R15: the automatic point comes too late for this deceleration"
