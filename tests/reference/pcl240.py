"""The PCL-240K one reference clock at a time, in the words of shared/spec/pcl240.md (its sections in brackets).

    chip = ReferencePCL240K()
    chip.write(0, 0x81); chip.write(1, 50)      a register
    chip.write(0, 0x10); chip.trace(1000)       a start; [(clock, direction), ...]

No closed form, no event queue: every clock is one `tick()`. It shares nothing with stage.chips, so that the two can
disagree. Where the specification leaves a choice, the comment beside the line says which was taken. The MK and MS of
pcl240ms.py override what differs.
"""

INPUTS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org", "ins", "extp")
OUTPUTS = ("ots", "pout", "pdir", "hold", "fdown", "fkeep", "fup", "lt", "zero", "irq")


class Pins:
    """Input pins are attributes to set, output pins attributes to get; True = the level that default logic takes as asserted."""

    def __init__(self, chip):
        vars(self).update(dict.fromkeys(chip.INPUTS, False), _chip=chip)

    def __getattr__(self, name):  # reached for outputs only: inputs lie in vars(self)
        if name not in OUTPUTS:
            raise AttributeError(name)
        return self._chip.outputs()[name]

    def __setattr__(self, name, asserted):
        if name not in self._chip.INPUTS:
            raise AttributeError(f"{name} is not an input pin")
        vars(self)[name] = bool(asserted)


class ReferencePCL240K:
    WIDTHS = (24, 13, 13, 13, 14, 14, 20, 10)  # bits of R0 .. R7 [4]
    INPUTS = INPUTS
    CONTROL_BITS, SELECT_BITS, OUTPUT_BITS = 0x0F, 0x07, 0x31  # the 240K ignores D4, D5 [2]

    def __init__(self, leader=None):
        """leader: the chip whose SYNO is connected to this one's SYNI [5 fine points]; tick it before this one."""
        self.clock = 0
        self.leader = leader
        self.pins = Pins(self)
        self.extp_sample = False
        self.reset()

    def reset(self):
        """/RESET: everything 0 except armed; the clock count goes on [5 fine points].

        Choice: the last sample of EXTP belongs to the pin, so a rising edge across /RESET is still an edge.
        """
        self.registers = [0] * len(self.WIDTHS)
        self.select = self.control = self.output_mode = 0
        self.running = self.finishing = self.ramps = self.stop_pending = False
        self.armed = True
        self.int_at_stop = self.int_pending = False
        self.phase = self.speed = self.timer = self.speed_select = 0
        self.ramp = 0  # +1 or -1: the ramp that the last tick ran
        self.fdown_tail = 0  # clocks that FDOWN stays up after the last step of a ramp down
        self.pout_low = False

    # Bus [1], [2]

    def write(self, address, value):
        if self.leader:
            self._clamp_phase()
        if address == 0:
            group = value >> 6
            if group == 0:
                self._operating_mode(value)
            elif group == 1:
                self.control = value & self.CONTROL_BITS
            elif group == 2:
                self.select = value & self.SELECT_BITS
            else:
                self.output_mode = value & self.OUTPUT_BITS
        else:
            self._write_byte(8 * (address - 1), value)

    number = property(lambda self: self.select)  # of the selected register

    def _write_byte(self, shift, value):
        self._store(self.number, self.registers[self.number] & ~(0xFF << shift) | value << shift)

    def _store(self, number, word):
        """At once, so torn writes are real."""
        self.registers[number] = word & ((1 << self.WIDTHS[number]) - 1)
        if number == 7:
            self._clamp_phase()

    def _clamp_phase(self):
        self.phase = min(self.phase, max(self.modulus - 1, 0))  # [5 fine points]

    def read(self, address):
        return self.status() if address == 0 else self._read_byte(8 * (address - 1))

    def _read_byte(self, shift):
        return self.registers[0] >> shift & 0xFF

    def _operating_mode(self, value):
        self.int_at_stop = bool(value & 0x20)  # every 00 command, an ignored start too [5 fine points]
        if not self.int_at_stop:
            self.int_pending = False  # [2]
        start, stop = value & 0x10, value & 0x08
        if start and stop:
            self._decelerating_stop(value)
        elif stop:
            self._reset_command()
        elif start and self.running:
            self._choose_speed(value)
        elif start:
            self._start(value)

    def _reset_command(self):
        self._stop()
        self.armed = True

    def _choose_speed(self, value):
        self.ramps = bool(value & 4)
        self.speed_select = value & 3
        self.stop_pending = False  # a speed change cancels it [5]

    def _start(self, value):
        if not self.armed or self.finishing:
            return  # needs 08h first [2]; the last pulse is still being completed [5]
        if (self.preset and self.registers[0] == 0) or self._limit_of_direction() or (self.control & 1 and self.org):
            return  # stays halted and armed [5]
        self._choose_speed(value)
        self._run()

    def _run(self):
        self.running = True
        self.phase = self.timer = self.ramp = self.fdown_tail = 0
        self.speed = self.registers[1] if self.ramps else self.selected_speed

    def _decelerating_stop(self, value):
        if not self.running:
            return
        if not value & 4 and not self.ramps:  # D2 = 0 in a constant-speed run [2]
            self._stop()
            return
        self.ramps = self.stop_pending = True  # turns ramps on [5]
        if self.speed <= self.registers[1]:  # tested at the write [5]
            self._stop()

    def _stop(self):
        if not self.running:
            return
        self.running = self.armed = self.stop_pending = False
        if self.pout_low:
            self.finishing = True  # the pulse is completed first, speed frozen [5]
        else:
            self._operation_ends()

    def _operation_ends(self):
        """b6 falls; the latest D5 decides on /INT [5 fine points]."""
        self.finishing = False
        if self.int_at_stop:
            self.int_pending = True

    # One reference clock [5]

    def tick(self):
        """Returns the direction, +1 or -1, of the pulse that begins in this clock, or 0."""
        self.clock += 1
        if self.leader:
            self._clamp_phase()  # Choice: a follower finds its leader's new R7 at its next write or tick, before anything else
        rising, self.extp_sample = self.extp_sample and not self.pins.extp, self.pins.extp
        if rising and self.external:  # at the start of a tick, running or not [5 fine points]
            self._count()
            self._stop_at_zero()
        if self.running and self._limit_of_direction():  # 1
            self._stop()
        if self.running:
            self._origin_return()
        start_clock = 0
        # R7 < 2 freezes the phase, and speed 0 or R7 < 2 never completes a pulse: step 2 is skipped as a whole
        if (self.running or self.finishing) and self.multiplier >= 2 and self.speed > 0:
            start_clock = self._pulse_output()  # 2
        if self.running:
            self._speed_control()  # 3
        return start_clock

    def _origin_return(self):
        if self.control & 1 and self.org:
            self._stop()

    def _pulse_output(self):
        self.phase += self.speed
        if self.running and self.phase >= self.modulus:
            self.phase -= self.modulus
            self.pout_low = True
            self._pulse_begins()
            if not self.external:
                self._count()
            # Choice: "in preset mode R0 = 0 stops", the brackets "(source = output pulses)" qualify the count alone
            self._stop_at_zero()
            return self.direction
        if self.pout_low and 2 * self.phase >= self.modulus:
            self.pout_low = False
            if self.finishing:
                self._operation_ends()
        return 0

    def _pulse_begins(self):
        """For the chips that count them otherwise, too."""

    def _count(self):
        self.registers[0] = (self.registers[0] - 1) % 2**24

    def _stop_at_zero(self):
        if self.preset and self.registers[0] == 0:
            self._stop()

    def _speed_control(self):
        if self.ramps:
            self._ramp()
        else:
            self.speed = self.selected_speed  # hence a change acts from the next tick on
            self.ramp = self.fdown_tail = 0
        if self.stop_pending and self.speed <= self.registers[1]:
            self._stop()

    def _ramp(self):
        direction = self.ramp_direction()
        first = direction != self.ramp  # a ramp starts when none was running or its direction changes
        self.ramp = direction
        if direction == 0:
            self.fdown_tail = max(self.fdown_tail - 1, 0)
            return
        self.fdown_tail = 0  # a new ramp, or a changed goal, ends it sooner
        self._ramp_clock(direction, first)
        if direction < 0 and self.ramp_direction() == 0:
            self.fdown_tail = self.tail_of_the_ramp()

    def _ramp_clock(self, direction, first):
        self.timer = 1 if first else self.timer + 1
        rate = self.rate(direction)
        if rate < 2:
            return  # below the legal minimum: the speed holds, though the timer counts on
        if self.timer >= rate or (direction < 0 and first):
            self.speed += direction
            self.timer = 0

    def tail_of_the_ramp(self):
        """Clocks after the last step for which FDOWN stays up [5]. Choice: R5 as it is at that step."""
        return self.rate(-1) - 1

    def advance(self, clocks):
        return len(self.trace(clocks))

    def trace(self, clocks):
        """Pulses begun, as (clock after the tick, direction) [5 fine points]."""
        return [(self.clock, direction) for _ in range(clocks) if (direction := self.tick())]

    # What follows from the state

    multiplier = property(lambda self: (self.leader or self).registers[7])
    modulus = property(lambda self: 8192 * self.multiplier)
    org = property(lambda self: self.pins.org)  # as the chip reads it
    direction = property(lambda self: -1 if self.control & 8 else 1)
    preset = property(lambda self: bool(self.control & 4))
    external = property(lambda self: bool(self.output_mode & 0x10))
    speed_register = property(lambda self: (1, 2, 1, 3)[self.speed_select])  # 10 as FL [2]
    selected_speed = property(lambda self: self.registers[self.speed_register])

    def rate(self, direction):
        return self.registers[4 if direction > 0 else 5]

    def _limit_of_direction(self):
        return self.pins.el_minus if self.control & 8 else self.pins.el_plus

    def _slow_down_of_direction(self):
        return self.pins.sd_minus if self.control & 8 else self.pins.sd_plus

    def goal(self):
        if self.stop_pending or (self.control & 2 and self._slow_down_of_direction()) or self._ramping_down_point():
            return self.registers[1]
        return self.selected_speed

    def _ramping_down_point(self):
        return self.preset and self.registers[0] < self.registers[6]

    def ramp_direction(self):
        goal = self.goal()
        return (goal > self.speed) - (goal < self.speed)

    def outputs(self):
        ramping = self.ramp_direction() if self.running and self.ramps else 0  # live [5 fine points]
        if self.running and self.ramps and ramping == 0 and self.fdown_tail > 0:
            ramping = -1
        minus, independent = self.direction < 0, self.output_mode & 1
        return {
            "ots": bool(self.output_mode & 0x20),
            "pout": self.pout_low and not (independent and minus),
            "pdir": self.pout_low and minus if independent else minus,
            "hold": not (self.running or self.finishing),
            "fdown": ramping < 0,
            "fkeep": ramping == 0,
            "fup": ramping > 0,
            "lt": self.registers[0] < self.registers[6],
            "zero": self.registers[0] == 0,
            "irq": self.int_pending,
        }

    def status(self):
        """b7 .. b0 [3]."""
        out = self.outputs()
        bits = (not out["irq"], not out["hold"], out["fkeep"], out["lt"], out["zero"])
        bits += (self._slow_down_of_direction(), self.org, self.pins.ins)
        return int("".join(str(int(bit)) for bit in bits), 2)

    def values(self):
        """Every register by name, and the status byte."""
        return {f"R{number}": word for number, word in enumerate(self.registers)} | {"status": self.status()}

    def state(self):
        """All that a host or a probe can see: status, the three counter bytes, every output pin."""
        return {"status": self.read(0), "counter": tuple(self.read(a) for a in (1, 2, 3)), **self.outputs()}
