"""The HCTL-1100 in the words of its specification: the timer counts down, and at each reload one sample is worked out. Python
ints and exact fractions.

Shares nothing with the product. Where the specification is silent it does what docs/hctl1100.md says.
"""

from __future__ import annotations

import math
from fractions import Fraction

MINIMUM = {"position": 7, "proportional": 7, "trapezoid": 15, "integral": 15}


def sign_extended(value, bits):
    value %= 1 << bits
    return value - (1 << bits) if value >= 1 << bits - 1 else value


class ReferenceHCTL1100:
    """Bus, pins, shaft and clock."""

    def __init__(self):
        self.clock = 0
        self.pins = {"limit": False, "stop": False, "index": False, "sync": False}
        self.turned, self.count, self.rate, self.lost = 0, Fraction(0), Fraction(0), Fraction(0)
        self.motor_command = 0
        self.index_at = 0
        self.hard_reset()

    # --- the shaft ---

    def set_shaft(self, count, rate=0):
        self.lost += (self.rate - self.heard) * (self.clock - self.turned)
        self.turned, self.count, self.rate = self.clock, Fraction(count), Fraction(rate)

    @property
    def heard(self):
        """Counts a clock that come through the filter, which drops states of less than three clocks."""
        return self.rate if abs(self.rate) <= Fraction(1, 3) else Fraction(0)

    @property
    def encoder(self):
        return math.floor(self.count - self.lost + self.heard * (self.clock - self.turned))

    @property
    def actual(self):
        return sign_extended(self.encoder - self.offset, 24)

    # --- resets and modes ---

    def hard_reset(self):
        self.flags = {k: False for k in (0, 2, 3, 4, 5)}
        self.register = {k: 0 for k in range(64)}
        self.command, self.fraction = 0, 0
        self.waiting = [0, 0]  # bytes of the command position
        self.preset = [0, 0]
        self.latched = 0
        self.actual_velocity = 0
        self.motor_command = 0
        self.blocked_until = 0
        self.held_ring = 0
        self.soft_reset()
        self.index_at = self.encoder

    def soft_reset(self):
        self.register.update({0x20: 0xE5, 0x21: 0x40, 0x22: 0x40, 0x0F: 0x40})
        self.status = 0
        self.limited, self.stopped = self.pins["limit"], self.pins["stop"]
        self.offset = self.encoder
        self.counter, self.in_count = 0x40, 0
        self.sync_holds = False
        self.enter_init_idle_mode()

    def enter_init_idle_mode(self):
        self.mode = "idle"
        self.forget()
        self.drive(0)
        self.obey_sync()

    def forget(self):
        """Reset the filter and the profile generator."""
        self.x_before = self.mc_before = 0
        self.velocity = self.fraction = 0
        self.computed_until = 0
        self.at_last_sample = self.encoder

    @property
    def law(self):
        return (
            "trapezoid"
            if self.flags[0]
            else "proportional"
            if self.flags[3]
            else "integral"
            if self.flags[5]
            else "position"
        )

    # --- motor command ---

    def limit_command(self, mc):
        return max(0 if self.flags[2] else -128, min(127, mc))

    def drive(self, mc):
        self.port = self.pwm = mc
        self.give(mc)

    def give(self, mc):
        if self.status & 1 and ((mc < 0 < self.motor_command) or (self.motor_command < 0 < mc)):
            self.blocked_until = self.clock + 100
        self.motor_command = mc

    # --- time ---

    def advance(self, clocks):
        end = self.clock + clocks
        while self.clock < end:
            if self.sync_holds:
                self.clock = end
                return
            step = min(16 - self.in_count, end - self.clock)
            self.clock += step
            self.in_count += step
            if self.in_count == 16:
                self.in_count = 0
                if self.counter:
                    self.counter -= 1
                else:
                    self.counter = self.register[0x0F]
                    self.sample()

    def sample(self):
        if self.mode == "align":
            self.align_left -= 1
            if self.align_left == 0:
                self.mode, self.index_at, self.held_ring = "control", self.encoder, 0
                self.forget()
                self.drive(0)
            return
        if self.mode != "control":
            return
        self.computed_until = self.clock + 16 * MINIMUM[self.law]
        if self.law == "proportional":
            self.actual_velocity = self.encoder - self.at_last_sample
            mc = self.proportional()
        else:
            if self.law == "trapezoid":
                self.trapezoid()
            elif self.law == "integral":
                self.integral()
            x = sign_extended(self.command - self.actual, 24)
            mc = self.filtered(x)
            self.x_before = x
        self.mc_before = mc
        self.at_last_sample = self.encoder
        self.drive(mc)

    # --- control laws ---

    def filtered(self, x):
        k, a, b = self.register[0x22], self.register[0x20], self.register[0x21]
        return self.limit_command((256 * k * x - a * k * self.x_before - 4 * b * self.mc_before) // 1024)

    def proportional(self):
        wanted = sign_extended(self.register[0x24] * 256 + self.register[0x23], 16)
        return self.limit_command(self.register[0x22] * (wanted - 16 * sign_extended(self.actual_velocity, 16)) // 64)

    @property
    def acceleration(self):
        return self.register[0x27] * 256 + self.register[0x26]

    def move(self, by):
        at = self.command * 256 + self.fraction + by
        self.command, self.fraction = sign_extended(at // 256, 24), at % 256

    def trapezoid(self):
        a, top = self.acceleration, 256 * self.register[0x28]
        final = sign_extended(self.register[0x2B] * 65536 + self.register[0x2A] * 256 + self.register[0x29], 24)
        rest = final * 256 - (self.command * 256 + self.fraction)
        v = abs(self.velocity)
        if a > 0:
            faster = min(v + a, top)
            brake, slower = 0, faster - a
            while slower > 0:
                brake += slower
                slower -= a
            v = faster if abs(rest) - faster >= brake else max(v - a, a)
        if v >= abs(rest):
            self.command, self.fraction, self.velocity, self.flags[0] = final, 0, 0, False
        else:
            self.velocity = v if rest > 0 else -v
            self.move(self.velocity)

    def integral(self):
        if self.stopped:
            self.register[0x3C] = 0
        goal, a = 256 * sign_extended(self.register[0x3C], 8), self.acceleration
        if abs(goal - self.velocity) <= a:
            self.velocity = goal
        else:
            self.velocity += a if goal > self.velocity else -a
        self.move(self.velocity)

    # --- commutator ---

    @property
    def unit(self):
        return 4 if self.status & 4 else 1

    @property
    def ring(self):
        return self.held_ring if self.flags[4] else (self.encoder - self.index_at) // self.unit

    @property
    def energised(self):
        """The phases that are on, as letters."""
        phases = "abcd" if self.status & 2 else "abc"
        if self.mode == "align":
            return phases[0] if self.align_left > 2048 else phases[-1]
        length, x, y = (self.register[k] for k in (0x18, 0x1A, 0x1B))
        if not length or not x + y:
            return ""
        turned = self.heard * 16 * (self.register[0x19] + 1) / self.unit
        advance = math.copysign(min(math.floor(abs(turned)), self.register[0x1F]), turned)
        place = int(self.ring + sign_extended(self.register[0x1C], 8) + advance) % length
        on = set()
        for k in range(place // (x + y) + 1):
            begin = k * (x + y)
            if begin <= place < begin + x + y:
                on.add(phases[k % len(phases)])
            if begin + x <= place < begin + x + y:
                on.add(phases[(k + 1) % len(phases)])
        return "".join(sorted(on))

    # --- pins ---

    def set_pin(self, name, level):
        if name == "index" and level and not self.pins["index"]:
            self.index_at, self.held_ring = self.encoder, 0
        self.pins[name] = level
        if self.pins["stop"]:
            self.stopped = True
        if self.pins["limit"]:
            self.limited = True
            if self.mode != "idle":
                self.enter_init_idle_mode()
        self.obey_sync()

    def obey_sync(self):
        holds = self.mode == "idle" and self.pins["sync"]
        if self.sync_holds and not holds:
            self.counter, self.in_count = self.register[0x0F], 0
        self.sync_holds = holds

    @property
    def outputs(self):
        on = self.energised
        return {
            "prof": self.flags[0],
            "init": self.mode == "idle",
            "sign": self.pwm < 0,
            # Choice: periods of 100 clocks are counted from power-up, and PULSE is on at their beginning
            "pulse": self.clock % 100 < min(abs(self.pwm), 100) and self.clock >= self.blocked_until,
            **{f"ph{k}": k in on for k in "abcd"},
        }

    # --- bus ---

    def write(self, address, value):
        address, value = address % 64, value % 256
        if address == 0x00:
            self.write_flag(value % 8, bool(value & 8))
        elif address == 0x05:
            self.write_mode(value)
        elif address == 0x07:
            self.status = value & 7
            self.limited &= self.pins["limit"]
            self.stopped &= self.pins["stop"]
        elif address in (0x0C, 0x0D):
            self.waiting[address - 0x0C] = value
        elif address == 0x0E:
            new = sign_extended(self.waiting[0] * 65536 + self.waiting[1] * 256 + value, 24)
            if self.computing and self.law != "proportional":
                torn = sign_extended(self.command // 256 * 256 + value, 24)
                self.drive(self.filtered(sign_extended(torn - self.then, 24)))
            self.command, self.fraction = new, 0
        elif address == 0x13:
            self.offset = self.encoder
        elif address in (0x08, 0x09, 0x15, 0x16, 0x17):
            if self.mode == "idle":
                self.write_in_idle(address, value)
        elif address in (0x18, 0x1A, 0x1B, 0x1F, 0x27, 0x28):
            self.register[address] = value & 0x7F
        elif address in (0x0F, 0x19, 0x1C, 0x20, 0x21, 0x22, 0x23, 0x24, 0x26, 0x29, 0x2A, 0x2B, 0x3C):
            self.register[address] = value
            self.tear_velocity(address)

    @property
    def computing(self):
        return self.mode == "control" and self.clock < self.computed_until

    @property
    def then(self):
        """The actual position at the last sample, by the zero of now."""
        return self.at_last_sample - self.offset

    def tear_velocity(self, address):
        if not self.computing:
            return
        if self.law == "proportional" and address in (0x23, 0x24):
            self.drive(self.proportional())
        elif self.law == "integral" and address == 0x3C:
            jump = (256 * sign_extended(self.register[0x3C], 8) - self.velocity) // 256
            self.drive(self.filtered(sign_extended(self.x_before + jump, 24)))

    def write_in_idle(self, address, value):
        if address == 0x08:
            self.port = value - 128
            self.give(self.port)
        elif address == 0x09:
            self.pwm = sign_extended(value, 8)
            self.give(self.pwm)
        elif address == 0x17:
            self.offset = self.encoder - (self.preset[0] * 65536 + self.preset[1] * 256 + value)
        else:
            self.preset[address - 0x15] = value

    def write_flag(self, number, on):
        if number not in self.flags:
            return
        before = self.law
        if number == 4 and on and not self.flags[4]:
            self.held_ring = self.ring
        if number == 4 and not on and self.flags[4]:
            self.index_at = self.encoder - self.held_ring * self.unit
        self.flags[number] = on
        if self.mode == "control" and self.law != before:
            self.velocity = self.fraction = 0
            if "proportional" in (before, self.law):
                self.forget()

    def write_mode(self, value):
        if value == 0:
            self.soft_reset()
        elif value == 1:
            self.enter_init_idle_mode()
        elif value in (2, 3) and self.mode == "idle" and not self.limited:
            if value == 2:
                self.mode, self.align_left = "align", 4096
                self.drive(127)
            else:
                self.mode = "control"
                self.forget()
            self.obey_sync()

    def read(self, address):
        address %= 64
        if address == 0x14:
            self.latched = self.actual % (1 << 24)
        return self.look(address)

    def look(self, address):
        """Return what a read would return, without latching anything."""
        if address == 0x00:
            return sum(1 << k for k, on in self.flags.items() if on) + (2 if self.mode == "idle" else 0)
        if address == 0x07:
            bits = (not self.limited, not self.stopped, self.mode == "idle", self.flags[0])
            return self.status + sum(on << 7 - k for k, on in enumerate(bits))
        if address == 0x08:
            return self.port + 128
        if address == 0x09:
            return self.pwm % 256
        if address in (0x0C, 0x0D, 0x0E):
            return self.command // 256 ** (0x0E - address) % 256
        if address == 0x0F:
            return 0 if self.sync_holds else self.counter
        if address in (0x12, 0x13):
            return self.latched // 256 ** (0x14 - address) % 256
        if address == 0x14:
            return self.actual % 256
        if address in (0x34, 0x35):
            return sign_extended(self.actual_velocity, 16) // 256 ** (address - 0x34) % 256
        return 0 if address == 0x19 else self.register[address]
