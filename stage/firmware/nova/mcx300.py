"""`Driver`: an axis of an MCX304, MCX302 or MCX312 as its driver's author sees it. Nothing here but bus cycles and waiting.

    driver = Driver(axis)                    the axis of a Stage or a Bench
    driver.load(R=800_000, K=20_000, A=8000, SV=100, V=1000, AO=0)
    driver.mode(WR3=S_CURVE)
    driver.start(12_000)
    driver.wait_until_stopped(timeout=5)

See nova_erratum.py for the work-arounds of the S-curve failure; nova_home.py and nova_draw.py for home search and interpolation of
an MCX514.
"""

from __future__ import annotations

from collections.abc import Callable

from stage.chips import MCX302, MCX304, MCX312
from stage.chips.nova.registers.mcx300 import MCX304_MAP as MAP
from stage.errors import ArgumentError, RunTimeout
from stage.firmware.axis import Axis

PLUS, MINUS, DECELERATING_STOP, SUDDEN_STOP = (
    MAP.command(name).code for name in ("F_DRV_P", "F_DRV_M", "STOP_DEC", "STOP_SUDDEN")
)
NOP = MAP.command("NOP").code
ASND, CNST, DSND = (MAP.mask("RR1", name) for name in ("ASND", "CNST", "DSND"))
PHASES = ASND | CNST | DSND
STOPPED_BY_LIMIT = MAP.mask("RR1", "LMT+") | MAP.mask("RR1", "LMT-")
STOPPED_BY_STOP = sum(MAP.mask("RR1", f"STOP{k}") for k in range(3))
C_END_ENABLE, C_END = MAP.mask("WR1", "C-END"), MAP.mask("RR3", "C-END")
STOP_ENABLES = tuple(MAP.mask("WR1", f"SP{k}-E") for k in range(3))
SOFT_LIMITS = MAP.mask("WR2", "SLMT+") | MAP.mask("WR2", "SLMT-")
LIMITS_DECELERATE, ALARM_ENABLE = MAP.mask("WR2", "LMTMD"), MAP.mask("WR2", "ALM-E")
S_CURVE = MAP.mask("WR3", "SACC")

POLL = 1e-3  # s between two looks at a drive in progress


class Driver:
    """The bus of one axis. Raises ArgumentError when the axis' chip is none of the family."""

    def __init__(self, axis: Axis):
        if not isinstance(getattr(axis, "chip", None), (MCX304, MCX302, MCX312)):
            raise ArgumentError(f"{axis!r} has no MCX304, MCX302 or MCX312, and this driver speaks to no other chip.")
        self.axis, self._chip = axis, axis.chip
        self._select = 1 << axis.chip_axis << 8
        self._modes = {"WR1": 0, "WR2": 0, "WR3": 0}  # they cannot be read

    def command(self, code: int) -> None:
        """Write WR0 with the axis' bit."""
        self._chip.write(0, self._select | code)

    def load(self, **parameters: int) -> None:
        """Write parameters by name: R, K, A, D, SV, V, P, LP, CP, ... Raises ArgumentError, before the first bus cycle."""
        map_ = self._chip.MAP
        for name, value in [(name, map_.checked(name, value)) for name, value in parameters.items()]:
            for cycle in self._chip.register_cycles(name, value, self.axis.chip_axis):
                self._chip.write(*cycle)

    def mode(self, **words: int) -> None:
        """Write mode words by name: WR1, WR2, WR3."""
        for name, value in words.items():
            if name not in self._modes:
                raise ArgumentError(f"{name} is no mode word of an axis: WR1, WR2, WR3 are.")
            self._modes[name] = value
            self.command(NOP)
            self._chip.write(int(name[2]), value)

    def enable(self, name: str, bits: int, on: bool = True) -> None:
        """Set (or clear) bits of a mode word and leave its others."""
        self.mode(**{name: self._modes[name] | bits if on else self._modes[name] & ~bits})

    def word(self, n: int) -> int:
        """RR1, RR2 or RR3 of the axis. Reading RR3 clears it."""
        self.command(NOP)
        return self._chip.read(n)

    def _data(self, symbol: str) -> int:
        self.command(self._chip.MAP.command(symbol).code)
        return self._chip.read(6) | self._chip.read(7) << 16

    def position(self) -> int:
        """LP, pulses."""
        value = self._data("R-LP")
        return value - (value >> 31 << 32)

    def speed(self) -> int:
        """CV, in the unit of SV and V."""
        return self._data("CV")

    def driving(self) -> bool:
        """n-DRV."""
        return self._chip.busy(self.axis.chip_axis)

    def start(self, pulses: int) -> None:
        """Start a drive of so many pulses; the sign is the direction. Raises ArgumentError for 0."""
        if pulses == 0:
            raise ArgumentError("pulses=0: a drive has at least one; its sign is the direction.")
        self.load(P=abs(pulses))
        self.command(PLUS if pulses > 0 else MINUS)

    def wait_until_stopped(self, timeout: float, routine: Callable[[], bool] | None = None, poll: float = POLL) -> bool:
        """Wait for n-DRV = 0, seconds `timeout` at most.

        routine: called before each look, every `poll` seconds, as a timer or an interrupt would; see nova_erratum.py.
        Returns whether a call of it said True: it had to stop the drive. Raises RunTimeout.
        """
        until, stopped = self.axis.time + timeout, False
        while True:
            stopped |= bool(routine and routine())
            if not self.driving():
                return stopped
            if self.axis.time >= until:
                raise RunTimeout(f"axis {self.axis.name} still drives after {timeout} s: RR1 = {self.word(1):04X}h.")
            self.axis.wait(poll)
