"""The register map of a STEP/DIR axis as data: its lines, and the registers of its step timer.

Nothing here comes from a data sheet. The lines are those of every power stage; the step timer stands for the timer interrupt of a
microcontroller's firmware, with registers of our own, so that host drivers in Python need no loop over steps.
"""

from __future__ import annotations

from stage.chips.register_map import ChipCommand, Field, Register, RegisterMap, Word

CONTROL_ADDRESS = 0
"""Bus address of the control word; a read of it returns the status word."""
ADDRESS_MASK, DATA_MASK = 0xF, 0xFFFF_FFFF
END_REASONS = {0: "nothing yet", 1: "all steps", 2: "EL+", 3: "EL-", 4: "ORG", 5: "stop command"}
"""What has ended the last move, by the value of the status field `end`."""

CONTROL = Word(
    "control",
    "control word of the step timer",
    (
        Field("at_once", 5, 5, "stop at once", "I", "W"),
        Field("ramp_down", 4, 4, "stop with the ramp down", "I", "W"),
        Field("until_org", 3, 3, "stop with the ramp down when ORG becomes asserted", "I", "W"),
        Field("continuous", 2, 2, "no end after STEPS", "I", "W"),
        Field("minus", 1, 1, "", "I", "W", values={0: "plus", 1: "minus"}, silent=None),
        Field("start", 0, 0, "start", "I", "W"),
    ),
    address=CONTROL_ADDRESS,
)
STATUS = Word(
    "status",
    "status word",
    (
        Field("end", 10, 8, "ended by", "I", "R", values=END_REASONS),
        Field("probe", 4, 4, "PROBE asserted", "I", "R", pins=("probe",)),
        Field("org", 3, 3, "ORG asserted", "I", "R", pins=("org",)),
        Field("minus_limit", 2, 2, "EL- asserted", "I", "R", pins=("el_minus",)),
        Field("plus_limit", 1, 1, "EL+ asserted", "I", "R", pins=("el_plus",)),
        Field("busy", 0, 0, "the step timer runs", "I", "R"),
    ),
    address=CONTROL_ADDRESS,
)
MAX_STEPS = (1 << 31) - 1
MAX_RATE_PPS = 200_000
MAX_RAMP_US = 5_000_000


def _make_register(
    name: str, number: int, title: str, legal: tuple[int, int], unit: str, **further: object
) -> Register:
    """Return a register of the step timer. `further` has further attributes of `Register`."""
    return Register(name, number, 32, "RW", title, legal, evidence="I", unit=unit, section="step timer", **further)  # type: ignore[arg-type]


MAP = RegisterMap(
    "STEPDIR",
    "STEP, DIR and ENABLE lines of a power stage, and a step timer for hosts without firmware",
    "inferred: no silicon has these registers",
    (
        _make_register("START", 1, "rate at the start and the end of a move", (0, MAX_RATE_PPS), "pps"),
        _make_register("RATE", 2, "drive rate", (1, MAX_RATE_PPS), "pps"),
        _make_register("UP", 3, "time of the ramp from START to RATE", (0, MAX_RAMP_US), "us"),
        _make_register("DOWN", 4, "time of the ramp from RATE to START", (0, MAX_RAMP_US), "us"),
        _make_register(
            "CURVED", 5, "share of the speed change that is curved at each end of a ramp", (0, 50), "%",
            note="0 is a trapezoid, 50 an S-curve without a straight part",
        ),
        _make_register("STEPS", 6, "steps of a move", (0, MAX_STEPS), "pulses"),
        _make_register(
            "EVENTS", 7, "steps of the longest axis of a line", (0, MAX_STEPS), "pulses",
            note="rates and ramps are those of the longest axis; below STEPS it counts as STEPS",
        ),
        _make_register("HIGH", 8, "time that STEP stays high", (100, 1_000_000), "ns", reset=2_000),
        Register(
            "POSITION", 9, 32, "R", "accepted steps, plus less minus, since the last reset", evidence="I", unit="pulses",
            signed=True, section="lines",
        ),
    ),
    (CONTROL, STATUS),
    (
        ChipCommand(0x20, "STOP", "stop at once", "other", evidence="I"),
        ChipCommand(0x10, "SLOW", "stop with the ramp down", "other", evidence="I"),
        ChipCommand(0x01, "MOVE+", "move by STEPS, plus", "drive", evidence="I", starts=True),
        ChipCommand(0x03, "MOVE-", "move by STEPS, minus", "drive", evidence="I", starts=True),
        ChipCommand(0x05, "RUN+", "run, plus", "drive", evidence="I", starts=True),
        ChipCommand(0x07, "RUN-", "run, minus", "drive", evidence="I", starts=True),
        ChipCommand(0x0D, "HOME+", "run until ORG, plus", "drive", evidence="I", starts=True),
        ChipCommand(0x0F, "HOME-", "run until ORG, minus", "drive", evidence="I", starts=True),
    ),
)  # fmt: skip
