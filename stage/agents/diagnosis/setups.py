"""The ten set-ups: what the customer complains of, the host's program, what is broken, and when it is well again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from stage.sim.stage import Stage

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
}
"""What an agent can answer."""

SERVICES = {
    "exchange the wires of the end limits of x": "swapped limit switches",
    "set the supply of the drives to what is on the nameplate": "supply too low",
    "tighten the coupling between motor and screw of x": "slipping coupling",
    "replace the motor of x": "",
    "clean and grease the guides of x": "",
    "replace the ORG sensor of x": "",
}
"""What a technician can be asked to do, and which cause it mends."""

WITHIN = 60e-6  # m, of the place that is wanted: a full step and what friction holds


@dataclass(frozen=True)
class Setup:
    """A set-up. place: of the carriages at power-up, m; equip: breaks the machine at power-up, each time, until `cause` has been
    mended; program: the host's; wants: where the carriages should be in the end, m; drives: whether an axis may drive then."""

    name: str
    cause: str
    complaint: str
    program: str
    wants: Mapping[str, float]
    chips: str = "pcl240k"
    payload: float = 0.0
    place: Mapping[str, float] = field(default_factory=dict)
    equip: Callable[[Stage], None] | None = None
    within: float = WITHIN


def swap_limits(stage: Stage) -> None:
    """The wires of x's end limits are exchanged."""
    axis = stage.axes["x"]
    rows = [axis.switches.row(pin) for pin in ("el_plus", "el_minus")]
    bits = {pin: axis.chip.wired(pin) for pin in ("el_plus", "el_minus")}
    stage.state.switch_table[rows[0]].bit, stage.state.switch_table[rows[1]].bit = bits["el_minus"], bits["el_plus"]
    stage.look_again(axis)


def straighten_limits(stage: Stage) -> None:
    """They are as they should be."""
    axis = stage.axes["x"]
    for pin in ("el_plus", "el_minus"):
        stage.state.switch_table[axis.switches.row(pin)].bit = axis.chip.wired(pin)
    stage.look_again(axis)


def weak_supply(stage: Stage) -> None:
    """The supply has sunk to a sixth."""
    for axis in stage.axes.values():
        axis.supply = axis.drive.bus_voltage / 6
    stage.equip()


def full_supply(stage: Stage) -> None:
    """The supply is what it should be."""
    for axis in stage.axes.values():
        axis.supply = axis.drive.bus_voltage
    stage.equip()


def slip(stage: Stage) -> None:
    """A fifteenth of the motor's torque reaches the screw of x: there is no other rotor in the model than that on the screw."""
    drive = stage.state.drives[stage.axes["x"].index]
    drive.torque_constant, drive.slice = drive.torque_constant / 15, 0.0


MENDED: dict[str, Callable[[Stage], None]] = {
    "swapped limit switches": straighten_limits,
    "supply too low": full_supply,
}
"""What mending does that a reset does not."""

MOVE = """\
x: operate 08h          # reset command
x: R0 <- 16000          # 50 mm
x: R1 <- 340            # 1 kpps
x: R2 <- 8160           # 24 kpps
x: R4 <- 157
x: R5 <- 157
x: R6 <- 3200
x: R7 <- 204
x: control 44h          # preset, plus
x: operate 15h          # start, ramp to FH1
until x stopped 5
wait 0.2
"""

SETUPS: dict[str, Setup] = {
    s.name: s
    for s in (
        Setup(
            "polarity",
            "wrong polarity bit",
            "x shall return to its origin, and never moves. It did with the board of before.",
            """\
x: operate 08h
x: R1 <- 2720           # 8 kpps
x: R7 <- 204
x: R13 <- 800000h       # sensors of the new board
x: control 69h          # minus, origin return
x: operate 10h          # constant FL
until x stopped 20
wait 0.2
""",
            {"x": -0.12},
            chips="pcl240ms",
            place={"x": -0.1},
            within=3e-4,
        ),
        Setup(
            "forgotten",
            "R6 missing after reset",
            "x shall move 50 mm. Since the chip was replaced by its successor it ends with a bang, and stands somewhere else.",
            MOVE.replace("x: control 44h", "x: operate 08h          # once more, to be sure\nx: control 44h"),
            {"x": 0.05},
            chips="pcl240mk",
            payload=2.0,
        ),
        Setup(
            "wide",
            "R4 wider than its register",
            "x shall move 50 mm with a long, soft ramp up. It starts with a jerk, hums, and stays where it is.",
            """\
x: operate 08h
x: R0 <- 16000          # 50 mm
x: R1 <- 3
x: R2 <- 80             # 24 kpps
x: 84 2: 41 1: 10       # R4 <- 16656: a ramp of 0.26 s
x: R5 <- 16000
x: R6 <- 3400
x: R7 <- 2              # steps of 300 pps
x: control 44h
x: operate 15h
until x stopped 5
wait 0.2
""",
            {"x": 0.05},
            payload=2.0,
        ),
        Setup(
            "swapped",
            "swapped limit switches",
            "x shall run to its plus end and be stopped there by the limit switch. It runs against the rubber and hums on.",
            """\
x: operate 08h
x: R1 <- 340
x: R2 <- 2720           # 8 kpps
x: R4 <- 200
x: R5 <- 200
x: R7 <- 204
x: control 40h          # plus, until something stops it
x: operate 15h
until x stopped 4
wait 0.2
""",
            {"x": 0.15},
            place={"x": 0.1},
            equip=swap_limits,
            within=1e-3,
        ),
        Setup(
            "late",
            "ramp-down point too late",
            "x shall move 50 mm with 2 kg on it. It starts well, stops hard, and stands somewhere else.",
            MOVE.replace("R6 <- 3200", "R6 <- 320 "),
            {"x": 0.05},
            payload=2.0,
        ),
        Setup(
            "supply",
            "supply too low",
            "x shall move 50 mm. Slow moves are good, and on this one it stands still with a whine half way.",
            MOVE,
            {"x": 0.05},
            equip=weak_supply,
        ),
        Setup(
            "address",
            "wrong base address",
            "x shall move 50 mm. x stands still, and something else moves.",
            "base x 304h             # the card, see its jumpers\n" + MOVE,
            {"x": 0.05, "y": 0.0},
        ),
        Setup(
            "reset",
            "missing reset command",
            "x shall move 25 mm twice, with a pause. It makes the first move, and not the second.",
            MOVE.replace("R0 <- 16000          # 50 mm", "R0 <- 8000           # 25 mm")
            + "x: R0 <- 8000           # once more\nx: operate 15h\nuntil x stopped 5\nwait 0.2\n",
            {"x": 0.05},
        ),
        Setup(
            "slip",
            "slipping coupling",
            "x shall move 50 mm with 2 kg on it, slowly. The motor was changed yesterday; since then it comes short, at any speed.",
            MOVE.replace("R2 <- 8160           # 24 kpps", "R2 <- 2720           # 8 kpps")
            .replace("R4 <- 157", "R4 <- 60").replace("R5 <- 157", "R5 <- 60").replace("R6 <- 3200", "R6 <- 400 "),
            {"x": 0.05},
            payload=2.0,
            equip=slip,
        ),
        Setup(
            "erratum",
            "S-curve failure of the MCX304",
            "x shall move 125 mm by an S-curve. When the speed falls the host asks for a decelerating stop, to be sure. "
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
x: F_DRV_P
until x RR1.DSND 1 4
until x RR1.DSND 0 4
wait 0.02
x: STOP_DEC
until x stopped 4
wait 0.2
""",
            {"x": 0.145},
            chips="mcx304",
            place={"x": 0.02},
            within=1e-4,
        ),
    )
}  # fmt: skip
"""By name."""
