"""Register map of the TMC2209 as data: numbers, widths, reset values and fields, each with its evidence (tmc2209_sheet.md).

On the bus of a host the step timer of the STEP/DIR axis has addresses 0 to Fh, and the registers of the chip have theirs + 80h.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stage.chips.register_map import Field, Register, RegisterMap
from stage.chips.stepdir.maps import MAP as STEP_TIMER

UART_BYTE, UART_BIT_NS, UART_OTHER = 0x10, 0x11, 0x12
"""Bus addresses of the host's UART: a byte to send or one that has come; the time of a bit, ns; a byte of another chip on the same
wire, which ends now."""
NO_BYTE = 0x100
"""Result of a read of UART_BYTE when no byte has come."""
REGISTER_BASE = 0x80
"""Bus address of register 0."""
REGISTERS, ADDRESSES = 0x80, 0x100
MASK_32_BITS = (1 << 32) - 1


def _make_fields(*definitions: tuple) -> tuple[Field, ...]:
    """Make fields from tuples (bits, name, meaning) or (bits, name, meaning, evidence), with bits such as "7" or "4..0"."""
    fields = []
    for place, name, meaning, *evidence in definitions:
        high, _, low = str(place).partition("..")
        fields.append(Field(name, int(high), int(low or high), meaning, *evidence))
    return tuple(fields)


def _make_register(
    number: int, name: str, access: str, bits: int, title: str, fields: tuple[Field, ...] = (), **more: Any
) -> Register:
    return Register(name, number, bits, access, title, fields=fields, **more)


_GCONF = _make_fields(
    (0, "i_scale_analog", "VREF scales the current"), (1, "internal_rsense", "internal sense resistors"),
    (2, "en_spreadcycle", "SpreadCycle, not StealthChop"), (3, "shaft", "motor turns the other way"),
    (4, "index_otpw", "INDEX shows the overtemperature warning"), (5, "index_step", "INDEX shows the internal steps"),
    (6, "pdn_disable", "pin PDN_UART is for the UART only"), (7, "mstep_reg_select", "microsteps by MRES, not by MS1 and MS2"),
    (8, "multistep_filt", "step input filter"), (9, "test_mode", "test mode"),
)  # fmt: skip
_GSTAT = _make_fields(
    (0, "reset", "was reset"), (1, "drv_err", "driver error"), (2, "uv_cp", "charge pump undervoltage, not latched")
)
_SLAVECONF = _make_fields(
    ("11..8", "senddelay", "delay of a reply: 8 bit times for 0 and 1, 24 for 2 and 3, and so on")
)
_IOIN = _make_fields(
    (0, "enn", "ENN"), (2, "ms1", "MS1"), (3, "ms2", "MS2"), (4, "diag", "DIAG"), (6, "pdn_uart", "PDN_UART"),
    (7, "step", "STEP"), (8, "spread_en", "SPREAD"), (9, "dir", "DIR"), ("31..24", "version", "version, 21h"),
)  # fmt: skip
_FACTORY_CONF = _make_fields(("4..0", "fclktrim", "clock trim"), ("9..8", "ottrim", "overtemperature threshold"))
_IHOLD_IRUN = _make_fields(
    ("4..0", "ihold", "hold current"),
    ("12..8", "irun", "run current"),
    ("19..16", "iholddelay", "x 2^18 clocks a step down"),
)
_COOLCONF = _make_fields(
    ("3..0", "semin", "CoolStep: lower threshold / 32, 0: off"), ("6..5", "seup", "current up"),
    ("11..8", "semax", "hysteresis / 32"), ("14..13", "sedn", "current down"), (15, "seimin", "least current a quarter"),
)  # fmt: skip
_CHOPCONF = _make_fields(
    ("3..0", "toff", "off time, 0: driver off"), ("6..4", "hstrt", "hysteresis start"), ("10..7", "hend", "hysteresis end"),
    ("16..15", "tbl", "blank time"), (17, "vsense", "full scale 0.18 V, not 0.325 V"),
    ("27..24", "mres", "a step is 2^mres of 1/256 full step"), (28, "intpol", "interpolates to 256 microsteps"),
    (29, "dedge", "both edges of STEP"), (30, "diss2g", "no short to ground protection"),
    (31, "diss2vs", "no short to supply protection"),
)  # fmt: skip
_DRV_STATUS = _make_fields(
    (0, "otpw", "overtemperature warning"), (1, "ot", "overtemperature"), (2, "s2ga", "short to ground A"),
    (3, "s2gb", "short to ground B"), (4, "s2vsa", "short to supply A"), (5, "s2vsb", "short to supply B"),
    (6, "ola", "open load A"), (7, "olb", "open load B"), (8, "t120", "above 120 C"), (9, "t143", "above 143 C"),
    (10, "t150", "above 150 C"), (11, "t157", "above 157 C"), ("20..16", "cs_actual", "current scale"),
    (30, "stealth", "StealthChop"), (31, "stst", "standstill"),
)  # fmt: skip
_PWMCONF = _make_fields(
    ("7..0", "pwm_ofs", "offset"), ("15..8", "pwm_grad", "gradient"), ("17..16", "pwm_freq", "frequency"),
    (18, "pwm_autoscale", "automatic scale"), (19, "pwm_autograd", "automatic gradient"),
    ("21..20", "freewheel", "at IHOLD 0: 0 normal, 1 free, 2 and 3 braked"), ("27..24", "pwm_reg", "regulation"),
    ("31..28", "pwm_lim", "limit"),
)  # fmt: skip
_OTP_PROG = _make_fields(("2..0", "otpbit", "bit"), ("5..4", "otpbyte", "byte"), ("15..8", "otpmagic", "BDh programs"))
_OTP_READ = _make_fields(
    ("4..0", "otp_fclktrim", "clock trim"), (5, "otp_ottrim", "overtemperature threshold"),
    (6, "otp_internal_rsense", "internal sense resistors"), (7, "otp_tbl", "TBL 1, not 2"),
    ("11..8", "otp_pwm_grad", "PWM_GRAD, 0: 14"), (12, "otp_pwm_autograd", "pwm_autograd off"),
    ("15..13", "otp_tpwmthrs", "TPWMTHRS, 0: 0"), (16, "otp_pwm_ofs", "PWM_OFS 0, not 36"), (17, "otp_pwm_reg", "PWM_REG 2, not 8"),
    (18, "otp_pwm_freq", "PWM_FREQ 2, not 1"), ("20..19", "otp_iholddelay", "IHOLDDELAY, 0: 1"),
    ("22..21", "otp_ihold", "IHOLD, 0: 16"), (23, "otp_en_spreadcycle", "SpreadCycle; bits 16..8 are then CHOPCONF 8..0"),
)  # fmt: skip

OTP_RESET_EVIDENCE = "after a reset as a blank OTP sets it, and as chips are read (C); the register table prints {}"

DRIVER_REGISTERS = (
    _make_register(0x00, "GCONF", "RW", 10, "global configuration", _GCONF, reset=0x101),
    _make_register(0x01, "GSTAT", "RW", 3, "global status, a 1 written clears", _GSTAT, reset=1),
    _make_register(0x02, "IFCNT", "R", 8, "UART writes, modulo 256"),
    _make_register(0x03, "SLAVECONF", "W", 12, "delay of replies", _SLAVECONF),
    _make_register(0x04, "OTP_PROG", "W", 16, "OTP programming", _OTP_PROG, note="stored only: the OTP is blank"),
    _make_register(0x05, "OTP_READ", "R", 24, "OTP content", _OTP_READ),
    _make_register(0x06, "IOIN", "R", 32, "pin levels and version", _IOIN),
    _make_register(0x07, "FACTORY_CONF", "RW", 10, "clock trim", _FACTORY_CONF, note="stored only"),
    _make_register(0x10, "IHOLD_IRUN", "W", 20, "currents", _IHOLD_IRUN, reset=0x11F10),
    _make_register(0x11, "TPOWERDOWN", "W", 8, "delay before the current falls", reset=20, unit="x 2^18 clocks"),
    _make_register(0x12, "TSTEP", "R", 20, "clocks per 1/256 step", unit="clocks"),
    _make_register(0x13, "TPWMTHRS", "W", 20, "StealthChop below this speed, 0: at every speed", unit="clocks"),
    _make_register(0x14, "TCOOLTHRS", "W", 20, "StallGuard output, CoolStep above this speed", unit="clocks"),
    _make_register(0x22, "VACTUAL", "W", 24, "internal steps, 0: STEP and DIR", signed=True, unit="fCLK / 2^24 steps/s"),
    _make_register(0x40, "SGTHRS", "W", 8, "stall at SG_RESULT <= 2 SGTHRS"),
    _make_register(0x41, "SG_RESULT", "R", 10, "StallGuard4 result, even, up to 510"),
    _make_register(0x42, "COOLCONF", "W", 16, "CoolStep", _COOLCONF),
    _make_register(0x6A, "MSCNT", "R", 10, "microstep counter"),
    _make_register(0x6B, "MSCURACT", "R", 25, "microstep currents",
       _make_fields(("8..0", "cur_a", "phase A, signed", "?"), ("24..16", "cur_b", "phase B, signed", "?")),
       note="revision 1.03 and the vendor's header put phase A in the low bits, revision 1.09 phase B"),
    _make_register(0x6C, "CHOPCONF", "RW", 32, "chopper", _CHOPCONF, reset=0x10010053, note=OTP_RESET_EVIDENCE.format("10000053h")),
    _make_register(0x6F, "DRV_STATUS", "R", 32, "driver status", _DRV_STATUS),
    _make_register(0x70, "PWMCONF", "RW", 32, "StealthChop", _PWMCONF, reset=0xC80D0E24,
    note=OTP_RESET_EVIDENCE.format("C10D0024h")),
    _make_register(0x71, "PWM_SCALE", "R", 25, "StealthChop amplitude",
       _make_fields(("7..0", "pwm_scale_sum", "duty cycle / 256"), ("24..16", "pwm_scale_auto", "correction, signed"))),
    _make_register(0x72, "PWM_AUTO", "R", 24, "StealthChop automatic values",
       _make_fields(("7..0", "pwm_ofs_auto", "offset"), ("23..16", "pwm_grad_auto", "gradient"))),
)  # fmt: skip
"""The registers of the chip at their own numbers, for the UART."""

MAP = RegisterMap(
    "TMC2209",
    "Trinamic driver of one two-phase stepper: STEP/DIR, StealthChop, StallGuard4, CoolStep; single-wire UART; with a step timer",
    "data sheet TMC2209 rev. 1.03 to 1.09; see tmc2209_sheet.md of this package",
    (*STEP_TIMER.registers, *(replace(r, number=REGISTER_BASE + r.number) for r in DRIVER_REGISTERS)),
    STEP_TIMER.words,
    STEP_TIMER.commands,
)
"""Register map of the axis: the step timer, and the registers of the chip from REGISTER_BASE on."""

REGISTER_NUMBERS = {r.name: r.number for r in DRIVER_REGISTERS}
READABLE_REGISTERS = {r.number: r for r in DRIVER_REGISTERS if "R" in r.access}
WRITABLE_REGISTERS = {r.number: r for r in DRIVER_REGISTERS if "W" in r.access}
IS_READABLE = tuple(int(number in READABLE_REGISTERS) for number in range(REGISTERS))
STORED_BITS = tuple(WRITABLE_REGISTERS[n].mask if n in WRITABLE_REGISTERS else 0 for n in range(REGISTERS))
"""Bits that a write stores, by register."""
_RESETS = {r.number: r.reset or 0 for r in DRIVER_REGISTERS}
RESET_VALUES = tuple(_RESETS.get(number, 0) for number in range(REGISTERS))
