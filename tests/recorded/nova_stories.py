"""More random programs for the NOVA chips: synchronous actions, comparisons, timers, split pulses, filters, interpolation."""

from recorded.nova_draws import NovaDraw

from stage.chips.nova import MCX312, MCX514


class Stories(NovaDraw):
    # --- MCX514 ---

    def ports_story(self):
        """PIO as inputs, outputs, status, comparisons; general outputs."""
        d = self.d
        self.load("P1M", d.of(0, 0x5555, 0xAAAA, 0xFFFF, d.bits(0.5)))
        self.write(4, d.bits(0.5))
        self.write(5, d.bits(0.5))
        self.compare()
        self.speeds()
        self.pulses()
        self.start()
        for _ in range(d.between(2, 5)):
            self.advance(10, 20_000)
            self.pin(self.port(d.between(0, 7)), d.chance(0.5))
            self.look()
            self.command(d.of("RR3P1", "RR3P0"))
            self.look()

    def port(self, k):
        return f"pio{k}" if self.new else ("exp_plus", "exp_minus")[k & 1]

    def compare(self):
        """Comparisons of all kinds, near where they come true."""
        d = self.d
        self.load("MRM", d.of(d.bits(0.5), 0, 0x8888, 0x2222, 0x3B3B))
        self.counters()
        for m in range(4):
            self.load(f"MR{m}", d.of(d.between(-40, 40), d.between(-40, 40), d.size(1, 500), d.size(1000, 400_000)))

    def timer(self):
        self.load("TM", self.d.of(1, self.d.size(1, 400), self.d.size(1, 40)))
        self.command("TMSTA")

    def split(self):
        d = self.d
        width = d.of(d.between(1, 6), d.between(1, 3))
        self.load("SP1", width << 16 | d.of(width + d.between(0, 9), 2, width, d.between(2, 30)))
        self.load("SP2", d.of(0, d.between(1, 9), 1))
        if d.chance(0.7):
            self.command("SPSTA")

    def sync_story(self):
        d = self.d
        self.load("P1M", d.of(0, 0, 0x5555, 0xFF00, d.bits(0.3)))
        self.word(1, d.of(0xFFFF, d.bits(0.4)))
        self.word(2, d.of(0, 0x0800, 0x2000))
        self.word(3, d.of(0, 4, 0x4000, 2))
        self.speeds()
        self.compare()
        for m in range(4):
            if d.chance(0.8):
                links = d.bits(0.12, 6) << 9
                self.load(
                    f"S{m}M",
                    d.between(0, 15) | d.between(0, 24 if d.chance(0.95) else 31) << 4 | links | d.chance(0.6) << 15,
                )
        if d.chance(0.25):  # sets that ask each other in a ring, and SYNC0 of the next axis
            for m in range(4):
                self.load(
                    f"S{m}M",
                    d.between(0, 15) | d.of(5, 9, 19, 21, 23) << 4 | d.of(0x200, 0x600, 0x1200) | 0x8000,
                    self.all,
                )
        self.command("SYNCEN", more=d.between(1, 15), axes=d.of(self.axes, self.all))
        for _ in range(d.between(3, 8)):
            d.of(self.timer, self.split, self.start, self.start, self.pulses, self.stop, self.encoder, self.counters,
                 lambda: self.command(d.of("SYNCACT", "SYNCACT", "SYNCDIS", "SYNCEN"), more=d.between(1, 15)))  # fmt: skip
            if d.chance(0.6):
                self.pin(self.port(d.between(0, 7)), d.chance(0.6))
            self.advance(1, 20_000)
            self.look()
            if d.chance(0.3):
                self.happening()
        self.advance(1000, 100_000)

    def split_story(self):
        d = self.d
        self.speeds()
        self.word(1, 0x0C00)
        self.split()
        self.pulses()
        self.start()
        for _ in range(d.between(2, 5)):
            self.advance(10, 30_000)
            d.of(self.split, self.look, self.timer, lambda: self.command(d.of("SPSTA", "SPSTP", "TMSTP", "DCC")))
            self.read_back()

    def timer_story(self):
        d = self.d
        self.word(3, d.of(0, 0x4000))
        self.word(1, 0x0200)
        self.load("MRM", d.of(0x3333, 0x7777, 0xBBBB, 0xFFFF))
        for m in range(4):
            self.load(f"MR{m}", d.size(1, 300))
        self.timer()
        for _ in range(d.between(2, 6)):
            self.advance(1, 8000)
            d.of(
                self.look,
                self.read_back,
                self.timer,
                lambda: self.command("TMSTP"),
                lambda: self.load("TM", d.size(1, 200)),
            )

    def filter_story(self):
        """Inputs shorter and longer than their filters."""
        d = self.d
        if self.new:
            self.load("FLM", d.of(0x00FF | d.bits(0.2), d.bits(0.5), 0x02FE, 0x11FF))
            self.word(2, d.of(0x0800, 0x0A2A, 0x0880, d.bits(0.4)))
        else:
            self.word(3, d.of(0x1F00, 0x3F00, d.bits(0.5)))
            self.word(1, d.of(0x2A, 0x15, 0x3F, 0x7F, d.bits(0.3)))
            self.word(2, d.of(0, 0x2000, 0x8000, 4, 0x0600, 0x0A00, d.bits(0.3)))
        self.speeds()
        self.pulses()
        self.start()
        for _ in range(d.between(4, 12)):
            name = d.of(
                "lmt_plus",
                "lmt_minus",
                "stop0",
                "stop1",
                "stop2",
                "inpos",
                "alarm",
                "eca",
                "ecb",
                *(("pio0", "pio7") if self.new else ("exp_plus", "exp_minus")),
            )
            self.touch(name, 1, d.of(8, 64, 1000, 20_000))
            self.advance(1, d.of(16, 2000, 9000))
            self.look()
            if d.chance(0.3):
                self.start()
            if d.chance(0.2):
                self.encoder()

    def rings_story(self):
        """Ring counters, software limits, counters that turn over."""
        d = self.d
        self.speeds(fast=True)
        if self.new:
            self.word(2, d.of(0x2000, 0xA000, 0x6000, 0xE000, 0))
            self.load("LX", d.of(0xFFFFFFFF, d.between(1, 60)))
            self.load("RX", d.of(0xFFFFFFFF, d.between(1, 60)))
            self.word(3, d.of(0, 0x0100, 0x0200, 0x0300, 0x0800, d.bits(0.2)))
            if d.chance(0.5):
                self.load("MRM", d.bits(0.4))
        else:
            self.word(2, d.of(1, 2, 3, 0x21, 0x23, 0x27, 0x0223, 0x0423, 0x0823, 0x0C23))
            self.word(1, d.of(0x40, 0x80, 0xC0, 0x1F00))
        self.counters()
        for _ in range(d.between(2, 5)):
            self.pulses()
            self.start()
            self.advance(100, 60_000)
            self.encoder()
            self.look()
            self.read_back()
        if not self.new:
            self.touch("stop2", 1, 100)

    # --- interpolation ---

    def segment(self):
        """One segment of the MCX514."""
        d = self.d
        far = d.of(6, 30, 200)
        axes = [1 << j for j in range(4)]
        kind = d.of("line", "line", "arc", "arc", "pattern", "helix")
        if kind == "line":
            for bit in axes:
                self.load("TP", d.between(-far, far), bit)
            self.command(d.of("LHK2", "LHK2", "LHK3", "LHK4", "LHK1"), 0)
        elif kind == "pattern":
            for bit in axes:
                self.load("TP", d.bits(0.5) | d.bits(0.3) << 16, bit)
            self.command(d.of("BHK2", "BHK3", "BHK4"), 0)
        else:
            r = d.between(1, far)
            centre = d.of((-r, 0), (0, r), (d.between(-far, far), d.between(-far, far)), (0, 0))
            opposite, beside = (2 * centre[0], 2 * centre[1]), (centre[0], centre[1] + r)
            finish = d.of((0, 0), beside, (d.between(-far, far), d.between(-far, far)), opposite)
            for k, bit in enumerate(axes):
                self.load("CP", centre[k % 2], bit)
                self.load("TP", finish[k % 2] if k < 2 else d.between(-far, far), bit)
            if kind == "helix":
                self.load("HLN", d.of(0, 1, 2), 0)
                if d.chance(0.7):
                    self.command(d.of("HLPCW", "HLPCCW"), 0)
                else:
                    self.load("HLV", d.size(1, 400), 0)
                self.command(d.of("HLCW", "HLCCW"), 0)
            else:
                self.command(d.of("CHKCW", "CHKCCW"), 0)

    def interpolation_story(self):
        d = self.d
        if self.chip is MCX312:
            self.interpolation312()
            return
        self.axes = 15
        self.word(1, 0)
        self.word(2, d.of(0, 0x0800, 0x2000))
        self.word(3, d.of(0, 0, 4, 2, 1))
        self.speeds(fast=d.chance(0.7))
        if d.chance(0.3):
            self.counters()
        mask = d.of(3, 3, 7, 15, 5, 6, 9, 14, 1, 11)
        mode = mask | d.of(0, 0x40, 0x80, 0xC0) | d.chance(0.25) << 8 | d.chance(0.1) << 4 | d.chance(0.15) << 12
        mode |= d.chance(0.08) << 9 | d.of(0, 0, 0x4000, 0x8000, 0xC000)
        self.load("IPM", mode, 0)
        if mode & 0x1000:
            self.load("TX", d.size(1, 300), 0)
        self.command(d.of("DECEN", "DECEN", "DECDIS"), 0)
        for _ in range(d.of(1, 2, 3, 4, 10)):
            self.segment()
            if d.chance(0.4):
                self.advance(1, 4000)
                self.look()
            if d.chance(0.15):
                self.command("TX" if d.chance(0.5) else "R-TX", 0)
                self.read_back()
            if mode & 0x200 or d.chance(0.1):
                for _ in range(d.between(1, 12)):
                    self.command("CLRSTEP", 0)
                    self.advance(1, 300)
        for _ in range(d.between(1, 4)):
            self.advance(100, 60_000)
            if d.chance(0.5):
                self.axes = d.of(1, 2, mask)
                d.of(self.happening, self.stop, self.segment, self.read_back, lambda: self.command("MFPC", 0),
                     lambda: self.load("DV", d.size(1000, 8_000_000)), lambda: self.command("CLRSTEP", 0),
                     lambda: self.touch(d.of("lmt_plus", "stop0", "alarm", "lmt_minus"), 1, 3000))  # fmt: skip
            self.look()
        self.advance(1000, 400_000)

    def interpolation312(self):
        d = self.d
        self.axes = 3
        self.word(1, d.of(0, 2))
        self.word(2, d.of(0, 3, 4, 0x2000))
        self.word(3, d.of(0, 0, 4, 2, 1))
        self.speeds()
        if d.chance(0.3):
            self.counters()
        mode = d.of(4, 4, 1, 0x104, 0x101, d.bits(0.2)) | d.of(0, 0, 0, 0x1000, 0x800) | d.of(0, 0x4000, 0x8000)
        self.write(5, mode)
        self.command(d.of("IP_DEC_VALID", "IP_DEC_INVALID"), 0)
        for _ in range(d.between(1, 4)):
            if d.chance(0.4):
                self.command("BP_ENABLED", 0)
                for _ in range(d.between(1, 4)):
                    for n in (2, 3, 4, 5):
                        self.write(n, d.bits(0.4))
                    self.command("BP_STACK", 0)
                if d.chance(0.1):
                    self.command("BP_CLR", 0)
                self.command("BP_DISABLED", 0)
                self.command("IP_2BP", 0)
                self.look()
                if d.chance(0.6):
                    self.advance(1, 20_000)
                    self.command("BP_ENABLED", 0)
                    self.write(2, d.bits(0.5))
                    self.command("BP_STACK", 0)
                    self.command(d.of("BP_DISABLED", "BP_CLR", "BP_STACK"), 0)
                    self.command("BP_DISABLED", 0)
            else:
                far = d.of(6, 30, 200)
                r = d.between(1, far)
                centre = d.of((-r, 0), (0, r), (d.between(-far, far), d.between(-far, far)))
                finish = d.of((0, 0), (d.between(-far, far), d.between(-far, far)), (centre[0], centre[1] + r))
                for k, bit in enumerate((1, 2)):
                    self.load("C", centre[k], bit)
                    self.load("P", finish[k], bit)
                self.command(d.of("IP_2ST", "IP_CW", "IP_CCW"), 0)
            for _ in range(d.between(1, 12) if mode & 0x1000 else 0):
                self.command("IP_1STEP", 0)
                self.advance(1, 400)
            self.look()
            self.advance(100, 200_000)
            if d.chance(0.4):
                self.axes = d.of(1, 2, 3)
                d.of(self.happening, self.stop, self.look, self.read_back, lambda: self.command("IP_INTRPT_CLR", 0),
                     lambda: self.load("V", d.size(10, 8000)),
                     lambda: self.touch(d.of("lmt_plus", "stop0", "alarm", "lmt_minus"), 1, 3000))  # fmt: skip
                self.axes = 3
            self.look()
        self.advance(1000, 800_000)


def stories_of(chip):
    """Which stories a chip has, and how often."""
    common = {"drive": 4, "long": 3, "home": 5, "chaos": 4, "filter": 2, "rings": 2}
    if chip is MCX514:
        return common | {"ports": 1, "sync": 7, "split": 2, "timer": 1, "interpolation": 8}
    return common | ({"interpolation": 6} if chip is MCX312 else {})


def program(chip, story, draw):
    return Stories(chip, draw).program(story)
