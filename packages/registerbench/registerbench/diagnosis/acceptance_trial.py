"""Acceptance trial of a repaired set-up: a customer's requirements in numbers, and the observer that checks a run against them.

The program runs from power-up. The carriage must rest at the required positions, one after the other, in time and at the
required rate. A run fails if the carriage is slower, stops short of a position, loses steps or hits an end of its travel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from registerbench.diagnosis.host_program import SAMPLE_INTERVAL_S
from stage import Stage
from stage.errors import RunTimeout

POSITION_TOLERANCE_M = 60e-6  # a full step, and the distance that static friction can hold
MAX_Y_TRAVEL_M = 30e-6  # vibration of the axis that must stand still
MIN_REST_S = 0.1  # at each position
MAX_RATE_RATIO, MIN_RATE_RATIO = 1.05, 0.95  # peak rate of a leg / required rate
RATE_WINDOW_SAMPLES = 5  # a rate is measured over so many samples
RAMP_END_RATIO = 0.95  # a ramp ends at this share of the peak rate of its leg


class TrialSample(NamedTuple):
    """State of the stage at one time.

    Attributes:
        time: Simulated time, s.
        commanded: Commanded position of x, m.
        x_m: True position of x, m.
        lost_steps: Lost full steps of x.
        y_m: True position of y, m.
        busy: Whether x or y drives.
    """

    time: float
    commanded: float
    x_m: float
    lost_steps: float
    y_m: float
    busy: bool


@dataclass(frozen=True)
class AcceptanceTrial:
    """Requirements of a customer on a run of the program.

    Attributes:
        stops_m: Positions at which x must rest, one after the other, m.
        rate_pps: Required peak rate of each leg, pps.
        max_seconds: Time limit for the whole run, s.
        min_ramp_s: Shortest permitted duration of the first leg's ramp up, s.
        starts_m: Positions of x at power-up, a run for each, m.
        from_start: Whether `stops_m` are relative to the start of the run; else to the middle of the travel.
        tolerance_m: Permitted deviation from a position, m.
    """

    stops_m: tuple[float, ...]
    rate_pps: float
    max_seconds: float
    min_ramp_s: float = 0.0
    starts_m: tuple[float, ...] = (0.0,)
    from_start: bool = True
    tolerance_m: float = POSITION_TOLERANCE_M

    def __str__(self) -> str:
        places = ", ".join(f"{1e3 * s:g}" for s in self.stops_m)
        samples = "from where it begins" if self.from_start else "from the middle of its travel"
        ramp = f", with ramps up of {self.min_ramp_s:g} s or more on the way to the first" if self.min_ramp_s else ""
        return (
            f"x comes to {places} mm {samples}, and rests {MIN_REST_S:g} s at each; within {1e3 * self.tolerance_m:g} mm, "
            f"at {self.rate_pps:g} pulses a second{ramp}, all in {self.max_seconds:g} s from power-up; y stands still, and no step "
            "may be lost"
        )

    def explain_failure(self, samples: list[TrialSample], start: float, meters_per_pulse: float) -> str:
        """Explain why a run does not meet the requirements.

        Args:
            samples: Samples of the run.
            start: Position at which x began, m.
            meters_per_pulse: Travel of x for one pulse, m.

        Returns:
            The first failed requirement in words; "" if the run meets all.
        """
        rests = find_rests(samples)
        wanted = [s + start * self.from_start for s in self.stops_m]
        found = [samples[last].x_m for _, last in rests]
        if len(found) != len(wanted):
            return f"it rests at {len(found)} places, and {len(wanted)} are wanted"
        for place, goal in zip(found, wanted, strict=True):
            if abs(place - goal) > self.tolerance_m:
                return f"it rests at {1e3 * place:.3f} mm, and {1e3 * goal:g} mm is wanted"
        if any(round(abs(samples[last].lost_steps)) for _, last in rests):
            return "steps are lost"
        if max(abs(s.y_m) for s in samples) > MAX_Y_TRAVEL_M:
            return "y moves"
        return self._explain_leg_failure(samples, rests, meters_per_pulse)

    def _explain_leg_failure(
        self, samples: list[TrialSample], rests: list[tuple[int, int]], meters_per_pulse: float
    ) -> str:
        """Explain which rate or ramp between the rests does not meet the requirements; "" if all do."""
        begins = 0
        for k, (first, last) in enumerate(rests):
            times = np.array([s.time for s in samples[begins : first + 1]])
            places = np.array([s.commanded for s in samples[begins : first + 1]])
            if len(times) <= RATE_WINDOW_SAMPLES:
                return "a way is too short to have a rate"
            rates = (
                np.abs(
                    (places[RATE_WINDOW_SAMPLES:] - places[:-RATE_WINDOW_SAMPLES])
                    / (times[RATE_WINDOW_SAMPLES:] - times[:-RATE_WINDOW_SAMPLES])
                )
                / meters_per_pulse
            )
            top = float(rates.max())
            if not MIN_RATE_RATIO * self.rate_pps <= top <= MAX_RATE_RATIO * self.rate_pps:
                return f"way {k + 1} has {top:.0f} pulses a second"
            up = times[int(np.argmax(rates >= RAMP_END_RATIO * top))] - times[int(np.argmax(rates > 0))]
            if k == 0 and up < RAMP_END_RATIO * self.min_ramp_s - 2 * RATE_WINDOW_SAMPLES * SAMPLE_INTERVAL_S:
                return f"its ramp up takes {up:.3f} s"
            begins = last
        return ""


class TrialObserver:
    """Observer that samples a stage while a program runs.

    Args:
        stage: Stage with the axes x and y.
        seconds: Simulated time after which `sample` raises RunTimeout.
    """

    def __init__(self, stage: Stage, seconds: float):
        self._stage, self._seconds = stage, seconds
        self.samples: list[TrialSample] = []
        self.sample()

    def sample(self) -> None:
        """Append a sample if the last one is some milliseconds old. Raises RunTimeout after the permitted time."""
        now = self._stage.time
        if self.samples and now - self.samples[-1].time < 0.9 * SAMPLE_INTERVAL_S:
            return
        if now > self._seconds:
            raise RunTimeout(f"it takes more than {self._seconds:g} s.")
        x, y = self._stage.axes["x"], self._stage.axes["y"]
        busy = x.chip.busy(x.chip_axis) or y.chip.busy(y.chip_axis)
        self.samples.append(TrialSample(now, x.commanded, x.position, x.lost_steps, y.position, busy))


def find_rests(samples: list[TrialSample]) -> list[tuple[int, int]]:
    """Find the rests of axis x that follow a commanded motion and last MIN_REST_S or longer.

    Args:
        samples: Samples of a run.

    Returns:
        Indices of the first and the last sample of each rest.
    """
    rests: list[tuple[int, int]] = []
    first, gone = None, False
    for k, s in enumerate([*samples, samples[-1]._replace(busy=True)]):
        if s.busy:
            if gone and first is not None and samples[k - 1].time - samples[first].time >= MIN_REST_S:
                rests.append((first, k - 1))
                gone = False
            first = None
        else:
            gone = gone or s.commanded != samples[rests[-1][1] if rests else 0].commanded
            first = k if first is None else first
    return rests
