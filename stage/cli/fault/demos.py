"""The demonstrations by name, and what is claimed of each: of steppers, and of servos where those do something else."""

from __future__ import annotations

from stage.cli.fault import programs
from stage.cli.fault.demo import Claim, Demo, Figures

LIMITS = ("EL+", "EL-", "timeout")
HYSTERESIS = 28.0  # um: 25 of a switch, and a pulse


def done(figures: Figures) -> bool:
    """The chip has made its move to the end."""
    return figures["stopped by"] not in LIMITS


DEMOS = {
    "stuck-open": Demo(
        "EL+ stuck open: the chip never stops, the carriage runs onto the hard stop and the motor slips whole turns of four steps.",
        "not at all in the move: the pulses run out as they should. The next origin return needs more of them, or fewer.",
        programs.stuck_open,
        lambda h, f: h["stopped by"] == "EL+" and h["lost steps"] == 0
        and done(f) and f["lost steps"] > 0 and f["lost steps"] % 4 == 0,
        servo=Claim(
            "EL+ stuck open: the chip never stops, the carriage runs onto the hard stop and the motor pushes against it.",
            "at once: the actual position stands, and the command position runs away from it.",
            lambda h, f: h["stopped by"] == "EL+" and done(f) and f["beyond EL+, mm"] < 10 < f["behind at the end, mm"],
        ),
    ),
    "stuck-closed": Demo(
        "EL+ sticks closed in a move: the chip stops at once, without a ramp; the carriage runs on, out of step.",
        "at once: halted before its pulses were out, where no end limit is; towards plus nothing moves, the way back is free.",
        programs.stuck_closed,
        lambda h, f: done(h) and f["stopped by"] == "EL+" and f["before EL+, mm"] > 10 and f["lost steps"] < 0,
        ("position", "rate"),
        servo=Claim(
            "EL+ sticks closed in a move: the chip takes its motor command away at once; the carriage coasts.",
            "at once: Init/Idle, LIMIT in the status, where no end limit is. The position is still known.",
            lambda h, f: done(h) and f["stopped by"] == "EL+" and f["before EL+, mm"] > 10,
        ),
    ),
    "bounce": Demo(
        "ORG bounces for 3 ms: the chip sees several edges for each one, and finds the origin within the switch's hysteresis.",
        "a status that is read within the bounce may say that ORG is off, though ORG has stopped the axis: look again later.",
        programs.bounce,
        lambda h, f: f["edges of ORG that the chip saw"] > 4 * h["edges of ORG that the chip saw"] > 0
        and h["after the first edge ORG is off for, ms"] == 0 < f["after the first edge ORG is off for, ms"]
        and h["origin return stopped by"] == f["origin return stopped by"] == "ORG"
        and abs(f["origin, um"] - h["origin, um"]) < HYSTERESIS,
        ("rate", "org"), (-2e-3, 8e-3),
    ),
    "vane-missing": Demo(
        "The vane of ORG has come off: the origin return passes the origin and ends at EL-.",
        "at once: halted, and ORG is off, which leaves the end limit (`stopped_by` EL-).",
        programs.vane_missing,
        lambda h, f: h["stopped by"] == "ORG" and f["stopped by"] == "EL-" and f["past ORG, mm"] > 1,
        ("position", "org"),
    ),
    "payload-doubled": Demo(
        "The payload weighs 20 kg in place of 10: a ramp that 10 kg follow pulls the rotor out of step.",
        "not at all in the move: the chip counts pulses. An origin return afterwards shows it.",
        programs.payload,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and done(f),
        servo=Claim(
            "The payload weighs 20 kg in place of 10: the same loop follows the ramps less closely, and arrives all the same.",
            "by the position, command and actual, in each sample. No count is lost.",
            lambda h, f: done(f) and f["behind at most, mm"] > 1.1 * h["behind at most, mm"]
            and abs(f["carriage moved, mm"] - h["carriage moved, mm"]) < 0.05,
        ),
    ),
    "bus-voltage": Demo(
        "The supply falls from 24 V to 8 V at speed, below the back-EMF: the current is too little, and the motor stalls.",
        "not at all in the move: the chip counts pulses. An origin return afterwards shows it.",
        programs.bus_voltage,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and done(f),
        servo=Claim(
            "The supply falls from 24 V to 8 V at speed: the motor has a third of its push, falls behind, and arrives.",
            "by the position, command and actual, in each sample. No count is lost.",
            lambda h, f: done(f) and f["behind at most, mm"] > 2 * h["behind at most, mm"]
            and abs(f["carriage moved, mm"] - h["carriage moved, mm"]) < 0.05,
        ),
    ),
    "jam": Demo(
        "The axis jams in a move: the carriage stops, the chip sends the remaining pulses into a motor that stands.",
        "not at all in the move: the chip counts pulses. An origin return then ends in RunTimeout: pulses run, no switch comes.",
        programs.jam,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 0 and abs(f["on from 0.5 s, mm"]) < 0.2
        and f["pulses made"] == h["pulses made"],
        servo=Claim(
            "The axis jams in a move: the carriage all but stands, the motor pushes with all that it has, and the command goes on.",
            "at once: the actual position stands, and the command position runs away from it. `firmware.move` ends in RunTimeout.",
            lambda h, f: done(f) and abs(f["on from 0.5 s, mm"]) < 3 < 30 < f["behind at the end, mm"]
            and abs(h["behind at the end, mm"]) < 1
            and f["counts commanded"] == h["counts commanded"],
        ),
    ),
    "phase-open": Demo(
        "Phase B is open: a field of one phase has no direction, and from rest the motor stands where power-up has put it.",
        "not at all in the move: the chip counts pulses. An origin return then ends in RunTimeout: pulses run, ORG does not come.",
        programs.phase_open,
        lambda h, f: h["lost steps"] == 0 and f["lost steps"] > 100
        and f["opened at 6.25 turns/s: lost steps"] < 0.1 * f["lost steps"],
        ("position", "lost_steps"), (-0.05, 1.98),
    ),
    "start-skew": Demo(
        "The CPU is away for 5 ms between two start commands of an a:b move: both axes arrive, and leave the line on the way.",
        "by its clock around the start commands; both axes make all their pulses, and their status is as it should be.",
        programs.start_skew,
        lambda h, f: h["done"] == f["done"] == "yes" and abs(f["started within, ms"] - 5) < 0.1
        and f["off the line, pulses"] > 10 * h["off the line, pulses"],
        ("position", "rate"),
    ),
    "lost-write": Demo(
        "A write of the distance does not arrive: the chip makes the move that it was told, and not the one that was asked.",
        "by reading the distance back before the start, where the chip lets it; afterwards the status is that of a good move.",
        programs.lost_write,
        lambda h, f: h["pulses made"] == h["asked"] != f["pulses made"] and done(f),
        ("position", "pulses"),
        servo=Claim(
            "A byte of the final position does not arrive: the chip moves to where it was told, and not to where it was asked.",
            "by reading the final position back before the start; afterwards the status is that of a good move.",
            lambda h, f: h["counts commanded"] == h["asked"] != f["counts commanded"] and done(f)
            and f["diagnostics"] == h["diagnostics"],
            ("position", "pulses"),
        ),
    ),
}  # fmt: skip
"""Every fault by name."""
