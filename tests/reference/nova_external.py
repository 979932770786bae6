"""Drives by EXP+ and EXP- of a NOVA chip at one speed, edge by edge, from what the manuals of the chips say of them.

    drive = External(mode="fixed", pulses=3, period=100, delay=0)
    drive.edge(1000, "exp_plus", True)      the pin is asserted, that is low
    drive.pulses(until=5000)                [(1100, +1), (1200, +1), (1300, +1)]

Modes: off, continuous, fixed, pulser. A drive of one speed stops at once where it is told to decelerate. A pin that is asserted, or
released, for `delay` clocks is seen so; what is shorter is not seen. Nothing here comes from stage.chips.
"""

PLUS, MINUS = "exp_plus", "exp_minus"


class External:
    def __init__(self, mode, pulses, period, delay):
        self.mode, self.count, self.period, self.delay = mode, pulses, period, delay
        self.pins = {PLUS: False, MINUS: False}
        self.seen = dict(self.pins)
        self.due = {}  # pin: the clock at which its level is seen
        self.made = []
        self.way = 0  # of the drive in progress; 0: none
        self.begin, self.left, self.holder = 0, 0, None  # left: None goes on; holder: the pin that keeps it on

    def edge(self, clock, pin, asserted):
        self._run(clock)
        if self.pins[pin] == asserted:
            return
        self.pins[pin] = asserted
        if asserted == self.seen[pin]:
            self.due.pop(pin, None)  # it was too short
        elif self.delay:
            self.due[pin] = clock + self.delay
        else:
            self._see(clock, [pin])

    def pulses(self, until):
        self._run(until)
        return self.made

    def _run(self, clock):
        while self.due and min(self.due.values()) <= clock:
            at = min(self.due.values())
            pins = [pin for pin in (PLUS, MINUS) if self.due.get(pin) == at]
            for pin in pins:
                del self.due[pin]
            self._drive(at)
            self._see(at, pins)
        self._drive(clock)

    def _drive(self, clock):
        """Make the pulses up to this clock."""
        while self.way and self.begin + self.period <= clock:
            self.begin += self.period
            self.made.append((self.begin, self.way))
            if self.left is not None:
                self.left -= 1
                if self.left == 0:
                    self.way = 0

    def _see(self, clock, pins):
        before = dict(self.seen)
        for pin in pins:
            self.seen[pin] = self.pins[pin]
        if self.holder in pins and not self.seen[self.holder]:
            self.way, self.holder = 0, None
        if self.mode == "pulser":
            if PLUS in pins and self.seen[MINUS]:
                self._start(clock, +1 if before[PLUS] else -1, None)
        elif self.mode != "off":
            fallen = [pin for pin in pins if self.seen[pin]]
            if fallen:
                self._start(clock, +1 if fallen[0] == PLUS else -1, fallen[0])

    def _start(self, clock, way, pin):
        if self.way:
            return
        self.way, self.begin = way, clock
        endless = self.mode == "continuous"
        self.left, self.holder = (None, pin) if endless else (self.count, None)
        if self.left == 0:
            self.way = 0
