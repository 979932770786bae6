"""Random programs for the HCTL-1100: modes, gains, profiles, commutators, a shaft that somebody turns."""

IDLE, CONTROL = 0x01, 0x03
COMMAND, FINAL, PRESET = (0x0C, 0x0D, 0x0E), (0x2B, 0x2A, 0x29), (0x15, 0x16, 0x17)
MODES = {"position": 0x00, "trapezoid": 0x08, "proportional": 0x0B, "integral": 0x0D}
STEP = 16  # clocks of a timer count
STORIES = {"position": 3, "trapezoid": 4, "proportional": 3, "integral": 3, "commutator": 4, "chaos": 4}


class Hctl1100Programs:
    """Draws programs of the chip, and of the shaft that it turns."""

    def __init__(self, draw):
        self.d, self.ops, self.count = draw, [], 0

    def write(self, address, value):
        self.ops.append(("write", address, value & 0xFF))

    def write_word(self, addresses, value):
        for k, address in enumerate(addresses):
            self.write(address, value >> 8 * (len(addresses) - 1 - k))

    def draw_position(self):
        d = self.d
        return d.choice(
            d.between(-300, 300),
            d.between(-30_000, 30_000),
            d.between(-(1 << 23), (1 << 23) - 1),
            -(1 << 23),
            (1 << 23) - 1,
        )

    def let_run(self, low, high):
        clocks = self.d.size(low, high)
        self.ops.append((self.d.choice("advance", "advance", "trace"), clocks))

    def turn_shaft(self):
        d = self.d
        rate = d.choice(0.0, 0.0, 0.001, -0.001, 0.01, -0.02, 0.125, -0.25, 0.5, -0.4)
        self.count += d.choice(0, d.between(-20, 20), d.between(-2000, 2000))
        self.ops.append(("shaft", self.count + d.choice(0.0, 0.5), rate))

    def add_reads(self):
        for address in (0x00, 0x05, 0x07, 0x08, 0x09, 0x12, 0x13, 0x14, 0x34, 0x35, 0x0E, 0x3C, 0x18):
            if self.d.chance(0.25):
                self.ops.append(("read", address))

    def set_up(self, mode):
        d = self.d
        self.write(0x05, IDLE)
        for flag in (0x00, 0x02, 0x03, 0x05):
            self.write(0x00, flag)
        self.write(0x0F, d.choice(0x40, 0x28, 0x07, d.between(7, 70), d.between(0, 255)))
        self.write(0x20, d.choice(0xE5, d.between(0, 255)))
        self.write(0x21, d.choice(0x40, d.between(0, 255)))
        self.write(0x22, d.choice(0x40, d.size(1, 255)))
        rate = d.choice(d.size(1, 3000), d.between(0, 0x7FFF))
        self.write(0x26, rate)
        self.write(0x27, rate >> 8)
        self.write(0x28, d.choice(d.between(1, 127), d.size(1, 127), 0, 200))
        self.write_word(FINAL, self.draw_position())
        if d.chance(0.6):
            self.write(0x13, 0)
            self.write_word(COMMAND, d.choice(0, self.draw_position()))
        if d.chance(0.2):
            self.write_word(PRESET, self.draw_position())
        if d.chance(0.2):
            self.write(0x00, 0x0A)  # F2, unipolar
        if d.chance(0.15):
            self.write(0x07, d.between(0, 7))
        self.load_velocity()
        self.write(0x3C, d.choice(d.between(0, 255), d.size(1, 127), -d.size(1, 127)))
        self.write(0x00, MODES[mode])
        self.write(0x05, CONTROL)

    def load_velocity(self):
        v = self.d.choice(self.d.between(-2000, 2000), self.d.between(-32768, 32767), 0)
        self.write(0x23, v)
        self.write(0x24, v >> 8)

    def pulse_pins(self):
        d = self.d
        name = d.choice("limit", "stop", "stop", "index", "sync")
        self.ops.append(("pin", 0, name, True))
        self.let_run(1, 20_000)
        self.add_reads()
        self.ops.append(("pin", 0, name, False))

    def disturb(self, mode):
        d = self.d
        d.choice(
            self.turn_shaft, self.turn_shaft, self.turn_shaft, self.add_reads, self.pulse_pins, self.load_velocity, self.add_reads,
            lambda: self.write_word(COMMAND, self.draw_position()), lambda: self.write_word(FINAL, self.draw_position()),
            lambda: self.write(0x3C, d.between(0, 255)),
            lambda: self.write(0x00, d.choice(0, 2, 3, 4, 5, 8, 8, 0x0A, 0x0B, 0x0C, 0x0D)),
            lambda: self.write(0x05, d.choice(0, 1, 2, 3, 3, 5)), lambda: self.write(0x13, 0),
            lambda: self.write_word(PRESET, self.draw_position()),
            lambda: self.write(d.choice(0x08, 0x09), d.between(0, 255)), lambda: self.write(0x07, d.between(0, 255)),
            lambda: self.write(d.choice(0x0F, 0x20, 0x21, 0x22, 0x26, 0x27, 0x28), d.between(0, 255)),
        )  # fmt: skip

    def draw_control(self, mode):
        self.set_up(mode)
        for _ in range(self.d.between(4, 12)):
            self.let_run(10, 60_000)
            self.disturb(mode)
            self.add_reads()
        self.let_run(1000, 400_000)

    def draw_commutator(self):
        d = self.d
        four, full = d.chance(0.5), d.chance(0.5)
        x, y = d.between(0, 12), d.between(0, 12)
        self.write(0x05, IDLE)
        self.write(0x07, four << 1 | full << 2 | d.chance(0.3))
        self.write(0x18, d.choice((4 if four else 3) * (x + y), d.between(0, 0x7F)))
        self.write(0x1A, x)
        self.write(0x1B, y)
        self.write(0x1C, d.choice(0, d.between(0, 255), d.between(0, 20)))
        self.write(0x1F, d.choice(0, d.between(0, 0x7F)))
        self.write(0x19, d.choice(0, d.between(0, 255)))
        if d.chance(0.5):
            self.write(0x00, d.choice(0x04, 0x0C))
        if d.chance(0.6):
            self.write(0x05, 0x02)  # Align
            self.let_run(100, 60_000)
        if d.chance(0.7):
            self.set_up(d.choice(*MODES))
        for _ in range(d.between(4, 12)):
            self.turn_shaft()
            self.let_run(10, 5000)
            if d.chance(0.4):
                self.disturb("commutator")
            if d.chance(0.3):  # F4 holds the ring while the shaft turns, and lets go
                self.write(0x00, 0x0C)
                self.turn_shaft()
                self.let_run(10, 3000)
                self.write(0x00, 0x04)
            if d.chance(0.3):
                self.pulse_pins()
            self.add_reads()

    def draw_chaos(self):
        d = self.d
        self.set_up(d.choice(*MODES))
        for _ in range(d.between(10, 40)):
            self.write(d.between(0, 0x3F if d.chance(0.97) else 0xFF), d.between(0, 255))
            self.disturb("chaos")
            self.let_run(1, 4000)
            if d.chance(0.05):
                self.ops.append(("reset",))


def draw_program(story, draw):
    """Draw a program of a story."""
    h = Hctl1100Programs(draw)
    if story in MODES:
        h.draw_control(story)
    else:
        getattr(h, f"draw_{story}")()
    return h.ops
