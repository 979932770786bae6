"""Broken set-ups that are drawn from seeds: job, program, chip, model, faults with their severity, and the complaint.

    setup = generate_setup(1_000_000)      one of the test games of the suite `diagnosis`
    Case(setup)

A job is what the customer wants, with a host's program that does it on a healthy machine. A seed draws a job, then its cause: a bug
of the program, a fault of the machine, or none, each with the same probability; a quarter of the broken set-ups have a fault of the
machine in addition. The complaint is drawn independently of the cause: it fits by chance, and misleads otherwise, so nobody can
answer by its words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from registerbench.diagnosis.acceptance_trial import AcceptanceTrial
from registerbench.diagnosis.broken_setups import NO_FAULT, S_CURVE_DRIVE_PROGRAM, Setup

SECOND_FAULT_SHARE = 0.25  # of the broken set-ups
MODELS = ("xy", "xyz", "xy_mast")
PULSES_PER_MM = 320  # of x, in all of these models
RATE_STEP_PPS = 300  # rates are multiples of it, which both multipliers of the programs can make
FINE, COARSE = (204, 102), (2, 1)  # R7, and the rate registers' counts for RATE_STEP_PPS
RAMP_CLOCK_HZ = 4_915_200.0  # of a PCL-240: a ramp takes (R2 - R1) x R4 / RAMP_CLOCK_HZ
R4_LIMIT, WIDE_RAMP_CHIP = 1 << 14, "pcl240ms"  # R4 of the other chips has 14 bits
PAUSE_S, REST_S = 0.2, 0.2  # the wait after a move; time for polls and bus cycles of a whole program
RNG_STREAM = 47  # tells the generator of set-ups from those of the environments, which use the same seeds

COMPLAINTS = (
    "It hums, and stays where it is.",
    "It starts well, and stands somewhere else.",
    "It ends with a bang.",
    "Something else moves.",
    "It never moves.",
    "It makes the first move, and no other.",
    "It runs on for ever.",
    "Slow moves are good, this one is not.",
    "It comes short, at any speed.",
    "It starts with a jerk.",
)
CUSTOMER_REMARKS = (
    "It did yesterday.",
    "It did with the board of before.",
    "Since the chip was replaced it does not.",
    "The motor was changed last week.",
    "The electrician was here, and says that the supply is weak.",
    "My colleague has changed a number in the program, and swears that it cannot be this.",
    "The wires of the end limits were on the floor when I came.",
    "The coupling was loose once before.",
    "I have greased the guides.",
    "The ORG sensor is new.",
    "It has happened three times this month.",
    "I do not know more.",
)


@dataclass(frozen=True)
class Job:
    """Job of a customer's machine.

    Attributes:
        text: Job in words, the first sentence of the complaint.
        program: Program that does the job on a healthy machine.
        bugs: Program with a bug, by its cause.
        faults: Causes in the machine with which the program fails, each with the range of its severity.
        trial: Requirements of the customer.
        chips: Chips of the stage.
        payload: Mass on the table, kg.
    """

    text: str
    program: str
    bugs: Mapping[str, str]
    faults: Mapping[str, tuple[float, float]]
    trial: AcceptanceTrial
    chips: str
    payload: float


def generate_setup(seed: int) -> Setup:
    """Draw the broken set-up of a seed.

    Args:
        seed: Seed, 0 or greater. Learners may use seeds below 1,000,000.
    """
    rng = np.random.default_rng((RNG_STREAM, seed))
    job = _choose(rng, JOBS)(rng)
    model, complaint, belief = (_choose(rng, words) for words in (MODELS, COMPLAINTS, CUSTOMER_REMARKS))
    cause = _choose(rng, (NO_FAULT, *job.bugs, *job.faults))
    second = _choose(rng, [fault for fault in job.faults if fault != cause])
    has_second = rng.uniform() < SECOND_FAULT_SHARE and cause != NO_FAULT
    causes = (cause, second) if has_second else (cause,)
    severities = {fault: float(rng.uniform(*ends)) for fault, ends in job.faults.items()}
    return Setup(
        name=str(seed),
        causes=causes,
        complaint=f"{job.text} {complaint} {belief}",
        program=job.bugs.get(cause, job.program),
        right_program=job.program,
        trial=job.trial,
        chips=job.chips,
        model=model,
        payload=job.payload,
        severities={fault: severities[fault] for fault in causes if fault in severities},
    )


def count_causes(seed: int) -> int:
    """Return from how many causes that of a seed's set-up was drawn; whoever knows the job guesses right once in so many times."""
    job = _choose(rng := np.random.default_rng((RNG_STREAM, seed)), JOBS)(rng)
    return 1 + len(job.bugs) + len(job.faults)


def _choose(rng: np.random.Generator, values: Sequence[Any]) -> Any:
    """Draw one of several values, each with the same probability."""
    return values[int(rng.integers(len(values)))]


def _format_register_line(rng: np.random.Generator, line: str, value: int) -> str:
    """Return the program line that writes R4 or R5, by name or by bytes as the host's author liked it."""
    raw = f"x: {0x80 + int(line[1]):02X} 2: {value >> 8:02X} 1: {value & 0xFF:02X}"
    return f"{raw:24}# {line}\n" if value >= R4_LIMIT or rng.uniform() < 0.5 else f"x: {line} <- {value}\n"


def _add_port_bug(bugs: dict[str, str], program: str, rng: np.random.Generator, ports: tuple[str, ...]) -> None:
    """Add the bug of a host that expects the chip at another port."""
    bugs["wrong base address"] = program.replace("base x 300h", f"base x {_choose(rng, ports)}")


def draw_moves_job(rng: np.random.Generator) -> Job:
    """Draw a job of two or three preset moves of a PCL-240, the last of which returns to the start."""
    multiplier, counts = _choose(rng, (FINE, COARSE))
    top, start = int(rng.integers(60, 81)), 3  # rates, in RATE_STEP_PPS
    ramp_s = float(rng.uniform(0.16, 0.24))
    r4 = min(round(ramp_s * RAMP_CLOCK_HZ / (counts * (top - start))), R4_LIMIT - 1)
    ramp_s = r4 * counts * (top - start) / RAMP_CLOCK_HZ
    ramp_down = round((top + start) / 2 * RATE_STEP_PPS * ramp_s) + int(rng.integers(40, 120))
    out_mm, side = int(rng.integers(30, 61)), _choose(rng, (1, -1))
    legs_mm = (out_mm, -out_mm) if rng.uniform() < 0.6 else (out_mm, 30, -out_mm - 30)
    chips = _choose(rng, ("pcl240k", "pcl240mk", WIDE_RAMP_CHIP))
    r6_line = f"x: R6 <- {ramp_down}\n"
    rates = f"x: R1 <- {start * counts}\nx: R2 <- {top * counts}\n"
    ramps = _format_register_line(rng, "R4", r4) + _format_register_line(rng, "R5", r4)

    def write_program(
        ramps: str = ramps, r6: str = r6_line, reset: str = "x: operate 08h\n", after_r6: str = ""
    ) -> str:
        """Write the program of all legs, with these lines."""
        text = f"base x 300h\nx: operate 08h\n{rates}{ramps}x: R7 <- {multiplier}\n"
        for k, leg in enumerate(legs_mm):
            text += (reset if k == 1 else "x: operate 08h\n" if k else "") + f"x: R0 <- {abs(leg) * PULSES_PER_MM}\n"
            text += r6 + after_r6 + f"x: control {'44h' if leg * side > 0 else '4Ch'}\nx: operate 15h\n"
            text += f"until x stopped 5\nwait {PAUSE_S}\n"
        return text

    program, keeps_r6 = write_program(), chips != "pcl240mk"
    wide = _format_register_line(rng, "R4", R4_LIMIT + int(rng.integers(2, 6) * (1 if multiplier == FINE[0] else 60)))
    bugs = {
        "R6 missing after reset": write_program(r6="") if keeps_r6 else write_program(after_r6="x: operate 08h\n"),
        "ramp-down point too late": write_program(r6=f"x: R6 <- {round(ramp_down * rng.uniform(0.03, 0.12))}\n"),
        "missing reset command": write_program(reset=""),
    }
    if chips != WIDE_RAMP_CHIP:
        bugs["R4 wider than its register"] = write_program(ramps=wide + ramps.partition("\n")[2])
    _add_port_bug(bugs, program, rng, ("304h", "308h"))
    stops = np.cumsum(legs_mm) * side / 1e3
    seconds = sum(abs(leg) * PULSES_PER_MM / (top * RATE_STEP_PPS) + ramp_s + PAUSE_S + 0.15 for leg in legs_mm)
    places = ", ".join(f"{1e3 * s:g}" for s in stops)
    trial = AcceptanceTrial(
        tuple(stops.tolist()), rate_pps=top * RATE_STEP_PPS, max_seconds=round(1.35 * seconds + REST_S, 1),
        min_ramp_s=round(0.95 * ramp_s, 3),
    )  # fmt: skip
    faults = {"supply too low": (0.06, 0.13), "slipping coupling": (0.05, 0.07), **STANDSTILLS}
    return Job(f"x shall go to {places} mm.", program, bugs, faults, trial, chips, round(float(rng.uniform(0, 3)), 1))


def draw_origin_job(rng: np.random.Generator) -> Job:
    """Draw a job of two origin returns of a PCL-240MS, between which x leaves ORG."""
    rate, away_mm = int(rng.integers(20, 28)), int(rng.integers(8, 16))
    back = f"x: control 69h\nx: operate 10h\nuntil x stopped 20\nwait {PAUSE_S}\n"
    out = f"x: R0 <- {away_mm * PULSES_PER_MM}\nx: control 44h\nx: operate 10h\nuntil x stopped 20\nwait {PAUSE_S}\n"
    head = f"base x 300h\nx: operate 08h\nx: R1 <- {rate * FINE[1]}\nx: R7 <- {FINE[0]}\n"

    def write_program(polarity: str = "0", first: str = "x: operate 08h\n", second: str = "x: operate 08h\n") -> str:
        """Write the program with this value of R13, and with these lines before the second and the third start."""
        return f"{head}x: R13 <- {polarity}\n{back}{first}{out}{second}{back}"

    program = write_program()
    bugs = {
        "wrong polarity bit": write_program(polarity="800000h"),
        "missing reset command": _choose(rng, (write_program(first=""), write_program(second=""))),
    }
    _add_port_bug(bugs, program, rng, ("304h", "308h"))
    travel_s = (40 + 2 * away_mm) * PULSES_PER_MM / (rate * RATE_STEP_PPS)
    trial = AcceptanceTrial(
        (-0.12, -0.12 + away_mm / 1e3, -0.12), rate_pps=rate * RATE_STEP_PPS,
        max_seconds=round(1.2 * travel_s + 3 * PAUSE_S + 0.4, 1),
        starts_m=(-0.1, -0.08), from_start=False, tolerance_m=3e-4,
    )  # fmt: skip
    faults = {"stuck ORG sensor": (0.0, 1.0), "slipping coupling": (0.05, 0.07), **STANDSTILLS}
    text = f"x shall return to its origin, leave it by {away_mm} mm and return again."
    return Job(text, program, bugs, faults, trial, "pcl240ms", round(float(rng.uniform(0, 3)), 1))


def draw_limits_job(rng: np.random.Generator) -> Job:
    """Draw a job of two moves of a PCL-240 that end at the limit switches."""
    top, start, side = int(rng.integers(40, 51)), 3, _choose(rng, (1, -1))
    ramp_s = float(rng.uniform(0.16, 0.24))
    r4 = round(ramp_s * RAMP_CLOCK_HZ / (FINE[1] * (top - start)))
    travel_s = 0.3 * PULSES_PER_MM * 1e3 / (top * RATE_STEP_PPS)
    ramps = _format_register_line(rng, "R4", r4) + _format_register_line(rng, "R5", r4)
    rates = f"x: R1 <- {start * FINE[1]}\nx: R2 <- {top * FINE[1]}\n"
    first, then = ("40h", "48h") if side > 0 else ("48h", "40h")
    chips = _choose(rng, ("pcl240k", WIDE_RAMP_CHIP))

    def write_program(ramps: str = ramps, reset: str = "x: operate 08h\n") -> str:
        """Write the program with these lines."""
        moves = [
            f"x: control {c}\nx: operate 15h\nuntil x stopped {round(travel_s + 2)}\nwait {PAUSE_S}\n"
            for c in (first, then)
        ]
        return f"base x 300h\nx: operate 08h\n{rates}{ramps}x: R7 <- {FINE[0]}\n{moves[0]}{reset}{moves[1]}"

    program = write_program()
    wide = _format_register_line(rng, "R4", R4_LIMIT + int(rng.integers(2, 6)))
    bugs = {"missing reset command": write_program(reset="")}
    if chips != WIDE_RAMP_CHIP:
        bugs["R4 wider than its register"] = write_program(ramps=wide + ramps.partition("\n")[2])
    _add_port_bug(bugs, program, rng, ("304h", "308h"))
    trial = AcceptanceTrial(
        (0.15 * side, -0.15 * side), rate_pps=top * RATE_STEP_PPS, max_seconds=round(1.2 * 7 / 6 * travel_s + 2.0, 1),
        min_ramp_s=round(0.95 * ramp_s, 3), starts_m=(0.1 * side,), from_start=False, tolerance_m=1e-3,
    )  # fmt: skip
    faults = {
        "swapped limit switches": (0.0, 1.0),
        "supply too low": (0.05, 0.08),
        "slipping coupling": (0.05, 0.07),
        **STANDSTILLS,
    }
    ends = ("plus", "minus")[::side]
    text = f"x shall run to its {ends[0]} end, be stopped there by the limit switch, and so at its {ends[1]} end."
    return Job(text, program, bugs, faults, trial, chips, round(float(rng.uniform(0, 1)), 1))


def draw_s_curve_job(rng: np.random.Generator) -> Job:
    """Draw a job of two S-curve moves of an MCX304."""
    distance = PULSES_PER_MM * int(rng.integers(100, 131))
    side = _choose(rng, (1, -1))
    drive = "x: {start}\nuntil x RR1.DSND 1 4\nuntil x RR1.DSND 0 4\nwait 0.02\nuntil x stopped 4\nwait 0.2\n"
    head = f"""\
x: R <- 400000
x: K <- 20000
x: A <- 8000
x: SV <- 400
x: V <- 2000
x: AO <- 0
x: WR2 0004h
x: WR3 0004h
x: P <- {distance}
"""

    def write_program(drive: str) -> str:
        """Write the program with these lines for each drive."""
        return head + "".join(drive.format(start=s) for s in ("F_DRV_P", "F_DRV_M")[::side])

    program = write_program(drive)
    bugs = {"S-curve failure of the MCX304": write_program(S_CURVE_DRIVE_PROGRAM)}
    trial = AcceptanceTrial(
        (distance / PULSES_PER_MM / 1e3 * side, 0.0), rate_pps=round(_compute_s_curve_peak_pps(distance)), max_seconds=5.4,
        tolerance_m=1e-4,
    )  # fmt: skip
    faults = {"supply too low": (0.06, 0.14), "slipping coupling": (0.05, 0.07), **STANDSTILLS}
    text = f"x shall move {distance / PULSES_PER_MM:g} mm by an S-curve, and back."
    return Job(text, program, bugs, faults, trial, "mcx304", round(float(rng.uniform(0, 2)), 1))


def _compute_s_curve_peak_pps(pulses: int, start_pps: float = 8000.0, jerk_pps3: float = 62_800.0) -> float:
    """Return the peak rate of an S-curve drive that does not reach its drive rate: D = 2 (v0 + v) sqrt((v - v0) / jerk)."""
    rates = np.linspace(start_pps, 60_000.0, 20_000)
    return float(np.interp(pulses, 2 * (start_pps + rates) * np.sqrt((rates - start_pps) / jerk_pps3), rates))


STANDSTILLS = {"jammed guides": (0.0, 1.0), "broken motor wire": (0.0, 1.0)}
"""Faults with which x does not follow at any rate."""
JOBS: tuple[Callable[[np.random.Generator], Job], ...] = (
    draw_moves_job, draw_moves_job, draw_origin_job, draw_limits_job, draw_s_curve_job,
)  # fmt: skip
"""Jobs, of which each set-up has one; moves have more kinds of bugs, and are drawn twice as often."""
