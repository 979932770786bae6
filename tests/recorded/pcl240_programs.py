"""Random programs for the PCL-240 family: runs, ramps, origin returns, external pulses, and chaos, in full and in small values."""

STORIES = {"run": 5, "preset": 5, "origin": 3, "external": 2, "slow_down": 2, "wide": 3, "chaos": 4}
STARTS = (0x15, 0x17, 0x35, 0x37, 0x11, 0x13, 0x10, 0x14, 0x31)
INPUTS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org", "ins", "extp", "ez")
TOP = {0: 0xFFFFFF, 1: 8191, 2: 8191, 3: 8191, 4: 65535, 5: 65535, 6: 0xFFFFFF, 7: 1023}


class Pcl240Programs:
    """Draws programs of one chip of the family."""

    def __init__(self, chip, draw):
        self.d, self.ops = draw, []
        self.has_sixteen_registers, self.has_curves = chip != "PCL240K", chip == "PCL240MS"

    def write_command(self, value):
        self.ops.append(("write", 0, value))

    def write_register(self, n, value, addresses=(3, 2, 1), collective=False):
        self.write_command(0x80 | collective << 5 | (n & 8) << 1 | n & 7)
        self.ops += [("write", a, value >> 8 * (a - 1) & 0xFF) for a in addresses]

    def let_run(self, low, high):
        self.ops.append((self.d.choice("advance", "trace"), self.d.size(low, high)))

    def set_pin(self, name, level):
        self.ops.append(("pin", 0, name, level))

    def pulse_pin(self, *names, low=1, high=400):
        names = [name for name in names if self.has_sixteen_registers or name != "ez"]
        for name in names:
            self.set_pin(name, True)
        self.let_run(low, high)
        for name in names:
            self.set_pin(name, False)

    def add_reads(self):
        d = self.d
        if d.chance(0.5):
            self.ops.append(("read", 0))
        if d.chance(0.3):
            self.write_command(
                0x80
                | d.chance(0.3) << 5
                | d.between(0, 15 if self.has_sixteen_registers else 7) % 8
                | d.chance(0.4) << 4
            )
            self.ops += [("read", a) for a in d.choice((3, 2, 1), (1, 2, 3), (1,), (2,))]

    def write_registers(self):
        d = self.d
        fl = d.choice(d.between(50, 2000), d.between(400, 2000))
        values = [
            d.choice(d.between(1, 60), d.between(1, 300), d.between(1, 30)), fl,
            d.choice(fl + d.between(-20, 600), d.between(500, 8191)), d.choice(fl + d.between(-20, 900), d.between(500, 8191)),
            d.choice(2, 3, d.between(2, 12), d.between(0, 60)), d.choice(2, 3, d.between(2, 12), d.between(0, 60)),
            d.choice(0, d.between(0, 60), -d.between(1, 40) if self.has_sixteen_registers else 5),
            d.choice(2, 2, 3, 4, d.between(0, 12)),
        ]  # fmt: skip
        for n, value in enumerate(values):
            self.write_register(n, value & 0xFFFFFF)
        if self.has_sixteen_registers:
            for n in (12, 13):
                self.write_register(
                    n,
                    d.choice(0, d.between(1, 120), d.between(1, 40), d.between(200, 4095))
                    | d.choice(0, 0, 0, 0x8000, 0x1000, 0x6000),
                )
            self.write_register(11, d.between(0, 15) << 16 | d.choice(0, 1, 2, 2, 3) << 20 | d.choice(0, d.bits(0.3)))
            if d.chance(0.3):
                self.write_register(8, d.choice(0, d.between(0, 100), 0xFFFFF0, 0x7FFFF0))
        self.write_command(d.choice(0xC8, 0xC8, 0xC0, 0xC0, 0xD0, 0xD8, 0xC1, 0xC9, 0xE8))
        self.write_command(0x08)

    def set_mode(self, **bits):
        """Control mode: minus b3, preset b2, sd b1, origin b0; of the larger ones automatic b4, position b5."""
        d = self.d
        value = 0x40 | d.chance(0.4) << 3 | bits.get("preset", d.chance(0.2)) << 2 | bits.get("sd", d.chance(0.2)) << 1
        value |= bits.get("origin", d.chance(0.1))
        if self.has_sixteen_registers:
            value |= d.chance(0.6 if bits.get("preset") else 0.2) << 4 | d.chance(0.3) << 5
        self.write_command(value)

    def start(self):
        self.write_command(self.d.choice(*STARTS))

    def disturb(self):
        d = self.d
        n = d.between(0, 13 if self.has_sixteen_registers else 7)
        d.choice(
            self.start, self.start, self.set_mode, self.add_reads, self.add_reads,
            lambda: self.write_command(d.choice(0x14, 0x1F, 0x1D, 0x3D, 0x18, 0x08, 0x28, 0x3F, 0x00, 0x20)),
            lambda: self.write_register(d.choice(2, 3), d.between(50, 8191), d.choice((3, 2, 1), (2, 1), (1,))),
            lambda: self.write_register(n, d.size(1, TOP.get(n, 4095)), d.choice((3, 2, 1), (2, 1), (1,), (1, 2, 3)),
                                        d.chance(0.3)),
            lambda: self.pulse_pin(d.choice(*INPUTS)), lambda: self.pulse_pin(d.choice("sd_plus", "sd_minus")), self.add_reads,
            lambda: self.write_command(d.choice(0xC0, 0xC8, 0xD0, 0xD8, 0xC1)), lambda: self.write_register(0, d.between(0, 60)),
        )  # fmt: skip

    def draw_run(self):
        self.set_mode()
        self.start()
        for _ in range(self.d.between(2, 7)):
            self.let_run(5, 3000)
            self.disturb()
            self.add_reads()
        self.write_command(self.d.choice(0x1F, 0x1D, 0x08))

    def draw_preset(self):
        d = self.d
        self.write_register(0, d.choice(d.between(1, 60), d.between(1, 400), 0))
        if self.has_sixteen_registers and d.chance(0.5):
            self.write_register(6, d.choice(0, d.between(0, 30), -d.between(1, 30)) & 0xFFFFFF)
        self.set_mode(preset=1)
        self.start()
        for _ in range(d.between(0, 4)):
            self.let_run(20, 2000)
            self.disturb()
        self.let_run(1000, 20_000)
        self.add_reads()
        if d.chance(0.5):
            self.write_command(0x08)
            self.write_register(0, d.between(1, 100))
            self.start()
            self.let_run(1000, 20_000)

    def draw_origin(self):
        d = self.d
        self.set_mode(origin=1)
        self.start()
        self.let_run(100, 2000)
        if d.chance(0.5):
            self.pulse_pin("sd_plus", "sd_minus", low=50, high=2000)
        if d.chance(0.3):
            self.pulse_pin("ez", low=1, high=40)
        self.set_pin("org", True)
        for _ in range(d.between(1, 18)):
            self.let_run(1, 200)
            self.pulse_pin("ez", low=1, high=60)
            if d.chance(0.08):
                self.disturb()
        self.add_reads()
        self.set_pin("org", False)
        self.let_run(100, 3000)

    def draw_external(self):
        d = self.d
        self.write_command(d.choice(0xD0, 0xD8, 0xD1))
        self.write_register(0, d.between(0, 12))
        self.set_mode(preset=d.chance(0.5))
        self.start()
        for _ in range(d.between(3, 14)):
            self.pulse_pin("extp", low=1, high=20)
            self.let_run(1, 20)
            if d.chance(0.1):
                self.disturb()
        self.add_reads()

    def draw_slow_down(self):
        d = self.d
        self.set_mode(sd=1)
        self.start()
        for _ in range(d.between(2, 5)):
            self.let_run(50, 3000)
            self.pulse_pin(d.choice("sd_plus", "sd_minus"), low=10, high=3000)
            if d.chance(0.3):
                self.disturb()
            self.add_reads()

    def draw_wide(self):
        """Draw a long program with any legal values."""
        d = self.d
        for n, top in TOP.items():
            self.write_register(n, d.size(1, top))
        self.set_mode(preset=d.chance(0.7))
        self.start()
        for _ in range(3):
            self.let_run(1000, 3_000_000)
            self.ops[-1] = ("advance", self.ops[-1][1])
            self.add_reads()
            if d.chance(0.4):
                self.disturb()

    def draw_chaos(self):
        d = self.d
        for _ in range(d.between(10, 40)):
            self.disturb()
            if d.chance(0.3):
                self.ops.append(("write", d.between(0, 7), d.between(0, 255)))
            if d.chance(0.2):
                self.set_pin(d.choice(*INPUTS[:-1]), d.chance(0.5))
            if d.chance(0.03):
                self.ops.append(("reset",))
            self.let_run(1, 1500)


def draw_program(chip, story, draw):
    """Draw a program of a story."""
    p = Pcl240Programs(chip.__name__, draw)
    p.write_registers()
    getattr(p, f"draw_{story}")()
    p.add_reads()
    return p.ops
