"""The PCL-240MK and PCL-240MS one reference clock at a time: what they add to the PCL-240K of pcl240.py.

R1x (octal) is registers[8 + x]. Section numbers of shared/spec/pcl240.md in brackets.
"""

from math import isqrt

from reference.pcl240 import INPUTS, ReferencePCL240K

R10, R12, R13, R14, R15, R17 = 8, 10, 11, 12, 13, 15
WORD = 0xFFFFFF
NAMES = (*(f"R{n}" for n in range(8)), *(f"R1{n}" for n in range(8)))
EZ_MONITOR = 0x1F0000  # bits 20..16 of R17


class ReferencePCL240MK(ReferencePCL240K):
    # Choice: R14 and R15 are as wide on the MK, where they do nothing
    WIDTHS = (24, 13, 13, 13, 14, 14, 20, 10, 24, 24, 24, 24, 16, 12, 24, 24)
    # Bits that no write changes: R13 b23 is 0 on the MK [seed 2-1]; R17 b20..16 came with the MS [seed 1]. Choice: 0, too
    FIXED = ((R13, 0x800000), (R17, EZ_MONITOR))
    INPUTS = (*INPUTS, "ez")
    CONTROL_BITS, SELECT_BITS, OUTPUT_BITS = 0x3F, 0x37, 0x39

    def __init__(self, leader=None):
        self.ez_sample = False
        super().__init__(leader)

    def reset(self):
        """Choice: collective latches are cleared too; the last sample of EZ belongs to the pin, as that of EXTP."""
        super().reset()
        self.write_latch = self.read_latch = 0
        self._forget_the_run()

    def _forget_the_run(self):
        self.rising = False  # the last step 3 found goal > speed
        self.rising_pulses = 0
        self.ramped_down = self.automatic_off = False  # the automatic point has come; a write switched it off
        self.org_seen = self.ez_counting = False
        self.ez_count = None  # None: as R13 says

    # Bus [1], [2]

    collective = property(lambda self: bool(self.select & 0x20))
    number = property(lambda self: self.select & 7 | (self.select & 0x10) >> 1)

    def _write_byte(self, shift, value):
        if not self.collective:
            super()._write_byte(shift, value)
        elif shift:
            # Held until the low byte comes. Choice: only a collective write changes it, and a transfer does not [7]
            self.write_latch = self.write_latch & ~(0xFF << shift) | value << shift
        else:
            self._store(self.number, self.write_latch | value)

    def _store(self, number, word):
        super()._store(number, word & ~dict(self.FIXED).get(number, 0))
        if self.running and number in (1, 4, 5, R14, R15):
            # Choice: any byte and value does, whether automatic is on at the moment or not, R14 and R15 on the MK too
            self.automatic_off = True

    def _read_byte(self, shift):
        if self.collective and shift < 16:
            return self.read_latch >> shift & 0xFF
        word = self.value(self.number if self.output_mode & 0x08 else 0)
        if self.collective:
            self.read_latch = word
        return word >> shift & 0xFF

    def value(self, number):
        """A register as it reads."""
        return self.registers[number]

    # Polarity [5 fine points]. Choice: an edge is one of the pin as the chip reads it, so a new logic makes one, too
    org = property(lambda self: self.pins.org != bool(self.registers[R13] >> 23 & 1))
    ez = property(lambda self: self.pins.ez != bool(self.registers[R12] >> 12 & 1))

    def values(self):
        """All registers by name, and the status."""
        return {name: self.value(n) for n, name in enumerate(NAMES)} | {"status": self.status()}

    def _reset_command(self):
        super()._reset_command()
        self.registers[6] = 0  # [2]; Choice: whether running or not

    # Runs

    def _run(self):
        self._forget_the_run()
        super()._run()

    def _stop(self):
        super()._stop()
        self.ez_count = None  # Choice: any stop reloads the EZ counter

    def tick(self):
        # Choice: an EZ edge is released to asserted
        self.ez_edge, self.ez_sample = self.ez and not self.ez_sample, self.ez
        return super().tick()

    def _origin_return(self):
        """[8]. Choice: once ORG has been seen the return goes on whatever is written to control D0 and R13 b21."""
        if self.control & 1 and self.org:
            if not self.registers[R13] >> 21 & 1:
                self._stop()
                return
            self.org_seen = True
        if not self.org_seen:
            return
        at_fl = not self.ramps or self.speed <= self.registers[1]
        # Choice: the tick that meets the condition counts its edge; b20 is live until then
        self.ez_counting |= not self.registers[R13] >> 20 & 1 or at_fl
        if self.ez_counting and self.ez_edge:
            count = self.ez_preset if self.ez_count is None else self.ez_count
            if count == 0:
                self._stop()
            else:
                self.ez_count = count - 1

    ez_preset = property(lambda self: self.registers[R13] >> 16 & 15)

    def _pulse_begins(self):
        if self.control & 0x20:
            self.registers[R10] = self.registers[R10] + self.direction & WORD
        self.rising_pulses += self.rising  # Choice: whether the automatic point is on or not, whoever counts R0

    # Speed [5], [7]

    def _speed_control(self):
        self.rising = False
        super()._speed_control()

    def _ramp(self):
        if self.automatic and self.registers[0] <= self.rising_pulses + self.offset:
            # Choice: tested here only, so status shows it from this tick on; nothing but a new run takes it back
            self.ramped_down = True
        self.rising = self.goal() > self.speed  # before this tick's step
        super()._ramp()

    # Choice: control D4 and preset act at once, in motion too
    automatic = property(lambda self: bool(self.control & 0x10) and self.preset and not self.automatic_off)

    @property
    def offset(self):
        """R6 as a signed number."""
        sign = 1 << self.WIDTHS[6] - 1
        return (self.registers[6] ^ sign) - sign

    def goal(self):
        return self.registers[1] if self.org_seen or self.ramped_down else super().goal()

    def _ramping_down_point(self):
        return not self.automatic and super()._ramping_down_point()

    def rate(self, direction):
        return self.registers[4 if direction > 0 or self.ramped_down else 5]


class ReferencePCL240MS(ReferencePCL240MK):
    WIDTHS = (24, 13, 13, 13, 16, 16, 24, 10, 24, 24, 24, 24, 16, 12, 24, 24)
    FIXED = ((R17, EZ_MONITOR),)

    def value(self, number):
        """A register as it reads. R17 has the EZ monitor, as the list of additions in the data sheet says [seed 1, 2-4]."""
        if number != R17:
            return super().value(number)
        count = self.ez_preset if self.ez_count is None else self.ez_count
        # Choice: the EZ signal is the pin at the moment of the read, not its last sample
        return self.registers[R17] | count << 16 | self.ez << 20

    def _forget_the_run(self):
        super()._forget_the_run()
        self.revised = {}  # register number: speed that the run uses in its place
        self.s_curve = None

    def _run(self):
        super()._run()
        if self.ramps and self.automatic and not self.registers[R14] >> 15:
            self._correct_fh()

    # Choice: a revised speed stands for its register all through the run: after writes to it, at constant speed
    selected_speed = property(lambda self: self.revised.get(self.speed_register, self.registers[self.speed_register]))

    def _correct_fh(self):
        """The sheet's 3-4.1 and 3-4.2 with R4 for R5, every inequality multiplied by R7, so R7 = 0 divides nothing."""
        if self.speed_register == 1:
            return  # FL selected: there is no FH register to correct
        r0, r1, fh, r4 = (self.registers[n] for n in (0, 1, self.speed_register, 4))
        r7, r14, r15 = self.multiplier, self.registers[R14] & 0xFFF, self.registers[R15]
        rates = r4 + r4
        linear_ramps = self.registers[R14] >> 12 & 1
        no_linear_part = linear_ramps or 0 in (r14, r15) or 2 * max(r14, r15) >= fh - r1
        if not no_linear_part:
            # with R4 = R5 the sheet's three cases are one
            longer = max(r14, r15)
            no_linear_part = r0 * r7 * 8192 <= (r1 + longer) * r4 * (r14 + r15 + 2 * longer)
        if no_linear_part:
            if r0 * r7 * 16384 <= (fh**2 - r1**2) * rates:
                self.revised = {self.speed_register: isqrt(r0 * r7 * 16384 // rates + r1**2) if rates else fh}
        elif r0 * r7 * 32768 <= (r1 + fh) * ((fh - r1) * rates + 2 * r4 * (r14 + r15)):
            a, b = r4 * (r14 + r15), rates
            root = isqrt((a - b * r1) ** 2 + b * r0 * r7 * 32768)
            self.revised = {self.speed_register: (root - a) // b}

    def _ramp_clock(self, direction, first):
        goal = self.goal()
        if first or (self.s_curve and goal != self.s_curve.goal):
            # Choice: a ramp, linear or not, keeps its shape, so R14 b12 written in a linear ramp acts at the next one
            self.s_curve = None if self.registers[R14] >> 12 & 1 else SCurve(self, goal, direction)
            first = True
        if self.s_curve is None:
            super()._ramp_clock(direction, first)
        elif self.s_curve.tick():
            self.speed += direction

    def tail_of_the_ramp(self):
        return self.s_curve.clocks_left() if self.s_curve else super().tail_of_the_ramp()


class SCurve:
    """One S-curve ramp [7]: the k-th step happens when c >= t(k) upwards, when c - 1 >= t(k - 1) downwards.

    A register revised meanwhile acts from the next step on: at that step c becomes the count at which the ramp, had it run
    with the new values all the time, takes this very step. So the steps to come keep their distances in that ramp.
    Choice: which registers these are (R4 or R5, R14 or R15) and K are found at the start; a rate below 2 holds the speed
    until the next ramp.
    """

    def __init__(self, chip, goal, direction):
        self.chip, self.goal, self.up = chip, goal, direction > 0
        self.steps = abs(goal - chip.speed)  # K
        self.rate_register = 4 if self.up or chip.ramped_down else 5
        self.c, self.k = 0, 0  # clocks, steps done
        self.rate, self.span2 = self.values()

    def values(self):
        """Rate and 2 S by the registers now."""
        span = 2 * (self.chip.registers[R14 if self.up else R15] & 0xFFF)
        return self.chip.registers[self.rate_register], span if 0 < span <= self.steps else self.steps

    def tick(self):
        """One clock; True: the speed makes its next step."""
        self.c += 1
        if self.rate < 2:
            return False
        if not self.due(self.c, self.k + 1):
            return False
        self.k += 1
        if self.values() != (self.rate, self.span2):
            self.rate, self.span2 = self.values()
            self.c = self.first(lambda c: self.due(c, self.k))
        return True

    def clocks_left(self):
        """Until T."""
        return self.first(lambda c: 2 * c >= (self.steps + self.span2) * self.rate) - self.c

    def due(self, c, k):
        """The k-th step's clock has come."""
        return self.reached(c, k) if self.up else self.reached(c - 1, k - 1)

    @staticmethod
    def first(holds):
        """The least count for which it holds, which once it does it does for all greater ones."""
        high = 1
        while not holds(high):
            high *= 2
        low = 0
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if holds(middle) else (middle, high)
        return high

    def reached(self, c, k):
        """c >= t(k), exactly: everything is doubled, and both sides squared where a root stands."""
        rate, steps, span2 = self.rate, self.steps, self.span2
        if 2 * k <= span2:  # c >= rate sqrt(k S)
            return 2 * c * c >= rate * rate * k * span2
        if 2 * k <= 2 * steps - span2:  # c >= rate S + (k - S) rate / 2
            return 4 * c >= 2 * rate * span2 + rate * (2 * k - span2)
        left2 = rate * (steps + span2) - 2 * c  # 2 (T - c) <= 2 rate sqrt((K - k) S)
        return left2 <= 0 or left2 * left2 <= 2 * rate * rate * (steps - k) * span2
