"""A stage that is driven by G-code over the serial line of firmware that makes its own steps."""

from __future__ import annotations

from pathlib import Path

from stage import Stage
from stage.board import Board
from stage.targets import TargetHost

STEPS_PER_MM = 320
STEP_M = 1e-3 / STEPS_PER_MM


class GcodeMachine:
    """A stage with a G-code firmware on an emulated ATmega328P, as a G-code sender sees it.

    Args:
        firmware: The ELF.
        greeting: End of what the firmware sends at power-up.
        pins: Its pins, as `--pins`.
        drives: Power stage.
        positions: Where the carriages are at power-up, m, by axis.
    """

    def __init__(self, firmware: Path, greeting: str, pins: str = "grbl", drives: str = "drv8825", **positions: float):
        self.stage = Stage("xyz", chips="stepdir", drives=drives, visuals=False)
        self.stage.place(**positions)
        self.axes = self.stage.axes
        self.host = TargetHost(firmware, Board(self.stage), mcu="atmega328p", pins=pins, isolated=False)
        self.start = self.count_steps()
        self.host.serial.read_until(greeting, timeout=10)

    def count_steps(self) -> list[int]:
        """Return the microsteps that each axis has taken, plus less minus, from the middle of its travel."""
        return [round(axis.commanded / STEP_M) for axis in self.axes.values()]

    def count_steps_since_start(self) -> list[int]:
        return [now - start for now, start in zip(self.count_steps(), self.start, strict=True)]

    def send(self, *lines: str, timeout: float = 60.0) -> list[str]:
        """Send lines, each after the answer to the one before; return the last words of the answers."""
        answers = []
        for line in lines:
            self.host.serial.write(f"{line}\n")
            answers.append(self.host.serial.expect(r"(ok|error:\d+|ALARM:\d+)\r\n", timeout)[1])
        return answers

    def wait_for_alarm(self) -> str:
        return self.host.serial.expect(r"ALARM:\d+")[0]

    def move(self, *lines: str) -> None:
        """Send lines that the firmware accepts, and wait until it rests."""
        assert self.send(*lines, "G4 P0.05") == ["ok"] * (len(lines) + 1)

    def report(self) -> str:
        """Return the status report."""
        self.host.serial.write("?")
        return self.host.serial.expect(r"<[^>]*>")[0]

    def read_positions(self) -> list[float]:
        """Return the positions of the status report, mm."""
        return [float(number) for number in self.report().partition("MPos:")[2].partition("|")[0].split(",")]

    def count_lost_steps(self) -> list[int]:
        return [axis.lost_steps for axis in self.axes.values()]

    def list_diagnostics(self) -> list[str]:
        return [diagnostic.message for axis in self.axes.values() for diagnostic in axis.chip.diagnostics]
