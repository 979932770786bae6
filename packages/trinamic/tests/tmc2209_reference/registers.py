"""Registers of the TMC2209 as pages 19 to 33 of the data sheet (rev. 1.03) list them: access, bits and value after a reset.

The values after a reset assume an OTP memory that nobody has programmed: StealthChop, IHOLD 16, IHOLDDELAY 1.
"""

REGISTERS = {
    0x00: ("GCONF", "RW", 10, 0x101),
    0x01: ("GSTAT", "RW", 3, 0x1),
    0x02: ("IFCNT", "R", 8, 0),
    0x03: ("SLAVECONF", "W", 12, 0),
    0x04: ("OTP_PROG", "W", 16, 0),
    0x05: ("OTP_READ", "R", 24, 0),
    0x06: ("IOIN", "R", 32, None),
    0x07: ("FACTORY_CONF", "RW", 10, 0),
    0x10: ("IHOLD_IRUN", "W", 20, 16 | 31 << 8 | 1 << 16),
    0x11: ("TPOWERDOWN", "W", 8, 20),
    0x12: ("TSTEP", "R", 20, 0xFFFFF),
    0x13: ("TPWMTHRS", "W", 20, 0),
    0x14: ("TCOOLTHRS", "W", 20, 0),
    0x22: ("VACTUAL", "W", 24, 0),
    0x40: ("SGTHRS", "W", 8, 0),
    0x41: ("SG_RESULT", "R", 10, 0),
    0x42: ("COOLCONF", "W", 16, 0),
    0x6A: ("MSCNT", "R", 10, 0),
    0x6B: ("MSCURACT", "R", 25, None),
    0x6C: ("CHOPCONF", "RW", 32, 0x10000053),
    0x6F: ("DRV_STATUS", "R", 32, None),
    0x70: ("PWMCONF", "RW", 32, 0xC10D0024),
    0x71: ("PWM_SCALE", "R", 25, None),
    0x72: ("PWM_AUTO", "R", 24, None),
}
"""Number -> name, access, bits, value after a reset; None where the value depends on pins or on the motor."""
