"""Register map of the TMC5160 as data: numbers, widths, reset values and fields (data sheet rev. 1.14, pages 31 to 56)."""

from __future__ import annotations

from typing import Any

from stage.chips.register_map import Field, Register, RegisterMap, Word

SPI_CS, SPI_BYTE, SPI_DATAGRAM, SPI_STATE, MOTION = 0x80, 0x81, 0x82, 0x83, 0x84
"""Bus addresses beyond the registers: chip select, a byte of SPI, a whole datagram, SPI_STATUS, drive in progress."""
REGISTERS, ADDRESSES = 0x80, 0x85
M32, M40 = (1 << 32) - 1, (1 << 40) - 1


def _make_fields(*definitions: str | tuple) -> tuple[Field, ...]:
    """Make fields from tuples (bits, name, meaning), with bits such as "7" or "4..0"."""
    fields = []
    for place, name, meaning in definitions:  # type: ignore[misc]
        high, _, low = str(place).partition("..")
        fields.append(Field(name, int(high), int(low or high), meaning))
    return tuple(fields)


def _make_register(
    number: int, name: str, access: str, bits: int, title: str, fields: tuple[Field, ...] = (), **more: Any
) -> Register:
    return Register(name, number, bits, access, title, fields=fields, **more)


_GCONF = _make_fields(
    (0, "recalibrate", "zero crossing recalibration"), (1, "faststandstill", "standstill after 2^18 clocks, not 2^20"),
    (2, "en_pwm_mode", "StealthChop"), (3, "multistep_filt", "step input filter"), (4, "shaft", "motor turns the other way"),
    (5, "diag0_error", "DIAG0 errors"), (6, "diag0_otpw", "DIAG0 overtemperature"), (7, "diag0_step", "DIAG0 shows steps"),
    (8, "diag1_dir", "DIAG1 shows direction"), (9, "diag1_index", "DIAG1 index"), (10, "diag1_onstate", "DIAG1 chopper on"),
    (11, "diag1_steps_skipped", "DIAG1 skipped steps"), (12, "diag0_int_pushpull", "DIAG0 push-pull, high active"),
    (13, "diag1_poscomp_pushpull", "DIAG1 push-pull, high active"), (14, "small_hysteresis", "thresholds with 1/32"),
    (15, "stop_enable", "ENCA stops all steps"), (16, "direct_mode", "currents by XTARGET"), (17, "test_mode", "test mode"),
)  # fmt: skip
_MODES = {0: "positioning", 1: "velocity, plus", 2: "velocity, minus", 3: "hold"}
_RAMPMODE = (Field("mode", 1, 0, "", values=_MODES, silent=None),)
_GSTAT = _make_fields(
    (0, "reset", "was reset"), (1, "drv_err", "driver error"), (2, "uv_cp", "charge pump undervoltage")
)
_IOIN = _make_fields(
    (0, "refl_step", "REFL"), (1, "refr_dir", "REFR"), (2, "encb", "ENCB"), (3, "enca", "ENCA"), (4, "drv_enn", "DRV_ENN"),
    (5, "encn", "ENCN"), (6, "sd_mode", "SD_MODE"), (7, "swcomp_in", "SWCOMP_IN"), ("31..24", "version", "version"),
)  # fmt: skip
_SW_MODE = _make_fields(
    (0, "stop_l_enable", "left switch stops"), (1, "stop_r_enable", "right switch stops"), (2, "pol_stop_l", "left active low"),
    (3, "pol_stop_r", "right active low"), (4, "swap_lr", "switches swapped"), (5, "latch_l_active", "latch: left closes"),
    (6, "latch_l_inactive", "latch: left opens"), (7, "latch_r_active", "latch: right closes"),
    (8, "latch_r_inactive", "latch: right opens"), (9, "en_latch_encoder", "latch X_ENC as well"),
    (10, "sg_stop", "stop at a stall"), (11, "en_softstop", "soft stop"),
)  # fmt: skip
_RAMP_STAT = _make_fields(
    (0, "status_stop_l", "left switch"), (1, "status_stop_r", "right switch"), (2, "status_latch_l", "latched left"),
    (3, "status_latch_r", "latched right"), (4, "event_stop_l", "stopped left"), (5, "event_stop_r", "stopped right"),
    (6, "event_stop_sg", "stopped by a stall"), (7, "event_pos_reached", "reached the target"),
    (8, "velocity_reached", "at VMAX"), (9, "position_reached", "at XTARGET"), (10, "vzero", "at rest"),
    (11, "t_zerowait_active", "waits TZEROWAIT"), (12, "second_move", "drove back"), (13, "status_sg", "stall"),
)  # fmt: skip
_CHOPCONF = _make_fields(
    ("3..0", "toff", "off time, 0: driver off"), ("6..4", "hstrt", "hysteresis start"), ("10..7", "hend", "hysteresis end"),
    (11, "fd3", "fast decay b3"), (12, "disfdcc", "no comparator in fast decay"), (14, "chm", "constant off time"),
    ("16..15", "tbl", "blank time"), (18, "vhighfs", "full steps above THIGH"), (19, "vhighchm", "chm above THIGH"),
    ("23..20", "tpfd", "passive fast decay"), ("27..24", "mres", "a step is 2^mres of 1/256 full step"),
    (28, "intpol", "interpolates to 256 microsteps"), (29, "dedge", "both edges of STEP"),
    (30, "diss2g", "no short to ground protection"), (31, "diss2vs", "no short to supply protection"),
)  # fmt: skip
_COOLCONF = _make_fields(
    ("3..0", "semin", "CoolStep: lower threshold"), ("6..5", "seup", "current up"), ("11..8", "semax", "hysteresis"),
    ("14..13", "sedn", "current down"), (15, "seimin", "least current a quarter"),
    ("22..16", "sgt", "StallGuard threshold, signed"),
    (24, "sfilt", "StallGuard filter"),
)  # fmt: skip
_DRV_STATUS = _make_fields(
    ("9..0", "sg_result", "StallGuard result"), (12, "s2vsa", "short to supply A"), (13, "s2vsb", "short to supply B"),
    (14, "stealth", "StealthChop"), (15, "fsactive", "full steps"), ("20..16", "cs_actual", "current scale"),
    (24, "stallguard", "stall"), (25, "ot", "overtemperature"), (26, "otpw", "overtemperature warning"),
    (27, "s2ga", "short to ground A"), (28, "s2gb", "short to ground B"), (29, "ola", "open load A"), (30, "olb", "open load B"),
    (31, "stst", "standstill"),
)  # fmt: skip
_ENCMODE = _make_fields(
    (0, "pol_a", "A for an N event"), (1, "pol_b", "B for an N event"), (2, "pol_n", "N active high"), (3, "ignore_ab", "N alone"),
    (4, "clr_cont", "each N event"), (5, "clr_once", "next N event"), ("7..6", "edge", "level, rising, falling, both"),
    (8, "clr_enc_x", "N event clears X_ENC"), (9, "latch_x_act", "N event latches XACTUAL"),
    (10, "enc_sel_decimal", "decimal fraction"),
)  # fmt: skip
_PWMCONF = _make_fields(
    ("7..0", "pwm_ofs", "offset"), ("15..8", "pwm_grad", "gradient"), ("17..16", "pwm_freq", "frequency"),
    (18, "pwm_autoscale", "automatic scale"), (19, "pwm_autograd", "automatic gradient"), ("21..20", "freewheel", "at IHOLD 0"),
    ("27..24", "pwm_reg", "regulation"), ("31..28", "pwm_lim", "limit"),
)  # fmt: skip

MAP = RegisterMap(
    "TMC5160",
    "Trinamic motion controller and driver of one two-phase stepper: six-point ramp, StallGuard2, CoolStep; SPI of 40 bits",
    "data sheet TMC5160/TMC5160A rev. 1.14; see tmc5160_sheet.md of this package",
    (
        _make_register(0x00, "GCONF", "RW", 18, "global configuration", _GCONF, reset=0x8),
        _make_register(0x01, "GSTAT", "RW", 3, "global status, a 1 written clears", _GSTAT, reset=1),
        _make_register(0x02, "IFCNT", "R", 8, "UART writes"),
        _make_register(0x03, "SLAVECONF", "W", 12, "UART address"),
        _make_register(0x04, "IOIN", "R", 32, "pin levels and version", _IOIN),
        _make_register(0x04, "OUTPUT", "W", 1, "UART only"),
        _make_register(0x05, "X_COMPARE", "W", 32, "position compare", signed=True, unit="steps"),
        _make_register(0x06, "OTP_PROG", "W", 16, "OTP programming"),
        _make_register(0x07, "OTP_READ", "R", 8, "OTP content", reset=0x0E, evidence="I"),
        _make_register(0x08, "FACTORY_CONF", "RW", 5, "clock trim", reset=0x0E, evidence="C"),
        _make_register(0x09, "SHORT_CONF", "W", 19, "short detection", reset=0x00010606),
        _make_register(0x0A, "DRV_CONF", "W", 22, "power stage", reset=0x00080400),
        _make_register(0x0B, "GLOBALSCALER", "W", 8, "motor current, /256; 0 is 256", legal=(32, 255), also=(0,)),
        _make_register(0x0C, "OFFSET_READ", "R", 16, "offset calibration"),
        _make_register(0x10, "IHOLD_IRUN", "W", 20, "currents",
           _make_fields(("4..0", "ihold", "hold current"), ("12..8", "irun", "run current"),
                        ("19..16", "iholddelay", "x 2^18 clocks"))),
        _make_register(0x11, "TPOWERDOWN", "W", 8, "delay before the current falls", reset=10, unit="x 2^18 clocks"),
        _make_register(0x12, "TSTEP", "R", 20, "clocks per 1/256 step", unit="clocks"),
        _make_register(0x13, "TPWMTHRS", "W", 20, "StealthChop below this speed", unit="clocks"),
        _make_register(0x14, "TCOOLTHRS", "W", 20, "StallGuard, CoolStep above this speed", unit="clocks"),
        _make_register(0x15, "THIGH", "W", 20, "high speed", unit="clocks"),
        _make_register(0x20, "RAMPMODE", "RW", 2, "mode of the ramp generator",
           _RAMPMODE),
        _make_register(0x21, "XACTUAL", "RW", 32, "actual position", signed=True, unit="steps"),
        _make_register(0x22, "VACTUAL", "R", 24, "actual velocity", signed=True, unit="fCLK / 2^24 steps/s"),
        _make_register(0x23, "VSTART", "W", 18, "start velocity", tuned=(1, 1 << 17), unit="fCLK / 2^24 steps/s"),
        _make_register(0x24, "A1", "W", 16, "acceleration below V1", unit="fCLK^2 / 2^41 steps/s2"),
        _make_register(0x25, "V1", "W", 20, "velocity between A1 and AMAX, 0: no A1, D1", unit="fCLK / 2^24 steps/s"),
        _make_register(0x26, "AMAX", "W", 16, "acceleration", tuned=(1, 0xFFFF), unit="fCLK^2 / 2^41 steps/s2"),
        _make_register(0x27, "VMAX", "W", 23, "drive velocity", legal=(0, (1 << 23) - 512), tuned=(1, 1 << 20),
                       unit="fCLK / 2^24 steps/s"),
        _make_register(0x28, "DMAX", "W", 16, "deceleration", tuned=(1, 0xFFFF), unit="fCLK^2 / 2^41 steps/s2"),
        _make_register(0x2A, "D1", "W", 16, "deceleration below V1", legal=(1, 0xFFFF), unit="fCLK^2 / 2^41 steps/s2"),
        _make_register(0x2B, "VSTOP", "W", 18, "stop velocity", legal=(1, (1 << 18) - 1), tuned=(10, 1 << 17), reset=1,
           unit="fCLK / 2^24 steps/s"),
        _make_register(0x2C, "TZEROWAIT", "W", 16, "wait after a stop", unit="x 512 clocks"),
        _make_register(0x2D, "XTARGET", "RW", 32, "target position", signed=True, unit="steps"),
        _make_register(0x33, "VDCMIN", "W", 23, "dcStep"),
        _make_register(0x34, "SW_MODE", "RW", 12, "reference switches", _SW_MODE),
        _make_register(0x35, "RAMP_STAT", "RW", 14, "ramp status, a 1 written clears b12, 7, 6, 3, 2", _RAMP_STAT, reset=0x780),
        _make_register(0x36, "XLATCH", "R", 32, "latched position", signed=True, unit="steps"),
        _make_register(0x38, "ENCMODE", "RW", 11, "encoder", _ENCMODE),
        _make_register(0x39, "X_ENC", "RW", 32, "encoder position", signed=True),
        _make_register(0x3A, "ENC_CONST", "W", 32, "encoder factor, 16.16", reset=0x10000),
        _make_register(0x3B, "ENC_STATUS", "RW", 2, "encoder status, a 1 written clears",
           _make_fields((0, "n_event", "N event"), (1, "deviation_warn", "deviation"))),
        _make_register(0x3C, "ENC_LATCH", "R", 32, "latched encoder position", signed=True),
        _make_register(0x3D, "ENC_DEVIATION", "W", 20, "permitted deviation, 0: off", unit="steps"),
        *(_make_register(0x60 + k, f"MSLUT{k}", "W", 32, "microstep table", reset=word) for k, word in enumerate((
            0xAAAAB554, 0x4A9554AA, 0x24492929, 0x10104222, 0xFBFFFFFF, 0xB5BB777D, 0x49295556, 0x00404222))),
        _make_register(0x68, "MSLUTSEL", "W", 32, "microstep table segments", reset=0xFFFF8056),
        _make_register(0x69, "MSLUTSTART", "W", 24, "microstep table start", reset=0x00F70000),
        _make_register(0x6A, "MSCNT", "R", 10, "microstep counter"),
        _make_register(0x6B, "MSCURACT", "R", 25, "microstep currents",
           _make_fields(("8..0", "cur_a", "phase A, signed"), ("24..16", "cur_b", "phase B, signed"))),
        _make_register(0x6C, "CHOPCONF", "RW", 32, "chopper", _CHOPCONF, reset=0x10410150),
        _make_register(0x6D, "COOLCONF", "W", 25, "CoolStep and StallGuard", _COOLCONF),
        _make_register(0x6E, "DCCTRL", "W", 24, "dcStep"),
        _make_register(0x6F, "DRV_STATUS", "R", 32, "driver status", _DRV_STATUS),
        _make_register(0x70, "PWMCONF", "W", 32, "StealthChop", _PWMCONF, reset=0xC40C001E),
        _make_register(0x71, "PWM_SCALE", "R", 25, "StealthChop amplitude"),
        _make_register(0x72, "PWM_AUTO", "R", 24, "StealthChop automatic values"),
        _make_register(0x73, "LOST_STEPS", "R", 20, "dcStep"),
    ),
    (
        Word("SPI_STATUS", "first byte of every answer", _make_fields(
            (7, "status_stop_r", "right switch"), (6, "status_stop_l", "left switch"), (5, "position_reached", "at XTARGET"),
            (4, "velocity_reached", "at VMAX"), (3, "standstill", "standstill"), (2, "sg2", "stall"),
            (1, "driver_error", "driver error"),
            (0, "reset_flag", "was reset"))),
    ),
)  # fmt: skip

READABLE_REGISTERS = {r.number: r for r in MAP.registers if "R" in r.access}
WRITABLE_REGISTERS = {r.number: r for r in MAP.registers if "W" in r.access}
REGISTER_NUMBERS = {r.name: r.number for r in MAP.registers}
IS_READABLE = tuple(int(a in READABLE_REGISTERS) for a in range(REGISTERS))
STORED_BITS = tuple(WRITABLE_REGISTERS[a].mask if a in WRITABLE_REGISTERS else 0 for a in range(REGISTERS))
"""Bits that a write stores, by address."""
RESET_VALUES = tuple(
    (WRITABLE_REGISTERS.get(a) or READABLE_REGISTERS[a]).reset or 0
    if a in WRITABLE_REGISTERS or a in READABLE_REGISTERS
    else 0
    for a in range(REGISTERS)
)
