"""More random programs for the NOVA chips: synchronous actions, comparisons, timers, split pulses, filters, interpolation."""

from recorded.nova_operations import NovaOperations

from stage.chips.nova import MCX312, MCX501, MCX514


class NovaPrograms(NovaOperations):
    """Draws programs of the MCX514, MCX304, MCX302 or MCX312, story by story."""

    # --- MCX514 ---

    def draw_ports(self):
        """Draw functions of the PIO pins (inputs, outputs, status, comparisons) and general outputs."""
        d = self.d
        self.load("P1M", d.choice(0, 0x5555, 0xAAAA, 0xFFFF, d.bits(0.5)))
        self.write(4, d.bits(0.5))
        self.write(5, d.bits(0.5))
        self.set_comparisons()
        self.load_speeds()
        self.load_pulses()
        self.start()
        for _ in range(d.between(2, 5)):
            self.let_run(10, 20_000)
            self.set_pin(self.name_port(d.between(0, 7)), d.chance(0.5))
            self.add_reads()
            self.write_command(d.choice("RR3P1", "RR3P0"))
            self.add_reads()

    def name_port(self, k):
        return f"pio{k}" if self.is_mcx514 else ("exp_plus", "exp_minus")[k & 1]

    def set_comparisons(self):
        """Set comparisons of all kinds, near the values at which they become true."""
        d = self.d
        self.load("MRM", d.choice(d.bits(0.5), 0, 0x8888, 0x2222, 0x3B3B))
        self.load_counters()
        for m in range(4):
            self.load(f"MR{m}", d.choice(d.between(-40, 40), d.between(-40, 40), d.size(1, 500), d.size(1000, 400_000)))

    def start_timer(self):
        self.load("TM", self.d.choice(1, self.d.size(1, 400), self.d.size(1, 40)))
        self.write_command("TMSTA")

    def start_split_pulses(self):
        d = self.d
        width = d.choice(d.between(1, 6), d.between(1, 3))
        self.load("SP1", width << 16 | d.choice(width + d.between(0, 9), 2, width, d.between(2, 30)))
        self.load("SP2", d.choice(0, d.between(1, 9), 1))
        if d.chance(0.7):
            self.write_command("SPSTA")

    def draw_sync(self):
        d = self.d
        self.load("P1M", d.choice(0, 0, 0x5555, 0xFF00, d.bits(0.3)))
        self.write_word(1, d.choice(0xFFFF, d.bits(0.4)))
        self.write_word(2, d.choice(0, 0x0800, 0x2000))
        self.write_word(3, d.choice(0, 4, 0x4000, 2))
        self.load_speeds()
        self.set_comparisons()
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
                    d.between(0, 15) | d.choice(5, 9, 19, 21, 23) << 4 | d.choice(0x200, 0x600, 0x1200) | 0x8000,
                    self.all_axes,
                )
        self.write_command("SYNCEN", more=d.between(1, 15), axes=d.choice(self.axes, self.all_axes))
        for _ in range(d.between(3, 8)):
            d.choice(self.start_timer, self.start_split_pulses, self.start, self.start, self.load_pulses, self.stop,
                 self.turn_encoder, self.load_counters,
                 lambda: self.write_command(d.choice("SYNCACT", "SYNCACT", "SYNCDIS", "SYNCEN"), more=d.between(1, 15)),
            )  # fmt: skip
            if d.chance(0.6):
                self.set_pin(self.name_port(d.between(0, 7)), d.chance(0.6))
            self.let_run(1, 20_000)
            self.add_reads()
            if d.chance(0.3):
                self.disturb()
        self.let_run(1000, 100_000)

    def draw_split(self):
        d = self.d
        self.load_speeds()
        self.write_word(1, 0x0C00)
        self.start_split_pulses()
        self.load_pulses()
        self.start()
        for _ in range(d.between(2, 5)):
            self.let_run(10, 30_000)
            d.choice(
                self.start_split_pulses,
                self.add_reads,
                self.start_timer,
                lambda: self.write_command(d.choice("SPSTA", "SPSTP", "TMSTP", "DCC")),
            )
            self.read_back()

    def draw_timer(self):
        d = self.d
        self.write_word(3, d.choice(0, 0x4000))
        self.write_word(1, 0x0200)
        self.load("MRM", d.choice(0x3333, 0x7777, 0xBBBB, 0xFFFF))
        for m in range(4):
            self.load(f"MR{m}", d.size(1, 300))
        self.start_timer()
        for _ in range(d.between(2, 6)):
            self.let_run(1, 8000)
            d.choice(
                self.add_reads,
                self.read_back,
                self.start_timer,
                lambda: self.write_command("TMSTP"),
                lambda: self.load("TM", d.size(1, 200)),
            )

    def draw_filter(self):
        """Draw input pulses that are shorter and longer than their filters."""
        d = self.d
        if self.is_mcx514:
            self.load("FLM", d.choice(0x00FF | d.bits(0.2), d.bits(0.5), 0x02FE, 0x11FF))
            self.write_word(2, d.choice(0x0800, 0x0A2A, 0x0880, d.bits(0.4)))
        else:
            self.write_word(3, d.choice(0x1F00, 0x3F00, d.bits(0.5)))
            self.write_word(1, d.choice(0x2A, 0x15, 0x3F, 0x7F, d.bits(0.3)))
            self.write_word(2, d.choice(0, 0x2000, 0x8000, 4, 0x0600, 0x0A00, d.bits(0.3)))
        self.load_speeds()
        self.load_pulses()
        self.start()
        for _ in range(d.between(4, 12)):
            name = d.choice(
                "lmt_plus",
                "lmt_minus",
                "stop0",
                "stop1",
                "stop2",
                "inpos",
                "alarm",
                "eca",
                "ecb",
                *(("pio0", "pio7") if self.is_mcx514 else ("exp_plus", "exp_minus")),
            )
            self.pulse_pin(name, 1, d.choice(8, 64, 1000, 20_000))
            self.let_run(1, d.choice(16, 2000, 9000))
            self.add_reads()
            if d.chance(0.3):
                self.start()
            if d.chance(0.2):
                self.turn_encoder()

    def draw_rings(self):
        """Draw ring counters, software limits, and counters that wrap."""
        d = self.d
        self.load_speeds(fast=True)
        if self.is_mcx514:
            self.write_word(2, d.choice(0x2000, 0xA000, 0x6000, 0xE000, 0))
            self.load("LX", d.choice(0xFFFFFFFF, d.between(1, 60)))
            self.load("RX", d.choice(0xFFFFFFFF, d.between(1, 60)))
            self.write_word(3, d.choice(0, 0x0100, 0x0200, 0x0300, 0x0800, d.bits(0.2)))
            if d.chance(0.5):
                self.load("MRM", d.bits(0.4))
        else:
            self.write_word(2, d.choice(1, 2, 3, 0x21, 0x23, 0x27, 0x0223, 0x0423, 0x0823, 0x0C23))
            self.write_word(1, d.choice(0x40, 0x80, 0xC0, 0x1F00))
        self.load_counters()
        for _ in range(d.between(2, 5)):
            self.load_pulses()
            self.start()
            self.let_run(100, 60_000)
            self.turn_encoder()
            self.add_reads()
            self.read_back()
        if not self.is_mcx514:
            self.pulse_pin("stop2", 1, 100)

    # --- interpolation ---

    def add_segment(self):
        """Add one segment of the MCX514."""
        d = self.d
        max_distance = d.choice(6, 30, 200)
        axes = [1 << j for j in range(4)]
        kind = d.choice("line", "line", "arc", "arc", "pattern", "helix")
        if kind == "line":
            for bit in axes:
                self.load("TP", d.between(-max_distance, max_distance), bit)
            self.write_command(d.choice("LHK2", "LHK2", "LHK3", "LHK4", "LHK1"), 0)
        elif kind == "pattern":
            for bit in axes:
                self.load("TP", d.bits(0.5) | d.bits(0.3) << 16, bit)
            self.write_command(d.choice("BHK2", "BHK3", "BHK4"), 0)
        else:
            r = d.between(1, max_distance)
            centre = d.choice(
                (-r, 0),
                (0, r),
                (d.between(-max_distance, max_distance), d.between(-max_distance, max_distance)),
                (0, 0),
            )
            opposite, quarter = (2 * centre[0], 2 * centre[1]), (centre[0], centre[1] + r)
            finish = d.choice(
                (0, 0),
                quarter,
                (d.between(-max_distance, max_distance), d.between(-max_distance, max_distance)),
                opposite,
            )
            for k, bit in enumerate(axes):
                self.load("CP", centre[k % 2], bit)
                self.load("TP", finish[k % 2] if k < 2 else d.between(-max_distance, max_distance), bit)
            if kind == "helix":
                self.load("HLN", d.choice(0, 1, 2), 0)
                if d.chance(0.7):
                    self.write_command(d.choice("HLPCW", "HLPCCW"), 0)
                else:
                    self.load("HLV", d.size(1, 400), 0)
                self.write_command(d.choice("HLCW", "HLCCW"), 0)
            else:
                self.write_command(d.choice("CHKCW", "CHKCCW"), 0)

    def draw_interpolation(self):
        d = self.d
        if self.chip is MCX312:
            self.draw_interpolation_of_mcx312()
            return
        self.axes = 15
        self.write_word(1, 0)
        self.write_word(2, d.choice(0, 0x0800, 0x2000))
        self.write_word(3, d.choice(0, 0, 4, 2, 1))
        self.load_speeds(fast=d.chance(0.7))
        if d.chance(0.3):
            self.load_counters()
        mask = d.choice(3, 3, 7, 15, 5, 6, 9, 14, 1, 11)
        mode = mask | d.choice(0, 0x40, 0x80, 0xC0) | d.chance(0.25) << 8 | d.chance(0.1) << 4 | d.chance(0.15) << 12
        mode |= d.chance(0.08) << 9 | d.choice(0, 0, 0x4000, 0x8000, 0xC000)
        self.load("IPM", mode, 0)
        if mode & 0x1000:
            self.load("TX", d.size(1, 300), 0)
        self.write_command(d.choice("DECEN", "DECEN", "DECDIS"), 0)
        for _ in range(d.choice(1, 2, 3, 4, 10)):
            self.add_segment()
            if d.chance(0.4):
                self.let_run(1, 4000)
                self.add_reads()
            if d.chance(0.15):
                self.write_command("TX" if d.chance(0.5) else "R-TX", 0)
                self.read_back()
            if mode & 0x200 or d.chance(0.1):
                for _ in range(d.between(1, 12)):
                    self.write_command("CLRSTEP", 0)
                    self.let_run(1, 300)
        for _ in range(d.between(1, 4)):
            self.let_run(100, 60_000)
            if d.chance(0.5):
                self.axes = d.choice(1, 2, mask)
                d.choice(self.disturb, self.stop, self.add_segment, self.read_back, lambda: self.write_command("MFPC", 0),
                     lambda: self.load("DV", d.size(1000, 8_000_000)), lambda: self.write_command("CLRSTEP", 0),
                     lambda: self.pulse_pin(d.choice("lmt_plus", "stop0", "alarm", "lmt_minus"), 1, 3000))  # fmt: skip
            self.add_reads()
        self.let_run(1000, 400_000)

    def draw_interpolation_of_mcx312(self):
        d = self.d
        self.axes = 3
        self.write_word(1, d.choice(0, 2))
        self.write_word(2, d.choice(0, 3, 4, 0x2000))
        self.write_word(3, d.choice(0, 0, 4, 2, 1))
        self.load_speeds()
        if d.chance(0.3):
            self.load_counters()
        mode = (
            d.choice(4, 4, 1, 0x104, 0x101, d.bits(0.2))
            | d.choice(0, 0, 0, 0x1000, 0x800)
            | d.choice(0, 0x4000, 0x8000)
        )
        self.write(5, mode)
        self.write_command(d.choice("IP_DEC_VALID", "IP_DEC_INVALID"), 0)
        for _ in range(d.between(1, 4)):
            if d.chance(0.4):
                self.write_command("BP_ENABLED", 0)
                for _ in range(d.between(1, 4)):
                    for n in (2, 3, 4, 5):
                        self.write(n, d.bits(0.4))
                    self.write_command("BP_STACK", 0)
                if d.chance(0.1):
                    self.write_command("BP_CLR", 0)
                self.write_command("BP_DISABLED", 0)
                self.write_command("IP_2BP", 0)
                self.add_reads()
                if d.chance(0.6):
                    self.let_run(1, 20_000)
                    self.write_command("BP_ENABLED", 0)
                    self.write(2, d.bits(0.5))
                    self.write_command("BP_STACK", 0)
                    self.write_command(d.choice("BP_DISABLED", "BP_CLR", "BP_STACK"), 0)
                    self.write_command("BP_DISABLED", 0)
            else:
                max_distance = d.choice(6, 30, 200)
                r = d.between(1, max_distance)
                centre = d.choice(
                    (-r, 0), (0, r), (d.between(-max_distance, max_distance), d.between(-max_distance, max_distance))
                )
                finish = d.choice(
                    (0, 0),
                    (d.between(-max_distance, max_distance), d.between(-max_distance, max_distance)),
                    (centre[0], centre[1] + r),
                )
                for k, bit in enumerate((1, 2)):
                    self.load("C", centre[k], bit)
                    self.load("P", finish[k], bit)
                self.write_command(d.choice("IP_2ST", "IP_CW", "IP_CCW"), 0)
            for _ in range(d.between(1, 12) if mode & 0x1000 else 0):
                self.write_command("IP_1STEP", 0)
                self.let_run(1, 400)
            self.add_reads()
            self.let_run(100, 200_000)
            if d.chance(0.4):
                self.axes = d.choice(1, 2, 3)
                d.choice(self.disturb, self.stop, self.add_reads, self.read_back, lambda: self.write_command("IP_INTRPT_CLR", 0),
                     lambda: self.load("V", d.size(10, 8000)),
                     lambda: self.pulse_pin(d.choice("lmt_plus", "stop0", "alarm", "lmt_minus"), 1, 3000))  # fmt: skip
                self.axes = 3
            self.add_reads()
        self.let_run(1000, 800_000)


class KinPrograms(NovaPrograms):
    """Programs of the MCX514 or of the first generation, for a chip that is like it and lacks some of it."""

    def __init__(self, chip, draw):
        super().__init__(chip, draw)
        self.is_mcx514 = issubclass(chip, MCX514)
        self.known = {c.symbol for c in chip.MAP.commands}

    def write_command(self, symbol, axes=None, more=0):
        if not isinstance(symbol, str) or symbol in self.known:
            super().write_command(symbol, axes, more)

    def load(self, name, value, axes=None):
        if not isinstance(name, str) or name in self.known:
            super().load(name, value, axes)

    def set_pin(self, name, level, axis=None):
        if name in self.chip.INPUTS:
            super().set_pin(name, level, axis)

    def turn_encoder(self):
        self.axes = self.axes & self.all_axes or 1
        super().turn_encoder()

    def set_modes(self):
        super().set_modes()
        if not self.is_mcx514:
            self.load("EM", self.d.bits(0.3))

    def draw_home(self):
        if not self.is_mcx514:
            self.load("EM", self.d.choice(0x1500, self.d.bits(0.3), 0x5500, 0x0F00))
        super().draw_home()

    def draw_fed(self):
        """The shafts of encoders, and comparisons and limits at their counts."""
        d = self.d
        self.load_speeds()
        self.write_word(1, d.choice(0xFFFF, d.bits(0.4)))
        self.load_counters()
        if self.is_mcx514:
            self.write_word(2, d.choice(0, 0, 0x2000, 0x6000, d.bits(0.2)))
            self.load("MRM", d.choice(0x1111 * d.between(0, 15), 0x1111 * d.choice(1, 5, 9, 13), d.bits(0.4)))
        else:
            self.write_word(2, d.choice(0x23, 0x23, 3, 0x20, d.bits(0.3)))
        axes = [j for j in range(self.chip.AXES) if self.axes >> j & 1] or [0]
        for _ in range(d.between(4, 10)):
            rate = d.choice(0.0, 0.01, -0.02, 0.2, -0.0003, 0.25, -0.1)
            self.ops.append(("shaft", d.between(-60, 60) + d.choice(0.0, 0.5), rate, d.choice(*axes)))
            self.let_run(1, 3000)
            d.choice(
                self.start,
                self.start,
                self.load_pulses,
                self.load_counters,
                self.add_reads,
                self.stop,
                lambda: self.pulse_pin("stop2", 1, 90),
            )
            self.let_run(1, 5000)
            self.add_reads()
            self.read_back()

    def draw_interpolation(self):
        if self.is_mcx514:
            super().draw_interpolation()
        else:
            self.draw_interpolation_of_mcx312()


STORIES = {"drive": 4, "long": 3, "home": 5, "chaos": 4, "filter": 2, "rings": 2}
STORIES_OF_MCX514 = {"ports": 1, "sync": 7, "split": 2, "timer": 1, "interpolation": 8}
KIN_PROGRAMS = {"fed": 12, "interpolation": 14, "home": 9, "sync": 9, "drive": 9}
"""How many programs of each story the chips play that are like another; 4 of the others."""


def weigh_stories(chip):
    """Return the stories of a chip, and how often each is played."""
    if chip is MCX514:
        return STORIES | STORIES_OF_MCX514
    return STORIES | ({"interpolation": 6} if chip is MCX312 else {})


def list_kin_stories(chip):
    """Return the stories that a chip plays that is like another one."""
    more = ("ports", "sync", "split", "timer") if issubclass(chip, MCX514) else ()
    return (*STORIES, *more, *(("interpolation",) if chip is not MCX501 else ()), "fed")
