"""What a host knows of an HCTL-1100 from its own bus writes alone, what it may expect of the chip, and programs for it as
strategies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from hypothesis import strategies as st

from support import hctl1100_programs as traffic

Writes = traffic.Writes
F0, F1, F3, F5 = 0x01, 0x02, 0x08, 0x20
MAX_SAMPLE_CLOCKS = 16 * 256  # clocks
LIMIT, STOP, INIT, PROFILE = 0x80, 0x40, 0x20, 0x10  # of R07


@dataclass(frozen=True)
class HctlHost:
    """Flags by what was set and cleared; F0 may since have been cleared by the chip. `drove`: it may have written a motor port,
    which then holds that value, into a control mode too, up to the first sample."""

    BLINKING: ClassVar = ("limit", "stop", "sync") * 2
    ADDRESSES: ClassVar = range(64)
    QUIET: ClassVar = tuple(k for k in range(64) if k != 0x14)  # reading the low byte of the position latches
    PULSE_PINS: ClassVar = ("pulse", "sign")
    MAKES_PULSES: ClassVar = False
    FOR_A_STAGE: ClassVar = ("drive_integral",)

    flags: int = 0
    drove: bool = False

    def written(self, address: int, value: int) -> HctlHost:
        """After a bus write."""
        if address % 64 in (0x08, 0x09):
            return replace(self, drove=True)
        if address % 64 == 0x05 and value in (0, 1):  # to Init/Idle, which clears both ports
            return replace(self, drove=False)
        bit = 1 << (value & 7)
        if address % 64 or bit == F1 or bit > F5:
            return self
        return replace(self, flags=self.flags | bit if value & 8 else self.flags & ~bit)

    def reset(self) -> HctlHost:
        """After the RESET pin."""
        return HctlHost()

    def advanced(self, inputs: list[dict[str, bool]]) -> HctlHost:
        """Time alone tells it nothing."""
        return self

    @staticmethod
    def put(chip, address: int, value: int) -> None:
        """One bus write cycle."""
        chip.write(address, value)

    def refuses(self, chip) -> bool:
        """While LIMIT is asserted there is no control mode; drives as such there are none."""
        return chip.pins.limit

    def check(self, chip) -> None:
        """Assert what holds at any moment."""
        v, pins = chip.values(), chip.pins.as_dict()
        assert pins["prof"] == bool(v["R00"] & F0) == bool(v["R07"] & PROFILE)
        assert pins["init"] == bool(v["R00"] & F1) == bool(v["R07"] & INIT)
        assert v["R00"] & ~F0 & ~F1 == self.flags & ~F0, "flags are those that were set"
        assert v["R00"] & F0 <= self.flags & F0, "F0 is never set by itself"
        assert not v["R07"] & 0x08
        assert not (pins["limit"] and v["R07"] & LIMIT), "an asserted LIMIT has triggered"
        assert not (pins["stop"] and v["R07"] & STOP), "an asserted STOP has triggered"
        assert v["R07"] & LIMIT or pins["init"], "LIMIT ends every mode"
        assert pins["sign"] == bool(v["R09"] & 0x80)
        assert not pins["pulse"] or v["R09"]
        if not pins["init"] and not self.drove:
            assert v["R08"] == chip.motor_command + 0x80
            assert v["R09"] == chip.motor_command & 0xFF
        count, rate = chip.shaft
        assert rate or chip.encoder == math.floor(count - chip.missed_counts), (
            "a shaft that stands is where it was seen"
        )

    def observe(self, chip) -> dict:
        """Return what `check_interval` needs of the moment before time passes."""
        return {"values": chip.values(), "command": chip.command_position, "motor": chip.motor_command}

    def check_interval(self, before, chip) -> None:
        """Assert what holds after a time in which the pins stayed as they were."""
        was, now = before.observation["values"], chip.values()
        assert before.pulses == 0
        excluded = {"R00", "R07", "R08", "R09", "R0C", "R0D", "R0E", "R0F", "R34", "R35", "R3C"}
        if chip.shaft[1]:
            excluded.add("R14")
        assert {k: v for k, v in now.items() if k not in excluded} == {
            k: v for k, v in was.items() if k not in excluded
        }
        assert now["R00"] == was["R00"] or now["R00"] == was["R00"] & ~F0, "time clears F0 and nothing else"
        assert now["R07"] & ~PROFILE == was["R07"] & ~PROFILE
        if was["R00"] & F1:
            assert (chip.command_position, chip.motor_command, now["R00"]) == (
                before.observation["command"],
                before.observation["motor"],
                was["R00"],
            )
        if not was["R00"] & (F0 | F5) or was["R00"] & (F0 | F3) == F3:
            assert chip.command_position == before.observation["command"], "only a profile moves the command position"
        if was["R00"] & F0:
            self._check_trapezoid(was, now, before.observation["command"], chip.command_position)
        assert 0 <= now["R0F"] <= 255
        if before.clocks >= MAX_SAMPLE_CLOCKS and not was["R00"] & F1:
            assert now["R08"] == chip.motor_command + 0x80
            assert now["R09"] == chip.motor_command & 0xFF, "from its first sample on a mode drives both ports"

    @staticmethod
    def _check_trapezoid(was, now, start, end) -> None:
        final = was["R2B"] << 16 | was["R2A"] << 8 | was["R29"]
        final -= (final & 1 << 23) << 1
        if now["R00"] & F0:
            assert min(start, final) <= end <= max(start, final), "a profile goes to its final position and not beyond"
        elif not was["R00"] & F5 or was["R00"] & F3:
            assert end == final, "F0 falls at the final position"


def host(cls) -> HctlHost:
    """The host's view of a chip at power-up."""
    return HctlHost()


def starts(cls) -> st.SearchStrategy[Writes]:
    """A control mode with its data."""
    return traffic.starts(cls)


def programs(cls) -> st.SearchStrategy[Writes]:
    """Anything."""
    return traffic.programs(cls)


def clocks() -> st.SearchStrategy[int]:
    """Nothing, single clocks, short, long."""
    return st.one_of(st.integers(0, 40), st.integers(0, 5000), st.integers(0, 200_000), st.just(4_000_000))


def cruise(cls, axis: int, plus: bool) -> Writes:
    """Return the writes of integral velocity from the present position, one count a sample: 1923 counts/s after reset."""
    at_position = [*traffic.word(traffic.COMMAND, 0), (0x13, 0)]
    return [*at_position, *traffic.acceleration(16), *traffic.begin("integral"), (0x3C, 1 if plus else 0xFF)]
