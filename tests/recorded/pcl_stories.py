"""Random programs for the PCL-240 family: runs, ramps, origin returns, external pulses, and chaos, in full and in small values."""

STORIES = {"run": 5, "preset": 5, "origin": 3, "external": 2, "slow_down": 2, "wide": 3, "chaos": 4}
STARTS = (0x15, 0x17, 0x35, 0x37, 0x11, 0x13, 0x10, 0x14, 0x31)
INPUTS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org", "ins", "extp", "ez")
TOP = {0: 0xFFFFFF, 1: 8191, 2: 8191, 3: 8191, 4: 65535, 5: 65535, 6: 0xFFFFFF, 7: 1023}


class PclDraw:
    def __init__(self, chip, draw):
        self.d, self.ops = draw, []
        self.extended, self.curves = chip != "PCL240K", chip == "PCL240MS"

    def command(self, value):
        self.ops.append(("write", 0, value))

    def register(self, n, value, addresses=(3, 2, 1), collective=False):
        self.command(0x80 | collective << 5 | (n & 8) << 1 | n & 7)
        self.ops += [("write", a, value >> 8 * (a - 1) & 0xFF) for a in addresses]

    def advance(self, low, high):
        self.ops.append((self.d.of("advance", "trace"), self.d.size(low, high)))

    def pin(self, name, level):
        self.ops.append(("pin", 0, name, level))

    def touch(self, *names, low=1, high=400):
        names = [name for name in names if self.extended or name != "ez"]
        for name in names:
            self.pin(name, True)
        self.advance(low, high)
        for name in names:
            self.pin(name, False)

    def look(self):
        d = self.d
        if d.chance(0.5):
            self.ops.append(("read", 0))
        if d.chance(0.3):
            self.command(0x80 | d.chance(0.3) << 5 | d.between(0, 15 if self.extended else 7) % 8 | d.chance(0.4) << 4)
            self.ops += [("read", a) for a in d.of((3, 2, 1), (1, 2, 3), (1,), (2,))]

    def setup(self):
        d = self.d
        fl = d.of(d.between(50, 2000), d.between(400, 2000))
        values = [
            d.of(d.between(1, 60), d.between(1, 300), d.between(1, 30)), fl,
            d.of(fl + d.between(-20, 600), d.between(500, 8191)), d.of(fl + d.between(-20, 900), d.between(500, 8191)),
            d.of(2, 3, d.between(2, 12), d.between(0, 60)), d.of(2, 3, d.between(2, 12), d.between(0, 60)),
            d.of(0, d.between(0, 60), -d.between(1, 40) if self.extended else 5), d.of(2, 2, 3, 4, d.between(0, 12)),
        ]  # fmt: skip
        for n, value in enumerate(values):
            self.register(n, value & 0xFFFFFF)
        if self.extended:
            for n in (12, 13):
                self.register(
                    n,
                    d.of(0, d.between(1, 120), d.between(1, 40), d.between(200, 4095))
                    | d.of(0, 0, 0, 0x8000, 0x1000, 0x6000),
                )
            self.register(11, d.between(0, 15) << 16 | d.of(0, 1, 2, 2, 3) << 20 | d.of(0, d.bits(0.3)))
            if d.chance(0.3):
                self.register(8, d.of(0, d.between(0, 100), 0xFFFFF0, 0x7FFFF0))
        self.command(d.of(0xC8, 0xC8, 0xC0, 0xC0, 0xD0, 0xD8, 0xC1, 0xC9, 0xE8))
        self.command(0x08)

    def control(self, **bits):
        """Control mode: minus b3, preset b2, sd b1, origin b0; of the larger ones automatic b4, position b5."""
        d = self.d
        value = 0x40 | d.chance(0.4) << 3 | bits.get("preset", d.chance(0.2)) << 2 | bits.get("sd", d.chance(0.2)) << 1
        value |= bits.get("origin", d.chance(0.1))
        if self.extended:
            value |= d.chance(0.6 if bits.get("preset") else 0.2) << 4 | d.chance(0.3) << 5
        self.command(value)

    def start(self):
        self.command(self.d.of(*STARTS))

    def happening(self):
        d = self.d
        n = d.between(0, 13 if self.extended else 7)
        d.of(
            self.start, self.start, self.control, self.look, self.look,
            lambda: self.command(d.of(0x14, 0x1F, 0x1D, 0x3D, 0x18, 0x08, 0x28, 0x3F, 0x00, 0x20)),
            lambda: self.register(d.of(2, 3), d.between(50, 8191), d.of((3, 2, 1), (2, 1), (1,))),
            lambda: self.register(n, d.size(1, TOP.get(n, 4095)), d.of((3, 2, 1), (2, 1), (1,), (1, 2, 3)), d.chance(0.3)),
            lambda: self.touch(d.of(*INPUTS)), lambda: self.touch(d.of("sd_plus", "sd_minus")), self.look,
            lambda: self.command(d.of(0xC0, 0xC8, 0xD0, 0xD8, 0xC1)), lambda: self.register(0, d.between(0, 60)),
        )  # fmt: skip

    def run(self):
        self.control()
        self.start()
        for _ in range(self.d.between(2, 7)):
            self.advance(5, 3000)
            self.happening()
            self.look()
        self.command(self.d.of(0x1F, 0x1D, 0x08))

    def preset(self):
        d = self.d
        self.register(0, d.of(d.between(1, 60), d.between(1, 400), 0))
        if self.extended and d.chance(0.5):
            self.register(6, d.of(0, d.between(0, 30), -d.between(1, 30)) & 0xFFFFFF)
        self.control(preset=1)
        self.start()
        for _ in range(d.between(0, 4)):
            self.advance(20, 2000)
            self.happening()
        self.advance(1000, 20_000)
        self.look()
        if d.chance(0.5):
            self.command(0x08)
            self.register(0, d.between(1, 100))
            self.start()
            self.advance(1000, 20_000)

    def origin(self):
        d = self.d
        self.control(origin=1)
        self.start()
        self.advance(100, 2000)
        if d.chance(0.5):
            self.touch("sd_plus", "sd_minus", low=50, high=2000)
        if d.chance(0.3):
            self.touch("ez", low=1, high=40)
        self.pin("org", True)
        for _ in range(d.between(1, 18)):
            self.advance(1, 200)
            self.touch("ez", low=1, high=60)
            if d.chance(0.08):
                self.happening()
        self.look()
        self.pin("org", False)
        self.advance(100, 3000)

    def external(self):
        d = self.d
        self.command(d.of(0xD0, 0xD8, 0xD1))
        self.register(0, d.between(0, 12))
        self.control(preset=d.chance(0.5))
        self.start()
        for _ in range(d.between(3, 14)):
            self.touch("extp", low=1, high=20)
            self.advance(1, 20)
            if d.chance(0.1):
                self.happening()
        self.look()

    def slow_down(self):
        d = self.d
        self.control(sd=1)
        self.start()
        for _ in range(d.between(2, 5)):
            self.advance(50, 3000)
            self.touch(d.of("sd_plus", "sd_minus"), low=10, high=3000)
            if d.chance(0.3):
                self.happening()
            self.look()

    def wide(self):
        """Any legal values, long."""
        d = self.d
        for n, top in TOP.items():
            self.register(n, d.size(1, top))
        self.control(preset=d.chance(0.7))
        self.start()
        for _ in range(3):
            self.advance(1000, 3_000_000)
            self.ops[-1] = ("advance", self.ops[-1][1])
            self.look()
            if d.chance(0.4):
                self.happening()

    def chaos(self):
        d = self.d
        for _ in range(d.between(10, 40)):
            self.happening()
            if d.chance(0.3):
                self.ops.append(("write", d.between(0, 7), d.between(0, 255)))
            if d.chance(0.2):
                self.pin(d.of(*INPUTS[:-1]), d.chance(0.5))
            if d.chance(0.03):
                self.ops.append(("reset",))
            self.advance(1, 1500)


def program(chip, story, draw):
    p = PclDraw(chip, draw)
    p.setup()
    getattr(p, story)()
    p.look()
    return p.ops
