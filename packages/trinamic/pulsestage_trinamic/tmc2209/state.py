"""State record of a TMC2209 on a STEP/DIR axis, its pins, and the constants that several modules share."""

from __future__ import annotations

from pulsestage_trinamic import motor_field
from pulsestage_trinamic.tmc2209.maps import MAP, REGISTER_NUMBERS, REGISTERS
from stage.chips.stepdir import state as lines
from stage.native import record

NEVER = lines.NEVER
UART_QUEUE_BYTES = 64
"""Largest number of bytes on the way to the chip, and of bytes that the chip has sent and the host has not read."""
MAX_DATAGRAM_BYTES = 8
IGNORED_KIND_COUNT = 6
BAD_RATE, BAD_SYNC, BAD_CRC, OTHER_ADDRESS, NO_REGISTER, READ_ONLY = range(IGNORED_KIND_COUNT)
"""Kinds of datagrams of the host that do nothing, for diagnostics."""
MAX_TSTEP = 0xFFFFF

STATE = record(
    [
        *((name, lines.STATE[name]) for name in lines.STATE.names),
        # what the chip is fitted with
        ("f_clk", "i8"),  # clock of the chip itself, Hz
        ("rsense", "f8"),  # ohm
        ("vref", "f8"),  # share of 2.5 V at VREF
        ("ir_share", "f8"),  # voltage of one ampere in a winding, as a share of the supply
        # sequencer: places of the field are in 1/256 full steps
        *motor_field.STATE_FIELDS,
        ("followed", "i8"),  # `net` up to which the field has followed the steps
        ("mscnt", "i8"),
        ("stepped", "i8"),  # clock of the last step of the field
        ("period", "i8"),  # clocks between its last two steps, 0 at rest
        ("direction", "i8"),  # direction of the field's last step, 1 or -1
        ("full", "i8"),  # full steps, for the means of the load
        ("next_step", "i8"),  # clock of the next internal step (VACTUAL), or NEVER
        ("velocity_since", "i8"),  # clock at which VACTUAL was written
        ("velocity_steps", "i8"),  # internal steps since then
        ("toggle", "i8"),  # level of INDEX with index_step
        # current and load
        ("current", "i8"),  # of common_power_stage: RUNS, FALLS or HOLDS
        ("cs", "i8"),  # CS_ACTUAL
        ("falls", "i8"),  # clock of the next step down, or NEVER
        ("passed", "i8"),  # speed thresholds that are passed
        ("sg", "i8"),  # SG_RESULT
        ("stall", "i8"),  # the last measurement was a stall, in the speed window
        ("count", "i8"),  # CoolStep: measurements above its window
        ("cooling", "i8"),
        ("lam", "i8"),
        ("emf", "i8"),
        ("load_of", "i8"),
        ("load_n", "i8"),
        ("load_sum", "i8"),
        ("emf_sum", "i8"),
        # status
        ("gstat", "i8"),
        ("shorts", "i8"),  # latched
        ("hot", "i8"),  # shut down by overtemperature
        ("ifcnt", "i8"),
        ("registers", "i8", (REGISTERS,)),
        # UART
        ("bit_ns", "i8"),  # time of a bit of the host
        ("to_chip", "i8", (UART_QUEUE_BYTES,)),  # bytes of the host
        ("queued", "i8"),  # how many
        ("delivered", "i8"),  # how many of them have arrived
        ("arrives", "i8"),  # clock of the end of the next byte, or NEVER
        ("datagram", "i8", (MAX_DATAGRAM_BYTES,)),
        ("received", "i8"),  # bytes of the present datagram
        ("byte_begin", "i8"),  # clock of the start bit of the last byte
        ("byte_end", "i8"),  # clock of its stop bit
        ("lost_sync", "i8"),  # waits for an idle line
        ("reply", "i8", (MAX_DATAGRAM_BYTES,)),
        ("replied", "i8"),  # bytes of the reply that are sent; MAX_DATAGRAM_BYTES: no reply is on its way
        ("replies", "i8"),  # clock of the end of the next byte of the reply, or NEVER
        ("to_host", "i8", (UART_QUEUE_BYTES,)),  # bytes of the chip
        ("sent", "i8"),  # how many
        ("collected", "i8"),  # how many of them the host has read
        ("datagrams", "i8"),  # datagrams of the host for this chip
        ("others", "i8"),  # bytes of other chips on the wire
        ("mistakes", "i8", (IGNORED_KIND_COUNT,)),  # number of each kind since power-up, see BAD_RATE
        ("mistake_clock", "i8", (IGNORED_KIND_COUNT,)),  # clock of the first of each kind
        ("mistake_detail", "i8", (IGNORED_KIND_COUNT,)),  # its byte, address or register
    ]
)
"""State of one STEP/DIR axis with a TMC2209."""

_FAULT_AND_OUTPUT_NAMES = (
    "ms1", "ms2", "pdn", "spread", "otpw", "ot", "s2ga", "s2gb", "s2vsa", "s2vsb", "ola", "olb", "uv_cp", "diag", "index",
)  # fmt: skip
INPUTS = {**lines.INPUTS, **{name: 1 << (len(lines.INPUTS) + k) for k, name in enumerate(_FAULT_AND_OUTPUT_NAMES)}}
"""Pins of the lines, and those of the chip. The last two are its outputs, which the host reads as it reads the switches."""
MS1, MS2, PDN, SPREAD, OTPW, OT, S2GA, S2GB, S2VSA, S2VSB, OLA, OLB, UV_CP, DIAG, INDEX = (
    INPUTS[name] for name in _FAULT_AND_OUTPUT_NAMES
)
CHIP_DRIVEN_PINS = DIAG | INDEX
SHORT_G, SHORT_VS = S2GA | S2GB, S2VSA | S2VSB
OUTPUTS = lines.OUTPUTS

GCONF, GSTAT, IFCNT, SLAVECONF, IOIN, IHOLD_IRUN, TPOWERDOWN, TSTEP, TPWMTHRS, TCOOLTHRS, VACTUAL = (
    REGISTER_NUMBERS[name]
    for name in (
        "GCONF", "GSTAT", "IFCNT", "SLAVECONF", "IOIN", "IHOLD_IRUN", "TPOWERDOWN", "TSTEP", "TPWMTHRS", "TCOOLTHRS", "VACTUAL",
    )
)  # fmt: skip
SGTHRS, SG_RESULT, COOLCONF, MSCNT, MSCURACT, CHOPCONF, DRV_STATUS, PWMCONF, PWM_SCALE, PWM_AUTO = (
    REGISTER_NUMBERS[name]
    for name in (
        "SGTHRS", "SG_RESULT", "COOLCONF", "MSCNT", "MSCURACT", "CHOPCONF", "DRV_STATUS", "PWMCONF", "PWM_SCALE", "PWM_AUTO",
    )
)  # fmt: skip
I_SCALE_ANALOG, EN_SPREADCYCLE, SHAFT, INDEX_OTPW, INDEX_STEP, PDN_DISABLE, MSTEP_REG_SELECT = MAP.masks(
    "GCONF", "i_scale_analog", "en_spreadcycle", "shaft", "index_otpw", "index_step", "pdn_disable", "mstep_reg_select"
)
VSENSE, INTPOL, DEDGE = MAP.masks("CHOPCONF", "vsense", "intpol", "dedge")
FAST, COOL = 1, 2  # thresholds that are passed: TPWMTHRS, TCOOLTHRS
