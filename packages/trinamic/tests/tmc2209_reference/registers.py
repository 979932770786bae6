"""Registers of the TMC2209 as section 5 of the data sheet lists them: access, bits, fields, and value after a reset.

Sources: the pages of revision 1.03 and the tables of revision 1.09. The values after a reset are those of an OTP memory that nobody
has programmed, from its table in section 5.1.1: TBL 2, PWM_GRAD 14, PWM_FREQ 1, PWM_REG 8, PWM_OFS 36, IHOLD 16, IHOLDDELAY 1.
Chips that are read just after power-up have them, too.
"""

CHOPCONF_RESET = 3 << 0 | 5 << 4 | 0 << 7 | 2 << 15 | 1 << 28  # TOFF, HSTRT, HEND, TBL, intpol
PWMCONF_RESET = 36 << 0 | 14 << 8 | 1 << 16 | 1 << 18 | 1 << 19 | 8 << 24 | 12 << 28

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
    0x6C: ("CHOPCONF", "RW", 32, CHOPCONF_RESET),
    0x6F: ("DRV_STATUS", "R", 32, None),
    0x70: ("PWMCONF", "RW", 32, PWMCONF_RESET),
    0x71: ("PWM_SCALE", "R", 25, None),
    0x72: ("PWM_AUTO", "R", 24, None),
}
"""Number -> name, access, bits, value after a reset; None where the value depends on pins or on the motor."""

FIELDS = {
    "GCONF": "i_scale_analog 0, internal_rsense 1, en_spreadcycle 2, shaft 3, index_otpw 4, index_step 5, pdn_disable 6, "
    "mstep_reg_select 7, multistep_filt 8, test_mode 9",
    "GSTAT": "reset 0, drv_err 1, uv_cp 2",
    "SLAVECONF": "senddelay 8-11",
    "OTP_PROG": "otpbit 0-2, otpbyte 4-5, otpmagic 8-15",
    "OTP_READ": "otp_fclktrim 0-4, otp_ottrim 5, otp_internal_rsense 6, otp_tbl 7, otp_pwm_grad 8-11, otp_pwm_autograd 12, "
    "otp_tpwmthrs 13-15, otp_pwm_ofs 16, otp_pwm_reg 17, otp_pwm_freq 18, otp_iholddelay 19-20, otp_ihold 21-22, "
    "otp_en_spreadcycle 23",
    "IOIN": "enn 0, ms1 2, ms2 3, diag 4, pdn_uart 6, step 7, spread_en 8, dir 9, version 24-31",
    "FACTORY_CONF": "fclktrim 0-4, ottrim 8-9",
    "IHOLD_IRUN": "ihold 0-4, irun 8-12, iholddelay 16-19",
    "COOLCONF": "semin 0-3, seup 5-6, semax 8-11, sedn 13-14, seimin 15",
    "MSCURACT": "cur_a 0-8, cur_b 16-24",
    "CHOPCONF": "toff 0-3, hstrt 4-6, hend 7-10, tbl 15-16, vsense 17, mres 24-27, intpol 28, dedge 29, diss2g 30, diss2vs 31",
    "DRV_STATUS": "otpw 0, ot 1, s2ga 2, s2gb 3, s2vsa 4, s2vsb 5, ola 6, olb 7, t120 8, t143 9, t150 10, t157 11, "
    "cs_actual 16-20, stealth 30, stst 31",
    "PWMCONF": "pwm_ofs 0-7, pwm_grad 8-15, pwm_freq 16-17, pwm_autoscale 18, pwm_autograd 19, freewheel 20-21, pwm_reg 24-27, "
    "pwm_lim 28-31",
    "PWM_SCALE": "pwm_scale_sum 0-7, pwm_scale_auto 16-24",
    "PWM_AUTO": "pwm_ofs_auto 0-7, pwm_grad_auto 16-23",
}
"""Register -> its fields with their bits; the others are one number."""
EVIDENCE = {"cur_a": "?", "cur_b": "?"}
"""Fields that the revisions of the data sheet do not agree about; all others are S."""
