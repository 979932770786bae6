"""What a host knows of a STEP/DIR axis from its own bus writes, what it may expect of it, and programs for it as strategies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from hypothesis import strategies as st

from stage.chips.stepdir import STEPDIR

Writes = list[tuple[int, int]]
NUMBERS = {r.name: r.number for r in STEPDIR.MAP.registers}
WRITTEN = {name: number for name, number in NUMBERS.items() if name != "POSITION"}
STARTS = [c.code for c in STEPDIR.MAP.commands if c.starts]
STOPS = [0x20, 0x10]


@dataclass(frozen=True)
class StepDirHost:
    """Registers by what was written to them."""

    BLINKING: ClassVar = ("el_plus", "el_minus", "org", "enable")
    ADDRESSES: ClassVar = range(16)
    QUIET: ClassVar = tuple(range(16))
    PULSE_PINS: ClassVar = ()
    MAKES_PULSES: ClassVar = True
    FOR_A_STAGE: ClassVar = ()

    registers: tuple[tuple[str, int], ...] = tuple((name, 2_000 if name == "HIGH" else 0) for name in WRITTEN)

    def written(self, address: int, value: int) -> StepDirHost:
        """Return the host after a bus write."""
        registers = dict(self.registers)
        name = next((name for name, number in WRITTEN.items() if number == address % 16), None)
        if name is None:
            return self
        return replace(self, registers=tuple((registers | {name: value & 0xFFFF_FFFF}).items()))

    def reset(self) -> StepDirHost:
        """Return the host after the reset pin."""
        return StepDirHost()

    def advanced(self, inputs: list[dict[str, bool]]) -> StepDirHost:
        """Return the host after a time, which tells it nothing."""
        return self

    @staticmethod
    def put(chip, address: int, value: int) -> None:
        """Make one bus write cycle."""
        chip.write(address, value)

    def refuses(self, chip) -> bool:
        """Return whether no drive can begin now: both end limits are asserted, or one of them and the drive is towards it."""
        return chip.pins.el_plus or chip.pins.el_minus or chip.pins.org

    def check(self, chip) -> None:
        """Check what holds at any moment."""
        values, pins = chip.values(), chip.pins.as_dict()
        status = chip.CORE.peek.with_gil(chip.pointer, 0)
        assert {name: values[name] for name in WRITTEN} == dict(self.registers)
        assert pins["busy"] == bool(status & 1)
        for bit, name in enumerate(("el_plus", "el_minus", "org", "probe"), 1):
            assert pins[name] == bool(status >> bit & 1)
        assert not (pins["up"] and pins["down"])
        assert pins["busy"] or not (pins["up"] or pins["down"])

    def observe(self, chip) -> dict:
        """Return what `check_interval` needs of the moment before time passes."""
        return {"values": chip.values(), "net": chip.net()}

    def check_interval(self, before, chip) -> None:
        """Check what holds after a time in which the pins stayed as they were."""
        position = chip.values()["POSITION"] - before.observation["values"]["POSITION"]
        assert position == chip.net() - before.observation["net"]
        assert abs(position) == before.pulses, "a move has one direction"


def host(cls) -> StepDirHost:
    """Return the host's view of an axis at power-up."""
    return StepDirHost()


def _draw_registers() -> st.SearchStrategy[Writes]:
    rate = st.one_of(st.integers(1, 200_000), st.sampled_from((1, 1000, 200_000)))
    values = {
        "START": st.one_of(st.just(0), rate), "RATE": rate, "UP": st.integers(0, 300_000), "DOWN": st.integers(0, 300_000),
        "CURVED": st.integers(0, 50), "STEPS": st.integers(0, 3000), "EVENTS": st.integers(0, 5000),
        "HIGH": st.sampled_from((100, 2_000, 50_000)),
    }  # fmt: skip
    writes = st.one_of(*(v.map(lambda value, name=name: (NUMBERS[name], value)) for name, v in values.items()))
    return st.lists(writes, max_size=8)


def starts(cls) -> st.SearchStrategy[Writes]:
    """Draw a whole move."""
    moves = st.tuples(
        st.integers(0, 5_000), st.integers(1, 100_000), st.integers(1, 3000), st.sampled_from(STARTS)
    )  # fmt: skip
    return moves.map(lambda m: [(NUMBERS["START"], m[0]), (NUMBERS["RATE"], m[1]), (NUMBERS["STEPS"], m[2]), (0, m[3])])


def programs(cls) -> st.SearchStrategy[Writes]:
    """Draw anything: legal registers, commands, and any word at any address."""
    words = st.tuples(st.integers(0, 31), st.integers(0, 0xFFFF_FFFF))
    commands = st.tuples(st.just(0), st.sampled_from(STARTS + STOPS))
    return st.one_of(_draw_registers(), st.lists(commands, max_size=2), st.lists(words, max_size=3))


def clocks() -> st.SearchStrategy[int]:
    """Draw nothing, single clocks, pulses, ramps."""
    return st.one_of(st.integers(0, 40), st.integers(0, 5_000), st.integers(0, 1_000_000), st.integers(0, 300_000_000))


def cruise(cls, axis: int, plus: bool) -> Writes:
    """Return a run at 2000 pps, which the motors of a stage follow."""
    return [(NUMBERS["START"], 2000), (NUMBERS["RATE"], 2000), (0, 0x05 if plus else 0x07)]
