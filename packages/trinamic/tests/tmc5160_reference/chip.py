"""The TMC5160 one clock at a time, in the words of its normative page (sections in brackets): SD_MODE 0, SPI.

    chip = Reference(12_000_000)
    chip.write(0x26, 1000); chip.write(0x2D, 400)      a register, between two clocks
    chip.transfer(0x2100000000)                        an SPI datagram; the answer carries what the last one asked
    chip.set_pin("REFL_STEP", True); chip.set_load(lam=512, emf=700)
    chip.advance(1000); chip.steps                     [(clock, direction), ...]

No closed form: every clock is one `tick()`. It shares nothing with the product, so that the two can disagree. Where the
page leaves a choice, the comment beside the line says which was taken.
"""

from tmc5160_reference.motor_driver import Driver, signed
from tmc5160_reference.registers import BY_ADDRESS, CLEARABLE, RESET

PINS = ("REFL_STEP", "REFR_DIR", "ENCA_DCIN_CFG5", "ENCB_DCEN_CFG4", "ENCN_DCO_CFG6", "DRV_ENN")
FULL = 1 << 41  # of the phase: one step
LEFT, RIGHT = -1, 1


class Reference(Driver):
    """clock_hz is for the user's arithmetic only: everything counts clocks."""

    def __init__(self, clock_hz=12_000_000):
        self.clock_hz = clock_hz
        self.clock = 0
        self.steps = []
        self.r = dict(RESET)
        self.pins = dict.fromkeys(PINS, False)  # levels now
        self.sampled = dict(self.pins)  # levels that the last clock saw
        self.q = self.dir = self.ph = self.zw = 0
        self.brk = False
        self.sides = {LEFT: False, RIGHT: False}  # status_stop_l, status_stop_r
        self.was_reached = True
        self.last_dir = 1
        self.diag0_toggle = False
        self.answer = None
        self.touched = True
        self.checked_speed = 0
        self.reset_driver()

    # Bus [1], [2]

    def write(self, address, value):
        self.touched = True
        name, access, mask = BY_ADDRESS.get(address, ("", "", 0))
        if access == "WC":
            self.r[name] &= ~(value & CLEARABLE[name])
        elif "W" in access:
            self.r[name] = value & mask
            if name in ("XTARGET", "XACTUAL", "RAMPMODE"):
                self.brk = False
            elif name == "X_ENC":
                self.fraction = 0
            elif name == "IHOLD_IRUN":
                self.current_written()
            elif name == "COOLCONF":
                self.sg_sum = self.sg_count = 0  # choice: whether or not sfilt changes
        self.shorts_released()
        self.thresholds()
        self._note_arrival()

    def read(self, address):
        name, access, mask = BY_ADDRESS.get(address, ("", "W", 0))
        if access == "W":
            return 0
        live = {
            "IOIN": self._ioin, "TSTEP": self.tstep, "VACTUAL": lambda: self.dir * (self.q >> 17),
            "RAMP_STAT": self.ramp_stat, "MSCNT": lambda: self.mscnt, "MSCURACT": self.mscuract,
            "DRV_STATUS": self.drv_status,
            "PWM_AUTO": lambda: self.r["PWMCONF"] & 0xFF | (self.r["PWMCONF"] & 0xFF00) << 8,
        }  # fmt: skip
        return (live[name]() if name in live else self.r[name]) & mask

    def transfer(self, datagram):
        """Exchange one SPI datagram of 40 bits and return the reply."""
        first = self.answer is None  # choice: "the status of that moment" is that of the first datagram's begin
        out = self.spi_status() << 32 if first else self.answer
        address, data = datagram >> 32 & 0x7F, datagram & 0xFFFFFFFF
        if datagram >> 39 & 1:
            self.write(address, data)
        else:
            data = self.read(address)
        self.answer = self.spi_status() << 32 | data
        return out

    def spi_status(self):
        ramp, gstat = self.ramp_stat(), self.r["GSTAT"]
        bits = (ramp >> 1, ramp, ramp >> 9, ramp >> 8, self.standstill, self.stalled, gstat >> 1, gstat)
        return int("".join(str(int(bit) & 1) for bit in bits), 2)

    def _ioin(self):
        """Return IOIN. Choice: it shows the present levels of the pins, not those of the last clock."""
        order = ("REFL_STEP", "REFR_DIR", "ENCB_DCEN_CFG4", "ENCA_DCIN_CFG5", "DRV_ENN", "ENCN_DCO_CFG6")
        return 0x30000000 | sum(self.pins[name] << bit for bit, name in enumerate(order))

    def ramp_stat(self):
        stop = {side: self._stop(side) and self._heading() == side for side in (LEFT, RIGHT)}
        bits = {
            0: self.sides[LEFT], 1: self.sides[RIGHT], 4: stop[LEFT], 5: stop[RIGHT],
            8: self.q >> 17 == self.r["VMAX"], 9: self._reached(), 10: self.q == 0, 11: self.zw > 0,
            13: self.stalled and self.stall_window,
        }  # fmt: skip
        return self.r["RAMP_STAT"] & CLEARABLE["RAMP_STAT"] | sum(1 << bit for bit, on in bits.items() if on)

    def set_pin(self, name, level):
        """Set the level of an input pin, effective from the next clock on."""
        if name not in self.pins:
            raise KeyError(f"no input pin {name!r}; there are {', '.join(PINS)}")
        self.pins[name] = bool(level)
        self.touched = True

    def set_load(self, lam, emf):
        """Set LAM and EMF of section 6, 0 to 1024 each."""
        self.lam, self.emf = lam, emf

    # One clock [4.2]

    def advance(self, clocks):
        for _ in range(clocks):
            self.tick()

    def tick(self):
        self.clock += 1
        if self.touched:  # inputs say nothing new unless a pin, a fault or a register was touched since the last clock
            self._inputs()  # 1
        stepped = False
        drives = False if self.gated() else self._speed()  # 2 to 5
        if self.touched or self.q >> 17 != self.checked_speed:
            self.thresholds()
        if drives:
            stepped = self._drive()  # 6
        if stepped:
            self._note_arrival()  # 7; the other flags are read off the state
        if self.r["ENC_DEVIATION"]:
            self.deviation()  # choice: with the positions after the clock
        self.last_dir = self.dir or self.last_dir
        if not stepped:
            self.since += 1
        self.current_clock()
        if self.since == self.standstill_limit():
            self.stall_guard_rests()
        self.touched = False

    def gated(self):
        return bool(self.r["GCONF"] & 0x8000) and self.sampled["ENCA_DCIN_CFG5"]

    def _inputs(self):
        self.sampled = dict(self.pins)
        mode = self.r["SW_MODE"]
        pins = ("REFR_DIR", "REFL_STEP") if mode & 0x10 else ("REFL_STEP", "REFR_DIR")
        for number, side in enumerate((LEFT, RIGHT)):
            before = self.sides[side]
            now = self.sides[side] = self.sampled[pins[number]] != bool(mode >> (2 + number) & 1)
            latches = mode >> (5 + 2 * number) & 3  # active, inactive edge
            if (now and not before and latches & 1) or (before and not now and latches & 2):
                self.r["XLATCH"] = self.r["XACTUAL"]
                self.r["RAMP_STAT"] |= 4 << number
                if mode & 0x200:
                    self.r["ENC_LATCH"] = self.r["X_ENC"]  # before this clock's encoder edge: latches stand first
        self.encoder_clock()
        self.faults_clock()

    def _speed(self):
        """Perform steps 3 to 5 of a clock and return whether step 6 follows."""
        if self.zw > 0:
            self.zw -= 1
            return False
        if self.r["RAMP_STAT"] & 0x40 and self.r["SW_MODE"] & 0x400:
            if self.q > 0:
                self._halt()
            return False
        if self.dir != 0 and self._stop(self.dir):
            if self.r["SW_MODE"] & 0x800 and self.q > self._z():
                self.q = self._brake(self.q)
                return True
            self._halt()
            return False
        mode = self.r["RAMPMODE"]
        started = False
        if self.dir == 0:
            wanted = self._wanted()
            if wanted == 0 or self.r["VMAX"] == 0 or self._stop(wanted):
                return False
            started = True
            self.dir = wanted
            if mode == 0:
                self._start()
        if mode == 0:
            return self._position(started)
        if mode == 3:
            return True
        if self.dir == self._wanted():
            goal, rate = self.r["VMAX"] << 17, self.r["AMAX"]
            self.q = min(self.q + rate, goal) if self.q < goal else max(self.q - rate, goal)
        else:
            self.q = max(self.q - self.r["AMAX"], 0)
        return self._still_moves(started)

    def _start(self):
        self.q = min(self.r["VSTART"], self.r["VMAX"]) << 17
        if 256 * (self._steps_to_target() - 1) < self._need(self.q):
            self.q = min(self.q, self._z())

    def _position(self, started):
        if self.dir != self._wanted():  # the target is behind or here
            if self.q <= self._z():
                if self._steps_to_target() > 0:
                    self.r["RAMP_STAT"] |= 0x1000  # second_move
                self._halt()
                return False
            self.brk = True
            self.q = self._brake(self.q)
            return True
        room = 256 * (self._steps_to_target() - 1)
        new = self.q
        if not self.brk:
            new, rate = self._toward(self.q)
            if new > self.q and room < self._need(new):
                new = self.q
            slows_enough = new < self.q and rate >= self._brake_rate(self.q)
            if not slows_enough and room < self._need(new):
                self.brk = True
        if self.brk:
            new = self._brake(self.q)
        self.q = new
        return self._still_moves(started)

    def _still_moves(self, started):
        if self.q > 0:
            return True
        if started:  # no acceleration
            self.dir = 0
        else:  # VMAX = 0, or turning round
            self._halt()
        return False

    def _drive(self):
        """Perform step 6 of a clock and return whether the motor made a step."""
        self.ph += self.q
        stepped = self.ph >= FULL
        if stepped:
            self.ph -= FULL
            self.r["XACTUAL"] = (self.r["XACTUAL"] + self.dir) & 0xFFFFFFFF
            self.steps.append((self.clock, self.dir))
            self.diag0_toggle = not self.diag0_toggle
            self.step_restarts_current()
            if self.sequence(self.dir) and self.measure() and self._stalls():
                self.r["RAMP_STAT"] |= 0x40
                self._halt()
        # Choice: looked at in each clock that comes here, with or without a step
        if self.r["RAMPMODE"] == 0 and self._reached() and self.q <= self._z():
            self._halt()
        return stepped

    def _stalls(self):
        return self.stalled and self.stall_window and self.r["SW_MODE"] & 0x400

    # Its words

    def _halt(self):
        self.q = self.dir = self.ph = 0
        self.brk = False
        self.zw = 512 * self.r["TZEROWAIT"]

    def _q1(self):
        return self.r["V1"] << 17

    def _z(self):
        return max(self.r["VSTOP"], 1) << 17

    def _toward(self, q):
        """Return the speed one clock nearer to VMAX, and the rate."""
        goal, q1 = self.r["VMAX"] << 17, self._q1()
        low = q1 > 0 and (q < q1 or (q > goal and q == q1))
        rate = self.r["A1"] if low else self.r["AMAX"]
        if q < goal:
            bounds = [goal, q1] if q < q1 else [goal]
            return min(q + rate, *bounds), rate
        if q > goal:
            bounds = [goal, q1] if q > q1 > 0 else [goal]
            return max(q - rate, *bounds), rate
        return q, rate

    def _brake_rate(self, q):
        d1 = self.r["V1"] != 0 and q <= self._q1()
        return max(self.r["D1"] if d1 else self.r["DMAX"], 1)

    def _brake(self, q):
        if q <= self._z():
            return q
        bounds = [self._z()]
        if self.r["V1"] != 0 and q > self._q1():
            bounds.append(self._q1())
        return max(q - self._brake_rate(q), *bounds)

    def _need(self, q):
        """Return the braking distance in 1/256 step, rounded up."""
        z, q1 = self._z(), self._q1()
        if q <= z:
            return 0
        w, wz, w1 = (q >> 9) + 1, z >> 9, self.r["V1"] << 8
        margin = 8 + 2 * (w >> 24)
        if q1 != 0 and q > q1 > z:
            dmax, d1 = max(self.r["DMAX"], 1), max(self.r["D1"], 1)
            return margin + ceil_div(w * w - w1 * w1, dmax << 16) + ceil_div(w1 * w1 - wz * wz, d1 << 16)
        return margin + ceil_div(w * w - wz * wz, self._brake_rate(q) << 16)

    def _distance(self):
        return signed(self.r["XTARGET"] - self.r["XACTUAL"])

    def _steps_to_target(self):
        return abs(self._distance())

    def _reached(self):
        return self.r["XACTUAL"] == self.r["XTARGET"]

    def _wanted(self):
        """Return the direction that the start rule demands, regardless of VMAX."""
        mode = self.r["RAMPMODE"]
        if mode == 0:
            distance = self._distance()
            return (distance > 0) - (distance < 0)
        return (0, 1, -1, 0)[mode]

    def _heading(self):
        return self.dir or self._wanted()

    def _stop(self, side):
        """Return whether the stop of this direction is enabled and its switch active."""
        return bool(self.r["SW_MODE"] >> (0 if side == LEFT else 1) & 1) and self.sides[side]

    def _note_arrival(self):
        reached = self._reached()
        if reached and not self.was_reached:
            self.r["RAMP_STAT"] |= 0x80
        self.was_reached = reached

    # DIAG pins [5]: levels

    def diag0(self):
        gconf = self.r["GCONF"]
        if gconf & 0x80:
            return self.diag0_toggle
        active = self.ramp_stat() & 0xF0 or self.r["ENC_STATUS"]
        return bool(active) == bool(gconf & 0x1000)

    def diag1(self):
        gconf = self.r["GCONF"]
        if gconf & 0x100:
            return self.last_dir < 0
        return (self.r["XACTUAL"] == self.r["X_COMPARE"]) == bool(gconf & 0x2000)


def ceil_div(a, b):
    return (a + b - 1) // b
