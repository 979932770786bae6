"""PCL-240K, one reference clock at a time, in the words of the normative model (its section numbers in brackets)."""

WIDTH = {0: 24, 1: 13, 2: 13, 3: 13, 4: 14, 5: 14, 6: 20, 7: 10}  # [4]
INPUTS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org", "ins", "extp")


class ReferencePCL240K:
    def __init__(self):
        self.clock = 0
        self.pin = dict.fromkeys(INPUTS, False)
        self.extp_before = False
        self.reset()

    def reset(self):
        """[5 fine points] Power-up and /RESET: everything 0 except armed = 1. The clock count goes on."""
        self.r = [0] * 8
        self.select = 0
        self.phase = self.speed = self.timer = 0
        self.running = self.finishing = self.pout_low = False
        self.armed = True
        self.ramps = self.stopping = False
        self.code = 0  # D1 D0 of the operating mode
        self.ramp = None  # None, "up", "down": the ramp of the last tick
        self.int_flag = self.int_pending = False
        self.org_enable = self.sd_enable = self.preset = self.minus = False
        self.independent = self.external = self.ots = False

    # [1], [2] bus

    def write(self, address, value):
        if address == 0:
            group, d = value >> 6, [bool(value >> k & 1) for k in range(8)]
            if group == 0:
                self.operate(d, value & 3)
            elif group == 1:
                self.org_enable, self.sd_enable, self.preset, self.minus = d[0], d[1], d[2], d[3]
            elif group == 2:
                self.select = value & 7
            else:
                self.independent, self.external, self.ots = d[0], d[4], d[5]
            return
        word = self.r[self.select].to_bytes(3, "little")
        changed = bytearray(word)
        changed[address - 1] = value
        self.r[self.select] = int.from_bytes(changed, "little") % (1 << WIDTH[self.select])
        if self.select == 7:  # [5 fine points]
            self.phase = min(self.phase, max(self.m() - 1, 0))

    def operate(self, d, code):
        self.int_flag = d[5]
        if not d[5]:
            self.int_pending = False
        start, stop = d[4], d[3]
        if not start and stop:  # reset command
            if self.running:
                self.stop()
            self.armed = True
        elif start and not stop:
            if self.running:  # speed change; it cancels a pending decelerating stop
                self.ramps, self.code, self.stopping = d[2], code, False
            else:
                self.start(d[2], code)
        elif start and stop and self.running:  # decelerating stop
            if not d[2] and not self.ramps:
                self.stop()
            else:
                self.ramps = self.stopping = True
                if self.speed <= self.r[1]:
                    self.stop()

    def start(self, ramps, code):
        if not self.armed or self.finishing:
            return
        if self.preset and self.r[0] == 0:
            return
        if self.el() or (self.org_enable and self.pin["org"]):
            return
        self.ramps, self.code, self.stopping = ramps, code, False
        self.running = True
        self.phase, self.timer, self.ramp = 0, 0, None
        self.speed = self.r[1] if ramps else self.selected()

    def stop(self):
        self.running = self.armed = self.stopping = False
        if self.pout_low:
            self.finishing = True
        else:
            self.fell()

    def fell(self):
        """b6 falls."""
        self.finishing = False
        if self.int_flag:
            self.int_pending = True

    # [5] helpers

    def m(self):
        return 8192 * self.r[7]

    def selected(self):
        return {0: self.r[1], 1: self.r[2], 2: self.r[1], 3: self.r[3]}[self.code]

    def el(self):
        return self.pin["el_minus"] if self.minus else self.pin["el_plus"]

    def sd(self):
        return self.pin["sd_minus"] if self.minus else self.pin["sd_plus"]

    def goal(self):
        if self.stopping or self.code in (0, 2):
            return self.r[1]
        if self.sd_enable and self.sd():
            return self.r[1]
        if self.preset and self.r[0] < self.r[6]:
            return self.r[1]
        return self.selected()

    # [5] the tick

    def tick(self):
        """One reference clock; returns the direction of the pulse that begins in it, or 0."""
        self.clock += 1
        pulse = 0
        rising, self.extp_before = self.extp_before and not self.pin["extp"], self.pin["extp"]
        if rising and self.external:
            self.count()
        if self.running and (self.el() or (self.org_enable and self.pin["org"])):  # 1
            self.stop()
        if (self.running or self.finishing) and self.r[7] >= 2 and self.speed > 0:  # 2
            self.phase += self.speed
            if self.running and self.phase >= self.m():
                self.phase -= self.m()
                self.pout_low = True
                pulse = -1 if self.minus else 1
                if not self.external:
                    self.count()
            elif self.pout_low and 2 * self.phase >= self.m():
                self.pout_low = False
                if self.finishing:
                    self.fell()
        if self.running:  # 3
            self.change_speed()
        return pulse

    def count(self):
        self.r[0] = (self.r[0] - 1) % (1 << 24)
        if self.preset and self.r[0] == 0 and self.running:
            self.stop()

    def change_speed(self):
        if not self.ramps:
            self.speed = self.selected()
            self.ramp = None
            return
        goal = self.goal()
        if self.speed == goal:
            self.ramp = None
        else:
            way = "up" if self.speed < goal else "down"
            first = self.ramp != way
            if first:
                self.timer = 0
            self.ramp = way
            self.timer += 1
            rate = self.r[4] if way == "up" else self.r[5]
            if rate > 1:
                if way == "up" and self.timer >= rate:
                    self.speed, self.timer = self.speed + 1, 0
                elif way == "down" and (first or self.timer >= rate):
                    self.speed, self.timer = self.speed - 1, 0
        if self.stopping and self.speed <= self.r[1]:
            self.stop()

    # what can be seen

    def status(self):
        """[3]"""
        pins = self.outputs()
        bits = (
            not self.int_pending, not pins["hold"], pins["fkeep"], pins["lt"], pins["zero"],
            self.sd(), self.pin["org"], self.pin["ins"],
        )  # fmt: skip
        return sum(bool(b) << (7 - k) for k, b in enumerate(bits))

    def read(self, address):
        return self.status() if address == 0 else self.r[0] >> 8 * (address - 1) & 0xFF

    def outputs(self):
        ramping = self.running and self.ramps
        up, down = ramping and self.speed < self.goal(), ramping and self.speed > self.goal()
        pout, pdir = self.pout_low, self.minus
        if self.independent:
            pout, pdir = self.pout_low and not self.minus, self.pout_low and self.minus
        return {
            "ots": self.ots, "pout": pout, "pdir": pdir, "hold": not (self.running or self.finishing), "fdown": down,
            "fkeep": not up and not down, "fup": up, "lt": self.r[0] < self.r[6], "zero": self.r[0] == 0,
            "irq": self.int_pending,
        }  # fmt: skip

    def state(self):
        return {"status": self.status(), "counter": tuple(self.read(a) for a in (1, 2, 3)), **self.outputs()}
