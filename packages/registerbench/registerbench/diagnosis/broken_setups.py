"""Broken set-ups: the customer's complaint, the host's program, the causes, and the acceptance trial. Ten have names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from registerbench.diagnosis.acceptance_trial import AcceptanceTrial
from registerbench.diagnosis.machine_faults import DEFAULT_SEVERITIES, SERVICES

NO_FAULT = "no fault"
CAUSES = {
    "wrong polarity bit": "the chip is told that a sensor is of the other logic",
    "R6 missing after reset": "the ramp-down point is gone when the move begins",
    "R4 wider than its register": "the acceleration rate has more bits than its register",
    "swapped limit switches": "the wires of the end limits are exchanged",
    "ramp-down point too late": "the ramp down begins too close to the end",
    "supply too low": "the drives have less voltage than they should",
    "wrong base address": "the host speaks to another chip than it believes",
    "missing reset command": "a start comes without the reset command that has to go before it",
    "slipping coupling": "not all of the motor's torque reaches the screw",
    "S-curve failure of the MCX304": "a decelerating stop at the end of an S-curve drive never ends",
    "jammed guides": "the carriage does not move, whatever pushes",
    "broken motor wire": "one phase of the motor has no current",
    "stuck ORG sensor": "the sensor never trips, or never lets go",
    NO_FAULT: "machine and program do what is wanted, whatever the customer says",
}
"""Causes that an agent can answer, with their descriptions."""


@dataclass(frozen=True)
class Setup:
    """Broken set-up: a machine and a host's program that do not meet the customer's requirements, unless its cause is NO_FAULT.

    Attributes:
        name: Name of the set-up.
        causes: Keys of CAUSES, one or two.
        complaint: Complaint of the customer.
        program: Program of the host, see host_program.py.
        trial: Requirements of the customer.
        chips: Chips of the stage.
        payload: Mass on the table, kg.
        model: Name of the stage's model.
        right_program: Program that meets the requirements on a healthy machine; "" if `program` does.
        severities: Severities of the faults of the machine that differ from DEFAULT_SEVERITIES, by cause.
    """

    name: str
    causes: tuple[str, ...]
    complaint: str
    program: str
    trial: AcceptanceTrial
    chips: str = "pcl240k"
    payload: float = 0.0
    model: str = "xy"
    right_program: str = ""
    severities: Mapping[str, float] = field(default_factory=dict)

    @property
    def machine_faults(self) -> dict[str, float]:
        """Causes that are in the machine, each with its severity."""
        return {
            c: self.severities.get(c, DEFAULT_SEVERITIES.get(c, 1.0)) for c in self.causes if c in SERVICES.values()
        }


MOVE_REGISTERS_PROGRAM = """\
x: operate 08h          # reset command
x: R0 <- 16000          # 50 mm
x: R1 <- 340            # 1 kpps
x: R2 <- 8160           # 24 kpps
x: R4 <- 157
x: R5 <- 157
x: R6 <- 3200
x: R7 <- 204
"""
MOVE_OUT = """\
x: control 44h          # preset, plus
x: operate 15h          # start, ramp to FH1
until x stopped 5
wait 0.2
"""
MOVE_BACK = """\
x: operate 08h
x: R0 <- 16000
x: R6 <- 3200
x: control 4Ch          # preset, minus
x: operate 15h
until x stopped 5
wait 0.2
"""
MOVE_OUT_AND_BACK = MOVE_REGISTERS_PROGRAM + MOVE_OUT + MOVE_BACK
FAST_TRIAL = AcceptanceTrial((0.05, 0.0), rate_pps=24_000, max_seconds=2.6)
LONG_RAMP_PROGRAM = """\
x: operate 08h
x: R0 <- 16000          # 50 mm
x: R1 <- 3
x: R2 <- 80             # 24 kpps
x: 84 2: 41 1: 10       # R4 <- 16656: a ramp of 0.26 s
x: R5 <- 16000
x: R6 <- 3400
x: R7 <- 2              # steps of 300 pps
"""
S_CURVE_DRIVE_PROGRAM = """\
x: {start}
until x RR1.DSND 1 4
until x RR1.DSND 0 4
wait 0.02
x: STOP_DEC
until x stopped 4
wait 0.2
"""

SETUPS: dict[str, Setup] = {
    s.name: s
    for s in (
        Setup(
            "polarity",
            ("wrong polarity bit",),
            "x shall return to its origin, leave it by 10 mm and return again, and never moves. It did with the board of before.",
            """\
x: operate 08h
x: R1 <- 2720           # 8 kpps
x: R7 <- 204
x: R13 <- 800000h       # sensors of the new board
x: control 69h          # minus, origin return
x: operate 10h          # constant FL
until x stopped 20
wait 0.2
x: operate 08h
x: R0 <- 3200           # 10 mm
x: control 44h          # preset, plus
x: operate 10h
until x stopped 20
wait 0.2
x: operate 08h
x: control 69h          # and again
x: operate 10h
until x stopped 20
wait 0.2
""",
            AcceptanceTrial((-0.12, -0.11, -0.12), rate_pps=8000, max_seconds=4.0, starts_m=(-0.1, -0.08), from_start=False,
                            tolerance_m=3e-4),
            chips="pcl240ms",
        ),
        Setup(
            "forgotten",
            ("R6 missing after reset",),
            "x shall move 50 mm and back. Since the chip was replaced by its successor it ends with a bang, and stands elsewhere.",
            MOVE_REGISTERS_PROGRAM + "x: operate 08h          # once more, to be sure\n" + MOVE_OUT + MOVE_BACK,
            FAST_TRIAL,
            chips="pcl240mk",
            payload=2.0,
        ),
        Setup(
            "wide",
            ("R4 wider than its register",),
            "x shall move 50 mm and back with a long, soft ramp up. It starts with a jerk, hums, and stays where it is.",
            LONG_RAMP_PROGRAM + MOVE_OUT + MOVE_BACK.replace("R6 <- 3200", "R6 <- 3400"),
            replace(FAST_TRIAL, min_ramp_s=0.24, max_seconds=3.2),
            payload=2.0,
        ),
        Setup(
            "swapped",
            ("swapped limit switches",),
            "x shall run to its plus end, be stopped there by the limit switch, and so at its minus end. It runs against the "
            "rubber and hums on.",
            """\
x: operate 08h
x: R1 <- 340
x: R2 <- 5440           # 16 kpps
x: R4 <- 200
x: R5 <- 200
x: R7 <- 204
x: control 40h          # plus, until something stops it
x: operate 15h
until x stopped 5
wait 0.2
x: operate 08h
x: control 48h          # minus, until something stops it
x: operate 15h
until x stopped 8
wait 0.2
""",
            AcceptanceTrial((0.15, -0.15), rate_pps=16_000, max_seconds=9.0, starts_m=(0.1,), from_start=False, tolerance_m=1e-3),
        ),
        Setup(
            "late",
            ("ramp-down point too late",),
            "x shall move 50 mm with 2 kg on it, and back. It starts well, stops hard, and stands somewhere else.",
            MOVE_REGISTERS_PROGRAM.replace("R6 <- 3200", "R6 <- 320 ") + MOVE_OUT + MOVE_BACK,
            FAST_TRIAL,
            payload=2.0,
        ),
        Setup(
            "supply",
            ("supply too low",),
            "x shall move 50 mm and back. Slow moves are good, and on this one it stands still with a whine half way.",
            MOVE_OUT_AND_BACK,
            FAST_TRIAL,
        ),
        Setup(
            "address",
            ("wrong base address",),
            "x shall move 50 mm and back. x stands still, and something else moves.",
            "base x 304h             # the card, see its jumpers\n" + MOVE_OUT_AND_BACK,
            FAST_TRIAL,
        ),
        Setup(
            "reset",
            ("missing reset command",),
            "x shall move 25 mm twice, with a pause, and back. It makes the first move, and not the second.",
            (MOVE_REGISTERS_PROGRAM + MOVE_OUT).replace("R0 <- 16000          # 50 mm", "R0 <- 8000           # 25 mm")
            + "x: R0 <- 8000           # once more\nx: operate 15h\nuntil x stopped 5\nwait 0.2\n" + MOVE_BACK,
            replace(FAST_TRIAL, stops_m=(0.025, 0.05, 0.0), max_seconds=3.2),
        ),
        Setup(
            "slip",
            ("slipping coupling",),
            "x shall move 50 mm with 2 kg on it, slowly, and back. The motor was changed yesterday; since then it comes short, at "
            "any speed.",
            MOVE_OUT_AND_BACK.replace("R2 <- 8160           # 24 kpps", "R2 <- 2720           # 8 kpps")
            .replace("R4 <- 157", "R4 <- 60").replace("R5 <- 157", "R5 <- 60").replace("R6 <- 3200", "R6 <- 400 "),
            AcceptanceTrial((0.05, 0.0), rate_pps=8000, max_seconds=5.4),
            payload=2.0,
        ),
        Setup(
            "erratum",
            ("S-curve failure of the MCX304",),
            "x shall move 125 mm by an S-curve, and back. When the speed falls the host asks for a decelerating stop, to be sure. "
            "x runs on for ever.",
            """\
x: R <- 400000          # units of 20 pps
x: K <- 20000
x: A <- 8000
x: SV <- 400            # 8 kpps
x: V <- 2000            # 40 kpps
x: AO <- 0
x: WR2 0004h            # limits decelerate
x: WR3 0004h            # S-curve
x: P <- 40000           # 125 mm
""" + S_CURVE_DRIVE_PROGRAM.format(start="F_DRV_P") + S_CURVE_DRIVE_PROGRAM.format(start="F_DRV_M"),
            AcceptanceTrial((0.125, 0.0), rate_pps=27_700, max_seconds=5.4, starts_m=(0.02,), tolerance_m=1e-4),
            chips="mcx304",
        ),
    )
}  # fmt: skip
"""Named set-ups, for practice; setup_generation.py draws those of the suite."""
