"""Random programs for the NOVA chips. The bits of mode words and the codes of commands come from the register maps."""

from stage.chips.nova import MCX312, MCX514

SPEEDS = (1, 40, 1000, 30_000, 200_000, 1_000_000, 8_000_000)


class NovaOperations:
    """Draws parts of programs of one chip class."""

    def __init__(self, chip, draw):
        self.chip, self.d, self.map = chip, draw, chip.MAP
        self.is_mcx514 = chip is MCX514
        self.ops = []
        self.axes = 1

    # --- operations ---

    def write(self, address, value):
        if self.is_mcx514 and self.bytewise:
            self.ops.append(("write_byte", 2 * address + 1, value >> 8 & 0xFF))
            self.ops.append(("write_byte", 2 * address, value & 0xFF))
        else:
            self.ops.append(("write", address, value & 0xFFFF))

    def write_command(self, symbol, axes=None, more=0):
        code = self.map.command(symbol).code | more if isinstance(symbol, str) else symbol
        self.write(0, (self.axes if axes is None else axes) << 8 | code)

    def load(self, name, value, axes=None):
        self.write(6, value & 0xFFFF)
        self.write(7, value >> 16 & 0xFFFF)
        self.write_command(name, self.axes if axes is None else axes)

    def write_word(self, n, value):
        """Write WRn of the selected axes."""
        self.write_command("NOP")
        self.write(n, value)

    def bits(self, word, **values):
        """A word of fields by name, _ for the signs that Python does not take."""
        place = self.map.word(word) if word.startswith("WR") else self.map.register(word)
        fields = {f.name.replace("-", "_").replace("+", "p"): f for f in place.fields}
        return sum(int(v) << fields[name].low for name, v in values.items())

    def let_run(self, low, high):
        clocks = self.d.size(low, high)
        self.ops.append(("trace" if clocks < 3000 and self.d.chance(0.3) else "advance", clocks))

    def set_pin(self, name, level, axis=None):
        """Set a pin of an axis, or of one of the axes in use."""
        on = [j for j in range(self.chip.AXES) if self.axes >> j & 1] or [0]
        self.ops.append(("pin", self.d.choice(*on) if axis is None else axis, name, bool(level)))

    def pulse_pin(self, name, low=1, high=20_000):
        self.set_pin(name, True)
        self.let_run(low, high)
        self.set_pin(name, False)

    def add_reads(self):
        for n in (0, 1, 2, 3, 4, 5):
            if self.d.chance(0.4):
                if self.is_mcx514 and self.bytewise:
                    self.ops += [("read_byte", 2 * n), ("read_byte", 2 * n + 1)]
                else:
                    self.ops.append(("read", n))

    def read_back(self):
        """Write a random reading command, and read the result."""
        reads = [c for c in self.map.commands if c.kind == "data read"]
        for _ in range(self.d.between(1, 3)):
            self.write_command(self.d.choice(*reads).symbol, axes=self.d.choice(self.axes, self.axes, 0))
            self.ops += [("read", 6), ("read", 7)]

    def edge_of(self, low, high):
        return self.d.choice(low, high, low - 1, high + 1, 0)

    # --- parts ---

    def load_speeds(self, fast=False):
        d = self.d
        max_speed = d.choice(200_000, 1_000_000, 1_000_000, 4_000_000) if fast else d.choice(*SPEEDS[2:])
        if self.is_mcx514:
            self.load("SV", d.choice(d.between(1, max_speed), max_speed // 10 + 1, d.size(1000, 100_000)))
            self.load("DV", d.choice(max_speed, d.size(1000, max_speed)))
            for name in ("AC", "DC"):
                self.load(name, d.choice(d.size(100_000, 536_870_911), d.size(10_000_000, 536_870_911)))
            for name in ("JK", "DJ"):
                self.load(name, d.choice(1_073_741_823, d.size(1_000_000, 1_073_741_823)))
            self.load("HV", d.size(1000, 200_000))
            self.load("IV", d.size(10, 100_000))
        else:
            self.load("R", d.choice(8_000_000, 800_000, 80_000, 16_000, d.between(16_000, 8_000_000)))
            for name in ("SV", "V", "HV"):
                self.load(name, d.size(1 if name == "SV" else 100, 8000))
            for name in ("A", "D"):
                self.load(name, d.choice(8000, d.size(50, 8000)))
            self.load("K", d.size(1, 65535))
            if self.chip is MCX312:
                self.load("L", d.size(1, 65535))
            self.load("AO", d.choice(0, 8, d.between(-40, 40)))
        if d.chance(0.3):
            self.load("DP", d.size(1, 400))

    def set_modes(self):
        d = self.d
        self.write_word(1, d.choice(0, 0, d.bits(0.3), 0x0080, 0x8000))
        if self.is_mcx514:
            self.write_word(2, d.choice(0x0800, 0, 0x1800, 0x2800, 0xA800, d.bits(0.3), d.bits(0.15) | 0x0800))
            self.write_word(3, d.choice(0, 4, 6, 2, 1, 3, d.bits(0.2), d.bits(0.4) & 0x7FFF))
        else:
            self.write_word(2, d.choice(0, 4, 1, 2, 3, 0x23, 0x2000, 0x8000, d.bits(0.2), d.bits(0.4)))
            self.write_word(3, d.choice(0, 4, 6, 2, 1, 0x20, 0x26, d.bits(0.2), d.bits(0.4)))
        if d.chance(0.3):
            self.write(4, d.bits(0.5))
            self.write(5, d.bits(0.5) if self.chip is not MCX312 else d.choice(0x4, 0x1, 0x104, d.bits(0.3)))

    def load_pulses(self):
        d = self.d
        n = 0 if d.chance(0.04) else d.choice(d.between(1, 12), d.between(1, 300), d.between(100, 4000))
        self.load("TP" if self.is_mcx514 else "P", d.choice(n, n, -n) if self.is_mcx514 else n)
        return n

    def start(self):
        d = self.d
        names = ("DRVRL", "DRVRL", "DRVNR", "DRVVP", "DRVVM", "DRVAB") if self.is_mcx514 else (
            "F_DRV_P", "F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M")  # fmt: skip
        self.write_command(d.choice(*names))

    def stop(self):
        self.write_command(self.d.choice(*(("DRVSBRK", "DRVFBRK") if self.is_mcx514 else ("STOP_DEC", "STOP_SUDDEN"))))

    def load_counters(self):
        """Load LP and other counters with values near those at which something happens."""
        d = self.d
        near = [d.between(-60, 60) for _ in range(4)]
        self.load("LP", d.choice(0, d.between(-50, 50), d.between(-50, 50), 0x7FFFFFF0, 0x80000005))
        self.load("RP" if self.is_mcx514 else "EP", d.choice(0, d.between(-20, 20), 0x7FFFFFFE))
        if self.is_mcx514:
            self.load("SP", near[0])
            self.load("SM", near[1])
            for m in range(4):
                if d.chance(0.6):
                    self.load(f"MR{m}", d.choice(near[m], near[m], d.size(1, 200), d.size(1000, 1_000_000), -near[m]))
            if d.chance(0.25):
                self.load(d.choice("LX", "RX"), d.choice(1, d.between(2, 90), 2_147_483_647, 0xFFFFFFFF))
        else:
            self.load("CP", near[0])
            self.load("CM", near[1])

    def disturb(self):
        """Do something in the midst of a drive."""
        d = self.d

        def speed():
            if self.is_mcx514:
                self.load("DV", d.size(1000, 4_000_000))
            else:
                self.load("V", d.size(50, 8000))

        def rate():
            new_registers = (
                ("AC", 100_000, 500_000_000),
                ("DC", 100_000, 500_000_000),
                ("JK", 1, 1_000_000_000),
                ("SV", 1, 100_000),
            )
            old_registers = (("A", 1, 8000), ("K", 1, 65535), ("SV", 1, 8000), ("R", 400_000, 400_000))
            name, low, high = d.choice(*(new_registers if self.is_mcx514 else old_registers))
            self.load(name, d.size(low, high))

        def step():
            if self.is_mcx514:
                for _ in range(d.between(1, 3)):
                    self.write_command(d.choice("VINC", "VDEC"))
            else:
                speed()

        def hold():
            self.write_command("DHOLD" if self.is_mcx514 else "START_HOLD")
            self.load_pulses()
            self.start()
            self.let_run(10, 3000)
            self.write_command("DFREE" if self.is_mcx514 else "START_FREE")

        def inputs():
            self.pulse_pin(d.choice("lmt_plus", "lmt_minus", "stop0", "stop1", "stop2", "inpos", "alarm"))

        def emergency():
            self.ops.append(("pin", self.chip.AXES, "emg", True))
            self.let_run(1, 3000)
            if d.chance(0.5):
                self.add_reads()
                self.start()
            self.ops.append(("pin", self.chip.AXES, "emg", False))
            if self.is_mcx514 and d.chance(0.7):
                self.write_command("R2CLR")

        def also():
            if self.is_mcx514:
                self.write_command(
                    d.choice("DIRCP", "DIRCM", "DCC", "R2CLR", "RR3P0", "RR3P1", "TMSTA", "TMSTP", "SPSTA", "SPSTP")
                )
            else:
                self.write_command(d.choice("DEVCTR_CLR", "START_FREE", "NOP"))

        d.choice(
            speed, speed, rate, step, step, hold, inputs, inputs, inputs, emergency, also, also, self.stop, self.load_pulses,
            self.start, self.add_reads, self.add_reads, self.read_back, self.load_counters, self.set_modes, self.turn_encoder,
            lambda: self.let_run(1, 40_000),
        )  # fmt: skip

    def turn_encoder(self):
        """Make some edges of the encoder, mostly in one direction."""
        a = b = False
        for _ in range(self.d.between(2, 12)):
            if self.d.chance(0.8):
                a, b = not b, a
            else:
                a, b = self.d.choice((not a, b), (a, not b), (not a, not b), (b, not a))
            axis = self.d.choice(*(j for j in range(self.chip.AXES) if self.axes >> j & 1))
            self.set_pin("eca", a, axis)
            self.set_pin("ecb", b, axis)
            self.let_run(1, 600)

    # --- stories ---

    def draw_drive(self):
        self.set_modes()
        self.load_speeds()
        if self.d.chance(0.6):
            self.load_counters()
        for _ in range(self.d.between(1, 4)):
            self.load_pulses()
            self.start()
            self.let_run(20, 60_000)
            for _ in range(self.d.between(0, 3)):
                self.disturb()
                self.let_run(1, 30_000)
            self.add_reads()
            self.let_run(100, 400_000)

    def draw_long(self):
        """Draw a single drive of many pulses with complete ramps and any legal values."""
        d = self.d
        self.write_word(3, d.choice(0, 4, 6, 2, 1, 5))
        self.load_speeds(fast=True)
        if d.chance(0.3):
            self.write_word(2, 0)
        n = d.size(100, 200_000)
        self.load("TP" if self.is_mcx514 else "P", n)
        self.start()
        for _ in range(3):
            self.let_run(1000, 3_000_000)
            self.read_back()
            if d.chance(0.4):
                self.disturb()
        self.stop()
        self.let_run(1000, 3_000_000)

    def draw_home(self):
        d = self.d
        self.load_speeds()
        if self.is_mcx514:
            self.write_word(2, d.choice(0x0800, 0x0800, d.bits(0.2) | 0x0800, 0x1800))
            self.load("H1M", d.choice(d.bits(0.5), d.bits(0.4) | 0x8411, 0x0411 | d.bits(0.3), 0x0451 | d.bits(0.2)))
            self.load("H2M", d.choice(0, d.bits(0.4) & 0x7FF, 0x80 | d.bits(0.2), 1, 6))
            self.load("TP", d.between(-40, 40))
        else:
            self.write_word(1, d.choice(0, 0x15, d.bits(0.2)))
            self.write_word(2, d.choice(0, 0, 4, 0x2000, d.bits(0.1)))
            self.load(
                "HM", d.choice(d.bits(0.5), 0x15 | d.bits(0.3), 0x55 | d.bits(0.3), 0x455 | d.bits(0.3), 0x0255, 0x0C55)
            )
            self.load("P", d.between(0, 40))
        if d.chance(0.4):
            self.ops.append(("pin", 0, d.choice("stop0", "stop1", "lmt_plus", "lmt_minus", "stop2"), True))
        self.write_command("HMSRC" if self.is_mcx514 else "HOME_EXEC")
        signals = ("stop0", "stop1", "stop2", "lmt_plus", "lmt_minus", "stop1", "stop1")
        for _ in range(d.between(5, 14)):
            self.let_run(100, 60_000)
            self.set_pin(d.choice(*signals), d.chance(0.5))
            if d.chance(0.08):
                self.disturb()
            if d.chance(0.05):
                self.pulse_pin("alarm")
            self.add_reads()
        for name in signals[:5]:
            self.set_pin(name, False)
            self.let_run(1000, 200_000)
        for name in ("stop0", "stop1", "stop2", "lmt_plus", "lmt_minus"):
            self.pulse_pin(name, 10_000, 300_000)
            self.let_run(1000, 200_000)

    def draw_chaos(self):
        """Draw any command with any number, any word, or any pin."""
        d = self.d
        self.load_speeds()
        self.set_modes()
        for _ in range(d.between(8, 30)):
            kind = d.between(0, 5)
            if kind <= 2:
                value = d.choice(d.between(-60, 60), d.size(1, 1_000_000), d.size(1, (1 << 32) - 1))
                self.load(
                    d.choice(*(c.code for c in self.map.commands), d.between(0, 255)),
                    value,
                    d.between(0, self.all_axes),
                )
            elif kind == 3:
                self.write_word(d.between(1, 5), d.bits(0.3))
            elif kind == 4:
                self.set_pin(d.choice(*self.chip.INPUTS), d.chance(0.5), d.between(0, self.chip.AXES - 1))
            else:
                self.disturb()
            self.let_run(1, 4000)
            self.add_reads()
        if not self.is_mcx514 and d.chance(0.3):
            self.write(0, 0x8000)
            self.add_reads()

    @property
    def all_axes(self):
        return (1 << self.chip.AXES) - 1

    def draw_program(self, story):
        d = self.d
        self.bytewise = self.is_mcx514 and d.chance(0.1)
        self.axes = d.choice(1, 1, 2, 3, d.between(1, self.all_axes))
        getattr(self, f"draw_{story}")()
        if d.chance(0.3):
            self.ops.append(d.choice(("reset",), ("write", 0, 0x00FF if self.is_mcx514 else 0x8000)))
            self.add_reads()
        self.read_back()
        return self.ops
