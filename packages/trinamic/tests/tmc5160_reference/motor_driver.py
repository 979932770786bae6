"""Driver half and encoder of the reference TMC5160, one clock at a time (its page's sections 6 and 7 in brackets).

A mixin of tmc5160.Reference, which has the registers `r`, the pins as sampled at the last clock `sampled`, and the ramp.
"""

import math

INFINITE = 0xFFFFF  # TSTEP at standstill
SHORTS = ("s2ga", "s2gb", "s2vsa", "s2vsb")
FAULTS = (*SHORTS, "ot", "otpw", "ola", "olb", "uv_cp")


def signed(word, bits=32):
    """Return the word as a signed number in two's complement."""
    half = 1 << (bits - 1)
    return (word + half) % (2 * half) - half


def sine(index):
    """Return CUR_A of the default table at MSCNT = index [6 sequencer]."""
    index %= 1024
    if index >= 512:
        return -sine(index - 512) - 1
    if index >= 256:
        return sine(511 - index)
    return math.floor(248 * math.sin(2 * math.pi * index / 1024 + math.pi / 1024) + 0.5) - 1


class Driver:
    def reset_driver(self):
        self.mscnt = 0
        self.since = 0  # clocks since the last step
        self.current = 0  # CS_ACTUAL
        self.phase = "run"  # then "down", then "hold"
        self.down_timer = self.down_period = 0
        self.states = {"TPWMTHRS": False, "TCOOLTHRS": False, "THIGH": False}
        self.lam, self.emf = 0, 1024
        self.sg_result, self.stalled = 0, False
        self.sg_sum = self.sg_count = 0
        self.cool_count, self.cooling = 0, False
        self.faults = dict.fromkeys(FAULTS, False)  # present now
        self.shorted = dict.fromkeys(SHORTS, False)  # seen, until the driver is switched off
        self.overheated = False  # from ot until otpw has gone, too
        self.fraction = 0
        self.last_a = self.last_b = False
        self.last_condition = True  # all levels low, ENCMODE 0: low active
        self.condition_used = False

    # Fields

    mres = property(lambda self: min(self.r["CHOPCONF"] >> 24 & 15, 8))
    toff = property(lambda self: self.r["CHOPCONF"] & 15)
    ihold = property(lambda self: self.r["IHOLD_IRUN"] & 31)
    irun = property(lambda self: self.r["IHOLD_IRUN"] >> 8 & 31)
    ihold_delay = property(lambda self: self.r["IHOLD_IRUN"] >> 16 & 15)
    sfilt = property(lambda self: self.r["COOLCONF"] >> 24 & 1)

    # Sequencer

    def sequence(self, direction):
        """Advance the table by one step and return whether MSCNT >> 8 changed: a full step."""
        before = self.mscnt
        if self.r["GCONF"] & 0x10:  # shaft
            direction = -direction
        size = 1 << self.mres
        half = size >> 1
        if size == 1:
            after = before + direction
        elif direction > 0:
            after = (before + half) // size * size + half
        else:
            after = (-((half - before) // size) - 1) * size + half  # -(-a // b) is ceil(a / b)
        self.mscnt = after % 1024
        return before >> 8 != self.mscnt >> 8

    def mscuract(self):
        return sine(self.mscnt) & 0x1FF | (sine(self.mscnt + 256) & 0x1FF) << 16

    # Standstill and current

    @property
    def standstill(self):
        return self.since >= self.standstill_limit()

    def standstill_limit(self):
        return 1 << 18 if self.r["GCONF"] & 2 else 1 << 20

    def step_restarts_current(self):
        self.since = 0
        if self.phase != "run":
            self.phase = "run"
            self.current = self.irun

    def current_clock(self):
        """Advance the current control by one clock, after the step of that clock."""
        if self.phase == "run" and self.since >= self.standstill_limit() + (self.r["TPOWERDOWN"] << 18):
            self.phase = "down"
            self._load_period()
        elif self.phase == "down":
            self.down_timer += 1
            if self.down_timer == self.down_period:
                self.current += 1 if self.ihold > self.current else -1
                self._load_period()

    def _load_period(self):
        """Load the delay period. Choice: IHOLDDELAY is read only here, so a period in progress keeps its length."""
        self.down_timer = 0
        self.down_period = self.ihold_delay << 18
        if self.down_period == 0:
            self.current = self.ihold
        self._arrive()

    def _arrive(self):
        if self.phase == "down" and self.current == self.ihold:
            self.phase = "hold"

    def current_written(self):
        if self.phase == "run":
            self.current = self.irun
        elif self.phase == "hold":
            self.current = self.ihold
        self._arrive()

    # TSTEP and what hangs on it

    def tstep(self):
        speed = self.q >> 17
        if speed == 0 or self.gated():
            return INFINITE
        return min(INFINITE, ((1 << 24) // speed) >> self.mres)

    def thresholds(self):
        """Update the speed thresholds, after step 5 of a clock and after a write."""
        self.checked_speed = self.q >> 17
        tstep = self.tstep()
        for name in self.states:
            limit = self.r[name]
            low = limit * 31 // 32 - 1 if self.r["GCONF"] & 1 << 14 else limit * 15 // 16 - 1
            if limit == 0 or tstep > limit or (name == "TPWMTHRS" and tstep >= limit):
                self.states[name] = False
            elif tstep <= low:
                self.states[name] = True
        cooling = self.r["COOLCONF"] & 15 != 0 and self.cool and not self.high and not self.stealth
        if self.cooling and not cooling and self.phase == "run":
            self.current = self.irun
        if not cooling:
            self.cool_count = 0
        self.cooling = cooling
        self.stall_guard_rests()

    cool = property(lambda self: self.states["TCOOLTHRS"])
    high = property(lambda self: self.states["THIGH"])

    @property
    def stealth(self):
        return bool(self.r["GCONF"] & 4) and not (self.states["TPWMTHRS"] or self.cool or self.high)

    @property
    def full_step_active(self):
        return bool(self.r["CHOPCONF"] & 1 << 18) and self.high

    @property
    def stall_window(self):
        return self.cool and not self.stealth and not self.full_step_active

    # StallGuard, CoolStep

    def stall_guard_rests(self):
        if self.standstill:
            self.sg_sum = self.sg_count = 0
        if self.standstill or self.stealth or not self.driver_on:
            self.sg_result, self.stalled = 0, False

    def measure(self):
        """Measure the load at a full step and return whether there is a new SG_RESULT."""
        if self.stealth or not self.driver_on:
            return False
        raw = 1023 * self.emf * (1024 - self.lam) >> 20
        value = max(0, min(1023, raw + 8 * signed(self.r["COOLCONF"] >> 16, 7)))
        if self.sfilt:
            self.sg_sum += value
            self.sg_count += 1
            if self.sg_count < 4:
                return False
            value = self.sg_sum >> 2
            self.sg_sum = self.sg_count = 0
        self.sg_result = value
        self.stalled = value == 0  # choice: with sfilt of the four's mean, as SG_RESULT itself
        if self.cooling:
            self._cool_step()
        return True

    def _cool_step(self):
        conf = self.r["COOLCONF"]
        low_limit, span = conf & 15, conf >> 8 & 15
        if self.sg_result < 32 * low_limit:
            self.current = min(self.irun, self.current + (1 << (conf >> 5 & 3)))
            self.cool_count = 0
        elif self.sg_result >= 32 * (low_limit + span + 1):
            self.cool_count += 1
            if self.cool_count >= (32, 8, 2, 1)[conf >> 13 & 3]:
                self.current = max(self.irun >> (2 if conf & 0x8000 else 1), self.current - 1)
                self.cool_count = 0
        else:
            self.cool_count = 0

    # Faults

    @property
    def driver_on(self):
        off = self.sampled["DRV_ENN"] or self.toff == 0
        return not (off or any(self.shorted.values()) or self.overheated or self.faults["uv_cp"])

    def set_fault(self, name, present):
        """Set or clear a fault, effective from the next clock on."""
        if name not in self.faults:
            raise KeyError(f"no fault {name!r}; there are {', '.join(FAULTS)}")
        self.faults[name] = bool(present)
        self.touched = True

    def shorts_released(self):
        """Clear the short flags while the driver is off; a short that persists is detected again when it is on."""
        if self.sampled["DRV_ENN"] or self.toff == 0:
            self.shorted = dict.fromkeys(SHORTS, False)

    def faults_clock(self):
        self.shorts_released()
        if not self.sampled["DRV_ENN"] and self.toff != 0:
            for name in SHORTS:
                ignored = self.r["CHOPCONF"] & (1 << 30 if name.startswith("s2g") else 1 << 31)
                if self.faults[name] and not ignored:
                    self.shorted[name] = True
        self.overheated = self.faults["ot"] or (self.overheated and self.faults["otpw"])
        if any(self.shorted.values()) or self.overheated:
            self.r["GSTAT"] |= 2
        if self.faults["uv_cp"]:
            self.r["GSTAT"] |= 4

    def drv_status(self):
        bits = {
            12: self.shorted["s2vsa"], 13: self.shorted["s2vsb"], 14: self.stealth, 15: self.full_step_active,
            24: self.stalled, 25: self.overheated, 26: self.faults["otpw"], 27: self.shorted["s2ga"],
            28: self.shorted["s2gb"], 29: self.faults["ola"], 30: self.faults["olb"], 31: self.standstill,
        }  # fmt: skip
        return self.sg_result | self.current << 16 | sum(1 << bit for bit, on in bits.items() if on)

    # Encoder [7]

    def encoder_clock(self):
        a, b, n = self.sampled["ENCA_DCIN_CFG5"], self.sampled["ENCB_DCEN_CFG4"], self.sampled["ENCN_DCO_CFG6"]
        a_moved, b_moved = a != self.last_a, b != self.last_b
        self.last_a, self.last_b = a, b
        if a_moved != b_moved:  # both at once are not counted
            self._count(1 if (a != b) == a_moved else -1)
        mode = self.r["ENCMODE"]
        condition = n == bool(mode & 4) and (bool(mode & 8) or (a == bool(mode & 1) and b == bool(mode & 2)))
        rose, fell = condition and not self.last_condition, self.last_condition and not condition
        self.last_condition = condition
        if not condition:
            self.condition_used = False
        edges = mode >> 6 & 3
        event = (condition and not self.condition_used) if edges == 0 else (edges & 1 and rose) or (edges & 2 and fell)
        if event and mode & 0x30:
            self._n_event(mode)
            self.condition_used = condition

    def _n_event(self, mode):
        self.r["ENC_LATCH"] = self.r["X_ENC"]
        self.r["ENC_STATUS"] |= 1
        if mode & 0x100:
            self.r["X_ENC"] = self.fraction = 0  # choice: the fraction, too, as with a write
        if mode & 0x200:
            self.r["XLATCH"] = self.r["XACTUAL"]
        self.r["ENCMODE"] &= ~0x20  # clr_once

    def _count(self, direction):
        constant, unit = self.r["ENC_CONST"], 1 << 16
        if self.r["ENCMODE"] & 0x400:
            unit = 10000
        step = signed(constant >> 16, 16) * unit + (constant & 0xFFFF)
        count, self.fraction = divmod(self.r["X_ENC"] * unit + self.fraction + direction * step, unit)
        self.r["X_ENC"] = count & 0xFFFFFFFF

    def deviation(self):
        if abs(signed(self.r["X_ENC"] - self.r["XACTUAL"])) > self.r["ENC_DEVIATION"]:
            self.r["ENC_STATUS"] |= 2
