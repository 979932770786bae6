"""State record of a TMC5160, its pins, and the constants that several modules share."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from pulsestage_trinamic.tmc5160.maps import MAP, REGISTER_NUMBERS, REGISTERS
from stage.native import hot, record

NEVER = common_power_stage.NEVER
POSITION, PLUS, MINUS, HOLD = range(4)  # RAMPMODE
MAX_TSTEP = 0xFFFFF
PHASE_PER_STEP = 1 << 41  # of the phase
SPEED_SHIFT = 17  # q is in 2^-17 of the velocity unit

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("hz", "i8"),
        ("rsense", "f8"),  # ohm
        ("inputs", "i8"),  # INPUTS
        ("fresh", "i8"),  # an access or an edge acts at the next clock
        # ramp
        ("x", "i8"),  # XACTUAL
        ("target", "i8"),  # XTARGET
        ("q", "i8"),  # speed, 2^-17 of the velocity unit
        ("dir", "i8"),  # -1, 0, 1
        ("ph", "i8"),  # phase of the next step
        ("brk", "i8"),  # brakes for the target
        ("zw", "i8"),  # clocks that it still waits at zero
        ("events", "i8"),  # RAMP_STAT's latched bits
        ("reached", "i8"),  # position_reached
        # switches
        ("left", "i8"),
        ("right", "i8"),
        ("latched", "i8"),  # XLATCH
        # encoder
        ("enc", "i8"),  # X_ENC
        ("part", "i8"),  # its fraction
        ("enc_pins", "i8"),  # levels of A and B as last seen
        ("enc_met", "i8"),  # the condition of N: 1 as last seen, 2 its event is over
        ("enc_latch", "i8"),
        ("enc_flags", "i8"),  # ENC_STATUS
        ("fed", "i8"),  # somebody tells where the encoder's shaft is
        ("edge", "i8"),  # the last that it has passed
        ("seen", "i8"),  # clock at which it was at `shaft`
        ("shaft", "f8"),  # edges
        ("shaft_rate", "f8"),  # edges a clock
        # sequencer and current
        ("mscnt", "i8"),
        ("net", "i8"),  # field, 1/256 full steps since power-up
        ("toggle", "i8"),  # DIAG0 in step mode
        ("last_direction", "i8"),  # the last direction
        ("last", "i8"),  # clock of the last step
        ("current", "i8"),  # of common_power_stage: RUNS, FALLS, HOLDS
        ("falls", "i8"),  # clock at which the current falls by one
        ("cs", "i8"),  # CS_ACTUAL
        ("speeds", "i8"),  # thresholds passed: SLOW, COOL, HIGH
        ("cooling", "i8"),  # CoolStep is at work
        # StallGuard
        ("sg", "i8"),  # SG_RESULT
        ("stall", "i8"),  # DRV_STATUS b24
        ("total", "i8"),
        ("summed", "i8"),
        ("count", "i8"),  # of CoolStep
        ("lam", "i8"),  # load, 0 to 1024
        ("emf", "i8"),  # back EMF / supply, 0 to 1024
        ("full", "i8"),  # full steps measured
        ("load_of", "i8"),  # the full step that these are means of
        ("load_n", "i8"),
        ("load_sum", "i8"),
        ("emf_sum", "i8"),
        # faults
        ("gstat", "i8"),
        ("shorts", "i8"),  # latched: S2GA ... S2VSB
        ("hot", "i8"),  # off by overtemperature
        ("powered", "i8"),  # the power stage has been on since power-up
        # SPI
        ("csn", "i8"),
        ("shift", "i8"),  # 40 bits
        ("bits", "i8"),  # shifted since CSN fell
        ("answer", "i8"),  # what the next datagram gets
        ("out", "i8"),  # the last byte on SDO
        ("risen", "i8"),  # clock at which CSN went high
        ("shifted", "i8"),  # clock of the last byte
        ("heard", "i8"),  # the answer to the last whole datagram
        ("reg", "i8", (REGISTERS,)),  # what is stored as it was written
    ]
)
"""State of one TMC5160."""

REFL, REFR, ENCB, ENCA, DRV_ENN, ENCN, SD_MODE = (1 << k for k in range(7))  # as in IOIN
IOIN_PINS = 2 * SD_MODE - 1
S2GA, S2GB, S2VSA, S2VSB, OT, OTPW, OLA, OLB, UV_CP = (1 << k for k in range(8, 17))
INPUTS = {
    "refl": REFL, "refr": REFR, "encb": ENCB, "enca": ENCA, "drv_enn": DRV_ENN, "encn": ENCN,
    "s2ga": S2GA, "s2gb": S2GB, "s2vsa": S2VSA, "s2vsb": S2VSB, "ot": OT, "otpw": OTPW, "ola": OLA, "olb": OLB, "uv_cp": UV_CP,
}  # fmt: skip
"""Pin levels, and faults of the power stage, which happen only if a user sets them."""
SHORT_G, SHORT_VS = S2GA | S2GB, S2VSA | S2VSB
DIAG0, DIAG1 = 1, 2
OUTPUTS = {"diag0": DIAG0, "diag1": DIAG1}

(
    GCONF, GSTAT, IOIN, X_COMPARE, GLOBALSCALER, IHOLD_IRUN, TPOWERDOWN, TSTEP, TPWMTHRS, TCOOLTHRS, THIGH, RAMPMODE, XACTUAL,
    VACTUAL, VSTART, A1, V1, AMAX, VMAX, DMAX, D1, VSTOP, TZEROWAIT, XTARGET, SW_MODE, RAMP_STAT, XLATCH, ENCMODE, X_ENC, ENC_CONST,
    ENC_STATUS, ENC_LATCH, ENC_DEVIATION, MSCNT, MSCURACT, CHOPCONF, COOLCONF, DRV_STATUS, PWMCONF, PWM_AUTO,
) = (REGISTER_NUMBERS[name] for name in (
    "GCONF GSTAT IOIN X_COMPARE GLOBALSCALER IHOLD_IRUN TPOWERDOWN TSTEP TPWMTHRS TCOOLTHRS THIGH RAMPMODE XACTUAL VACTUAL "
    "VSTART A1 V1 AMAX VMAX DMAX D1 VSTOP TZEROWAIT XTARGET SW_MODE RAMP_STAT XLATCH ENCMODE X_ENC ENC_CONST ENC_STATUS "
    "ENC_LATCH ENC_DEVIATION MSCNT MSCURACT CHOPCONF COOLCONF DRV_STATUS PWMCONF PWM_AUTO").split())  # fmt: skip

FAST_STANDSTILL, EN_PWM, SHAFT, DIAG0_STEP, DIAG1_DIR, SMALL_HYSTERESIS, STOP_ENABLE = MAP.masks(
    "GCONF", "faststandstill", "en_pwm_mode", "shaft", "diag0_step", "diag1_dir", "small_hysteresis", "stop_enable")  # fmt: skip
(
    STOP_L, STOP_R, POL_L, POL_R, SWAP, LATCH_L_ON, LATCH_L_OFF, LATCH_R_ON, LATCH_R_OFF, LATCH_ENCODER, SG_STOP, SOFT_STOP,
) = MAP.masks(
    "SW_MODE", "stop_l_enable", "stop_r_enable", "pol_stop_l", "pol_stop_r", "swap_lr", "latch_l_active", "latch_l_inactive",
    "latch_r_active", "latch_r_inactive", "en_latch_encoder", "sg_stop", "en_softstop")  # fmt: skip
(
    STATUS_L, STATUS_R, LATCHED_L, LATCHED_R, EVENT_L, EVENT_R, EVENT_SG, EVENT_POS, VELOCITY_REACHED, POSITION_REACHED, VZERO,
    ZEROWAIT, SECOND_MOVE, STATUS_SG,
) = (f.mask for f in MAP.register("RAMP_STAT").fields)  # fmt: skip
WRITE_TO_CLEAR_EVENTS = SECOND_MOVE | EVENT_POS | EVENT_SG | LATCHED_R | LATCHED_L
VHIGHFS = MAP.mask("CHOPCONF", "vhighfs")
SFILT = MAP.mask("COOLCONF", "sfilt")
SLOW, COOL, HIGH = 1, 2, 4  # above TPWMTHRS, TCOOLTHRS, THIGH


@hot
def to_signed32(number):
    """Return the low 32 bits of a number as a two's complement value."""
    return ((number + 0x80000000) & 0xFFFFFFFF) - 0x80000000


@hot
def get_step_shift(c):
    """Return MRES of the TMC5160, at most 8: a step advances MSCNT by 2^MRES."""
    power = c.reg[CHOPCONF] >> 24 & 15
    return 8 if power > 8 else power
