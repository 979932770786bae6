"""Random programs for the NOVA chips. The bits of mode words and the codes of commands come from the register maps."""

from stage.chips.nova import MCX312, MCX514

SPEEDS = (1, 40, 1000, 30_000, 200_000, 1_000_000, 8_000_000)


class NovaDraw:
    """Draws programs of one chip class."""

    def __init__(self, chip, draw):
        self.chip, self.d, self.map = chip, draw, chip.MAP
        self.new = chip is MCX514
        self.ops = []
        self.axes = 1

    # --- operations ---

    def write(self, address, value):
        if self.new and self.bytewise:
            self.ops.append(("write_byte", 2 * address + 1, value >> 8 & 0xFF))
            self.ops.append(("write_byte", 2 * address, value & 0xFF))
        else:
            self.ops.append(("write", address, value & 0xFFFF))

    def command(self, symbol, axes=None, more=0):
        code = self.map.command(symbol).code | more if isinstance(symbol, str) else symbol
        self.write(0, (self.axes if axes is None else axes) << 8 | code)

    def load(self, name, value, axes=None):
        self.write(6, value & 0xFFFF)
        self.write(7, value >> 16 & 0xFFFF)
        self.command(name, self.axes if axes is None else axes)

    def word(self, n, value):
        """WRn of the axes."""
        self.command("NOP")
        self.write(n, value)

    def bits(self, word, **values):
        """A word of fields by name, _ for the signs that Python does not take."""
        place = self.map.word(word) if word.startswith("WR") else self.map.register(word)
        fields = {f.name.replace("-", "_").replace("+", "p"): f for f in place.fields}
        return sum(int(v) << fields[name].low for name, v in values.items())

    def advance(self, low, high):
        clocks = self.d.size(low, high)
        self.ops.append(("trace" if clocks < 3000 and self.d.chance(0.3) else "advance", clocks))

    def pin(self, name, level, axis=None):
        """Of one of the axes in use."""
        on = [j for j in range(self.chip.AXES) if self.axes >> j & 1] or [0]
        self.ops.append(("pin", self.d.of(*on) if axis is None else axis, name, bool(level)))

    def touch(self, name, low=1, high=20_000):
        self.pin(name, True)
        self.advance(low, high)
        self.pin(name, False)

    def look(self):
        for n in (0, 1, 2, 3, 4, 5):
            if self.d.chance(0.4):
                if self.new and self.bytewise:
                    self.ops += [("read_byte", 2 * n), ("read_byte", 2 * n + 1)]
                else:
                    self.ops.append(("read", n))

    def read_back(self):
        """Some reading command."""
        reads = [c for c in self.map.commands if c.kind == "data read"]
        for _ in range(self.d.between(1, 3)):
            self.command(self.d.of(*reads).symbol, axes=self.d.of(self.axes, self.axes, 0))
            self.ops += [("read", 6), ("read", 7)]

    def edge_of(self, low, high):
        return self.d.of(low, high, low - 1, high + 1, 0)

    # --- parts ---

    def speeds(self, fast=False):
        d = self.d
        most = d.of(200_000, 1_000_000, 1_000_000, 4_000_000) if fast else d.of(*SPEEDS[2:])
        if self.new:
            self.load("SV", d.of(d.between(1, most), most // 10 + 1, d.size(1000, 100_000)))
            self.load("DV", d.of(most, d.size(1000, most)))
            for name in ("AC", "DC"):
                self.load(name, d.of(d.size(100_000, 536_870_911), d.size(10_000_000, 536_870_911)))
            for name in ("JK", "DJ"):
                self.load(name, d.of(1_073_741_823, d.size(1_000_000, 1_073_741_823)))
            self.load("HV", d.size(1000, 200_000))
            self.load("IV", d.size(10, 100_000))
        else:
            self.load("R", d.of(8_000_000, 800_000, 80_000, 16_000, d.between(16_000, 8_000_000)))
            for name in ("SV", "V", "HV"):
                self.load(name, d.size(1 if name == "SV" else 100, 8000))
            for name in ("A", "D"):
                self.load(name, d.of(8000, d.size(50, 8000)))
            self.load("K", d.size(1, 65535))
            if self.chip is MCX312:
                self.load("L", d.size(1, 65535))
            self.load("AO", d.of(0, 8, d.between(-40, 40)))
        if d.chance(0.3):
            self.load("DP", d.size(1, 400))

    def modes(self):
        d = self.d
        self.word(1, d.of(0, 0, d.bits(0.3), 0x0080, 0x8000))
        if self.new:
            self.word(2, d.of(0x0800, 0, 0x1800, 0x2800, 0xA800, d.bits(0.3), d.bits(0.15) | 0x0800))
            self.word(3, d.of(0, 4, 6, 2, 1, 3, d.bits(0.2), d.bits(0.4) & 0x7FFF))
        else:
            self.word(2, d.of(0, 4, 1, 2, 3, 0x23, 0x2000, 0x8000, d.bits(0.2), d.bits(0.4)))
            self.word(3, d.of(0, 4, 6, 2, 1, 0x20, 0x26, d.bits(0.2), d.bits(0.4)))
        if d.chance(0.3):
            self.write(4, d.bits(0.5))
            self.write(5, d.bits(0.5) if self.chip is not MCX312 else d.of(0x4, 0x1, 0x104, d.bits(0.3)))

    def pulses(self):
        d = self.d
        n = 0 if d.chance(0.04) else d.of(d.between(1, 12), d.between(1, 300), d.between(100, 4000))
        self.load("TP" if self.new else "P", d.of(n, n, -n) if self.new else n)
        return n

    def start(self):
        d = self.d
        names = ("DRVRL", "DRVRL", "DRVNR", "DRVVP", "DRVVM", "DRVAB") if self.new else (
            "F_DRV_P", "F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M")  # fmt: skip
        self.command(d.of(*names))

    def stop(self):
        self.command(self.d.of(*(("DRVSBRK", "DRVFBRK") if self.new else ("STOP_DEC", "STOP_SUDDEN"))))

    def counters(self):
        """LP and the like near where something happens."""
        d = self.d
        near = [d.between(-60, 60) for _ in range(4)]
        self.load("LP", d.of(0, d.between(-50, 50), d.between(-50, 50), 0x7FFFFFF0, 0x80000005))
        self.load("RP" if self.new else "EP", d.of(0, d.between(-20, 20), 0x7FFFFFFE))
        if self.new:
            self.load("SP", near[0])
            self.load("SM", near[1])
            for m in range(4):
                if d.chance(0.6):
                    self.load(f"MR{m}", d.of(near[m], near[m], d.size(1, 200), d.size(1000, 1_000_000), -near[m]))
            if d.chance(0.25):
                self.load(d.of("LX", "RX"), d.of(1, d.between(2, 90), 2_147_483_647, 0xFFFFFFFF))
        else:
            self.load("CP", near[0])
            self.load("CM", near[1])

    def happening(self):
        """Something in the midst of a drive."""
        d = self.d

        def speed():
            if self.new:
                self.load("DV", d.size(1000, 4_000_000))
            else:
                self.load("V", d.size(50, 8000))

        def rate():
            new = (
                ("AC", 100_000, 500_000_000),
                ("DC", 100_000, 500_000_000),
                ("JK", 1, 1_000_000_000),
                ("SV", 1, 100_000),
            )
            old = (("A", 1, 8000), ("K", 1, 65535), ("SV", 1, 8000), ("R", 400_000, 400_000))
            name, low, high = d.of(*(new if self.new else old))
            self.load(name, d.size(low, high))

        def step():
            if self.new:
                for _ in range(d.between(1, 3)):
                    self.command(d.of("VINC", "VDEC"))
            else:
                speed()

        def hold():
            self.command("DHOLD" if self.new else "START_HOLD")
            self.pulses()
            self.start()
            self.advance(10, 3000)
            self.command("DFREE" if self.new else "START_FREE")

        def inputs():
            self.touch(d.of("lmt_plus", "lmt_minus", "stop0", "stop1", "stop2", "inpos", "alarm"))

        def emergency():
            self.ops.append(("pin", self.chip.AXES, "emg", True))
            self.advance(1, 3000)
            if d.chance(0.5):
                self.look()
                self.start()
            self.ops.append(("pin", self.chip.AXES, "emg", False))
            if self.new and d.chance(0.7):
                self.command("R2CLR")

        def also():
            if self.new:
                self.command(
                    d.of("DIRCP", "DIRCM", "DCC", "R2CLR", "RR3P0", "RR3P1", "TMSTA", "TMSTP", "SPSTA", "SPSTP")
                )
            else:
                self.command(d.of("DEVCTR_CLR", "START_FREE", "NOP"))

        d.of(
            speed, speed, rate, step, step, hold, inputs, inputs, inputs, emergency, also, also, self.stop, self.pulses,
            self.start, self.look, self.look, self.read_back, self.counters, self.modes, self.encoder,
            lambda: self.advance(1, 40_000),
        )  # fmt: skip

    def encoder(self):
        """Some edges of the encoder, mostly one way."""
        a = b = False
        for _ in range(self.d.between(2, 12)):
            if self.d.chance(0.8):
                a, b = not b, a
            else:
                a, b = self.d.of((not a, b), (a, not b), (not a, not b), (b, not a))
            axis = self.d.of(*(j for j in range(self.chip.AXES) if self.axes >> j & 1))
            self.pin("eca", a, axis)
            self.pin("ecb", b, axis)
            self.advance(1, 600)

    # --- stories ---

    def drive_story(self):
        self.modes()
        self.speeds()
        if self.d.chance(0.6):
            self.counters()
        for _ in range(self.d.between(1, 4)):
            self.pulses()
            self.start()
            self.advance(20, 60_000)
            for _ in range(self.d.between(0, 3)):
                self.happening()
                self.advance(1, 30_000)
            self.look()
            self.advance(100, 400_000)

    def long_story(self):
        """A single drive of many pulses, whole ramps, any legal values."""
        d = self.d
        self.word(3, d.of(0, 4, 6, 2, 1, 5))
        self.speeds(fast=True)
        if d.chance(0.3):
            self.word(2, 0)
        n = d.size(100, 200_000)
        self.load("TP" if self.new else "P", n)
        self.start()
        for _ in range(3):
            self.advance(1000, 3_000_000)
            self.read_back()
            if d.chance(0.4):
                self.happening()
        self.stop()
        self.advance(1000, 3_000_000)

    def home_story(self):
        d = self.d
        self.speeds()
        if self.new:
            self.word(2, d.of(0x0800, 0x0800, d.bits(0.2) | 0x0800, 0x1800))
            self.load("H1M", d.of(d.bits(0.5), d.bits(0.4) | 0x8411, 0x0411 | d.bits(0.3), 0x0451 | d.bits(0.2)))
            self.load("H2M", d.of(0, d.bits(0.4) & 0x7FF, 0x80 | d.bits(0.2), 1, 6))
            self.load("TP", d.between(-40, 40))
        else:
            self.word(1, d.of(0, 0x15, d.bits(0.2)))
            self.word(2, d.of(0, 0, 4, 0x2000, d.bits(0.1)))
            self.load(
                "HM", d.of(d.bits(0.5), 0x15 | d.bits(0.3), 0x55 | d.bits(0.3), 0x455 | d.bits(0.3), 0x0255, 0x0C55)
            )
            self.load("P", d.between(0, 40))
        if d.chance(0.4):
            self.ops.append(("pin", 0, d.of("stop0", "stop1", "lmt_plus", "lmt_minus", "stop2"), True))
        self.command("HMSRC" if self.new else "HOME_EXEC")
        signals = ("stop0", "stop1", "stop2", "lmt_plus", "lmt_minus", "stop1", "stop1")
        for _ in range(d.between(5, 14)):
            self.advance(100, 60_000)
            self.pin(d.of(*signals), d.chance(0.5))
            if d.chance(0.08):
                self.happening()
            if d.chance(0.05):
                self.touch("alarm")
            self.look()
        for name in signals[:5]:
            self.pin(name, False)
            self.advance(1000, 200_000)
        for name in ("stop0", "stop1", "stop2", "lmt_plus", "lmt_minus"):
            self.touch(name, 10_000, 300_000)
            self.advance(1000, 200_000)

    def chaos_story(self):
        """Any command with any number, any word, any pin."""
        d = self.d
        self.speeds()
        self.modes()
        for _ in range(d.between(8, 30)):
            kind = d.between(0, 5)
            if kind <= 2:
                value = d.of(d.between(-60, 60), d.size(1, 1_000_000), d.size(1, (1 << 32) - 1))
                self.load(d.of(*(c.code for c in self.map.commands), d.between(0, 255)), value, d.between(0, self.all))
            elif kind == 3:
                self.word(d.between(1, 5), d.bits(0.3))
            elif kind == 4:
                self.pin(d.of(*self.chip.INPUTS), d.chance(0.5), d.between(0, self.chip.AXES - 1))
            else:
                self.happening()
            self.advance(1, 4000)
            self.look()
        if not self.new and d.chance(0.3):
            self.write(0, 0x8000)
            self.look()

    @property
    def all(self):
        return (1 << self.chip.AXES) - 1

    def program(self, story):
        d = self.d
        self.bytewise = self.new and d.chance(0.1)
        self.axes = d.of(1, 1, 2, 3, d.between(1, self.all))
        getattr(self, f"{story}_story")()
        if d.chance(0.3):
            self.ops.append(d.of(("reset",), ("write", 0, 0x00FF if self.new else 0x8000)))
            self.look()
        self.read_back()
        return self.ops
