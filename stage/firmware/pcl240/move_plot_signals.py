"""Operation pattern of the PCL-240 family: the signals and commands that the plot of a move shows, as in the data sheet."""

from __future__ import annotations

import numpy as np

from stage.chips.pcl240.cycle_descriptions import name_speed
from stage.chips.pcl240.maps import CONTROL, OPERATE, OUTPUT
from stage.chips.pcl240.state import FL, GROUP, INT_AT_STOP, OUTPUT_BITS, RAMP, SPEED, START, STOP
from stage.firmware import move_plot_signals
from stage.firmware.move_plot_signals import AMBER, BLUE, GREEN, GREY, RED, VIOLET, PatternAnnotation

PATTERN_LANES = (
    ("fup", "FUP", BLUE),
    ("fkeep", "FKEEP", BLUE),
    ("fdown", "FDOWN", BLUE),
    ("hold", "HOLD", GREY),
    ("pdir", "PDIR \N{MINUS SIGN}", VIOLET),
    ("sd_plus", "SD+", AMBER),
    ("sd_minus", "SD-", AMBER),
    ("org", "ORG", GREEN),
    ("el_plus", "EL+", RED),
    ("el_minus", "EL-", RED),
    ("extp", "EXTP", VIOLET),
    ("irq", "INT", RED),
)


class Pcl240Pattern(move_plot_signals.OperationPattern):
    """Signals and commands of a report about a PCL-240."""

    LANES = PATTERN_LANES
    ALWAYS = ("fup", "fkeep", "fdown", "hold")

    def is_relevant(self, pin: str) -> bool:
        if pin == "pdir":
            return len(set(self.find_minus_edges()[self.waveforms.running].tolist())) > 1
        return pin in self.ALWAYS or bool(self.waveforms.pin(pin).any())

    def find_minus_edges(self) -> np.ndarray:
        """Return a mask of the edges after which the axis moves in the minus direction."""
        return self.waveforms.pin("pdir")

    def list_named_rates(self) -> dict[str, float]:
        """Return FL, FH1 and FH2 in pps, if a command selects them and their register was written only once."""
        values: dict[str, set[int]] = {}
        used = set()
        for s in self.report.statements:
            if s.kind == "register":
                values.setdefault(s.register, set()).add(s.value)
            elif s.kind == "command" and (byte := int(s.code, 16)) & START and byte & GROUP == OPERATE:
                used.add(name_speed(byte))
                used |= {"FL"} if byte & RAMP else set()
        step = self.waveforms.clock_hz / (8192.0 * max(next(iter(values.get("R7", {1}))), 1))
        names = {"FL": "R1", "FH1": "R2", "FH2": "R3"}
        once = {n: values[r] for n, r in names.items() if n in used and len(values.get(r, ())) == 1}
        return {n: next(iter(v)) * step for n, v in once.items()}

    def make_annotations(self, times: np.ndarray) -> list[PatternAnnotation]:
        """Return annotations for the commands that start, change or stop a run, for each ramp-down point, and for the end.

        The note of a command also has the bytes that prepare it (reset command, control mode, a register).

        Args:
            times: Times of the edges of the report's waveform, s from the first start.
        """
        report, waveforms = self.report, self.waveforms
        hold, clocks = waveforms.pin("hold"), waveforms.edges["clock"]
        notes: list[PatternAnnotation] = []
        ahead: list[str] = []
        for (when, code, _), s in zip(report.writes(), report.statements, strict=True):
            halted = bool(hold[max(int(np.searchsorted(clocks, s.clock)) - 1, 0)])
            if s.kind == "register":
                if not halted:
                    ahead.append(f"{s.register} \N{LEFTWARDS ARROW} {s.value}")
                continue
            if s.kind == "lost":
                notes.append(PatternAnnotation(when, f"{code}h", "lost on the bus", False))
                continue
            byte = int(code, 16)
            words = _describe_mode_command(byte, halted)
            if (
                byte & (START | STOP | RAMP | SPEED) == START | RAMP | FL
                and not halted
                and not waveforms.pin("fdown")[np.searchsorted(clocks, s.clock, "right") - 1]
            ):
                words = "ramps on"
            if words:
                notes.append(PatternAnnotation(when, " ".join([*ahead, f"{code}h"]), words, False))
            if words or s.kind == "reset" or byte == STOP:
                ahead.clear()
            group = byte & GROUP
            if not words and (byte == STOP or group == CONTROL or (group == OUTPUT and byte & OUTPUT_BITS)):
                ahead = [a for a in ahead if a[0] != code[0]] + [f"{code}h"]  # the latest of a group counts
        falls = waveforms.pin("fdown") & waveforms.pin("lt") & ~hold
        for k in np.flatnonzero(falls[1:] & ~waveforms.pin("lt")[:-1]) + 1:
            notes.append(
                PatternAnnotation(float(times[k]), "", f"R0 < R6 = {waveforms.edges['counter'][k] + 1:,d}", True)
            )
        return sorted([*notes, *self.make_end_annotations()], key=lambda n: n.time)

    def make_end_annotations(self) -> list[PatternAnnotation]:
        return [n._replace(words="stop at FL") if n.words == "stop" else n for n in super().make_end_annotations()]


def _describe_mode_command(byte: int, halted: bool) -> str:
    """Describe the immediate effect of an operating-mode command in a few words."""
    if byte & GROUP != OPERATE:
        return ""
    irq = ", /INT at stop" if byte & INT_AT_STOP else ""
    start, stop = byte & START, byte & STOP
    if stop and not start:
        return "" if halted else "reset command"
    if stop:
        return ("decelerating stop" if byte & RAMP else "stop") + irq
    if not start:
        return ""
    speed = name_speed(byte)
    if halted:
        return (f"start, ramp to {speed}" if byte & RAMP and speed != "FL" else f"start, constant {speed}") + irq
    return (f"ramp to {speed}" if byte & RAMP else f"at once {speed}") + irq
