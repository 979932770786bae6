"""Options that several commands have, and the types of their values: 20000, 20000pps, 100ms, 24V, 0x300."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

from stage.units import OTHER_FACTORS, POSITION_FACTORS, explain_number_error, identify_unit, parse_quantity

PCL240_CHIP_NAMES = ("PCL240K", "PCL240MK", "PCL240MS")
DEFAULT_MICROSTEPS = 16
CHIP_NAMES = (
    *PCL240_CHIP_NAMES,
    "MCX514",
    "MCX512",
    "MCX501",
    "MCX314AS",
    "MCX304",
    "MCX302",
    "MCX312",
    "HCTL1100",
    "STEPDIR",
)


# --- types of values ---


class QuantityParser:
    """Parser of an option's value for argparse: a number with a unit of one kind, which is a key of OTHER_FACTORS.

    A number without unit is in SI units; a pulse rate without unit is in pps.
    """

    def __init__(self, kind: str, positive: bool = False):
        self.kind, self.units, self.positive = kind, OTHER_FACTORS[kind], positive

    def __call__(self, text: str) -> float:
        """Parse a number with or without a unit."""
        text = text.strip()
        value = parse_quantity(text, {"": 1.0} | self.units)
        if value is None:
            other = identify_unit(text)
            hint = f" {other[0]} is a unit of {other[1]}." if other else explain_number_error(text)
            raise argparse.ArgumentTypeError(
                f"{text!r} is not a {self.kind}.{hint} Give a number, alone or with a unit: {', '.join(self.units)}."
            )
        if self.positive and not 0 < value < math.inf:
            raise argparse.ArgumentTypeError(f"{text} must be greater than 0, and finite")
        return value


class IntegerQuantityParser(QuantityParser):
    """Parser of an option's value for argparse: an integer with a unit; it may also be written as 0x300."""

    def __call__(self, text: str) -> int:
        """Parse a whole number with or without a unit."""
        try:
            return int(text, 0)
        except ValueError:
            value = super().__call__(text)
        if not math.isfinite(value) or value != round(value):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
        return round(value)


class SpeedOfCarriage(NamedTuple):
    """Speed that a user has typed in a unit of length or angle, for example 50mm/s. Only an axis can convert it to pulses.

    Attributes:
        value: Speed, m/s or rad/s.
        unit: SI unit of the distance, "m" or "rad".
        symbol: Unit that the user has typed, for example "mm/s".
        text: What the user has typed.
    """

    value: float
    unit: str
    symbol: str
    text: str


class RateParser(QuantityParser):
    """Parser of an option's value for argparse: a pulse rate such as 20kpps, or a speed of the carriage such as 50mm/s."""

    def __call__(self, text: str) -> Any:
        """Parse a rate, and return it in pps, or a SpeedOfCarriage."""
        distance, slash, second = text.strip().partition("/")
        if not (slash and second in ("s", "min")):
            return super().__call__(text)
        for unit, factors in POSITION_FACTORS.items():
            value = parse_quantity(distance, factors)
            if value is not None:
                if not 0 < value < math.inf:
                    raise argparse.ArgumentTypeError(f"{text} must be greater than 0, and finite")
                symbol = next(u for u in sorted(factors, key=len, reverse=True) if distance.endswith(u))
                return SpeedOfCarriage(value / OTHER_FACTORS["time"][second], unit, f"{symbol}/{second}", text.strip())
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a speed. Give a pulse rate in pps, or a speed of the carriage: 50mm/s, 3000mm/min, 30deg/s."
        )


RATE, DURATION = RateParser("pulse rate", positive=True), QuantityParser("time", positive=True)
TIME, VOLTAGE, MASS, FREQUENCY = map(QuantityParser, ("time", "voltage", "mass", "frequency"))
INTEGER_FREQUENCY = IntegerQuantityParser("frequency")


def parse_integer(text: str) -> int:
    """Parse an integer, decimal or as 0x300."""
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, such as 768 or 0x300") from None


def parse_microsteps(text: str) -> int | str:
    """Parse microsteps per full step, for all axes as an integer; those of single axes, x=16,y=8, stay a text."""
    try:
        for value in text.split(",") if "=" in text else [text]:
            int(value.rpartition("=")[2])
    except ValueError:
        raise argparse.ArgumentTypeError(f"invalid int value: {text!r}") from None
    return text if "=" in text else int(text)


def parse_positive_integer(text: str) -> int:
    """Parse an integer of at least 1."""
    if (value := parse_integer(text)) < 1:
        raise argparse.ArgumentTypeError(f"{text} must be 1 or more")
    return value


def parse_port(text: str) -> int:
    """Parse a TCP port."""
    value = parse_integer(text)
    if not 0 <= value < 1 << 16:
        raise argparse.ArgumentTypeError(f"{text}: a TCP port is 0 (one that is free) to 65535")
    return value


class ExplicitValueAction(argparse.Action):
    """Action of an option that stores its value, and in NAME_given that the user has given the option."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        """Store the value of an option."""
        setattr(namespace, self.dest, values)
        setattr(namespace, f"{self.dest}_given", True)


# --- groups of options ---


def add_stage_and_output_options(parser: argparse.ArgumentParser, chips: Sequence[str] = CHIP_NAMES) -> None:
    """Add --model, the options of a stage, and the options of its recordings."""
    group = parser.add_argument_group("stage")
    group.add_argument("--model", default="xyz", help=format_model_help()).known = list_models()  # type: ignore[attr-defined]
    add_stage_options(group, chips)
    group = parser.add_argument_group("output")
    group.add_argument("--record", metavar="FILE.rrd", help="write a rerun recording")
    group.add_argument(
        "--picture", metavar="FILE.png", help="render the dashboard of the recording to a file; needs no screen"
    )
    group.add_argument("--vcd", metavar="FILE.vcd", help="write waveforms for GTKWave")
    add_force_option(group)
    group.add_argument("--view", action="store_true", help="open the recording in the rerun viewer")
    group.add_argument("--web", action="store_true", help="serve the dashboard to a browser, on 127.0.0.1 only")
    group.add_argument(
        "--port", type=parse_port, default=9090, action=ExplicitValueAction, help="port for --web (default: 9090)"
    )


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """Add the optional argument MODEL."""
    parser.add_argument("model", nargs="?", default="xyz", help=format_model_help()).known = list_models()  # type: ignore[attr-defined]


def list_models() -> list[str]:
    """Return the names of the models that come with PulseStage."""
    return import_module("stage.models").names()


def format_model_help() -> str:
    """Return the help text of an option for a model."""
    return f"a model of PulseStage ({', '.join(list_models())}) or an MJCF file (default: xyz)"


def add_stage_options(group: Any, chips: Sequence[str] = CHIP_NAMES) -> None:
    """Add the options that describe a stage, except its model."""
    others = "; or one of another package, see `stage chips`; or x=CHIP,y=CHIP" if chips is CHIP_NAMES else ""
    choices = f"chip of every axis: {', '.join(chips)}{others} (default: %(default)s)"
    group.add_argument("--chips", default=chips[0], help=choices).known = chips
    group.add_argument(
        "--motor", help="motor of every axis, see `stage list motors` (default: 17HS4401); or x=MOTOR,y=MOTOR"
    )
    group.add_argument(
        "--drive",
        metavar="POWER_STAGE",
        help="power stage of every axis, see `stage list power-stages` (default: ideal); or x=POWER_STAGE,y=POWER_STAGE",
    )
    group.add_argument(
        "--microsteps",
        type=parse_microsteps,
        default=DEFAULT_MICROSTEPS,
        help="microsteps per full step (default: 16); or x=16,y=8",
    )
    group.add_argument(
        "--bus-voltage", type=VOLTAGE, default=24.0, help="supply voltage of the drives in V (default: 24)"
    )
    group.add_argument("--bus-cycle", type=TIME, default=1e-6, help="duration of a bus cycle in s (default: 1e-6)")
    group.add_argument(
        "--wiring", action="append", default=[], metavar="AXIS.SENSOR=LOGIC",
        help="logic of a sensor if it is not negative: x.org=positive is high while ORG is on; ez is the index of the encoder",
    )  # fmt: skip
    group.add_argument(
        "--multichip", metavar="AXIS,AXIS",
        help="connect the multichip lines of MCX514 and MCX512 chips: an axis of each chip, x,z (see docs/nova.md)",
    )  # fmt: skip
    group.add_argument(
        "--syni", action="append", default=[], metavar="FOLLOWER=LEADER",
        help="connect SYNI of an axis' chip (PCL-240 family) to SYNO of another one: y=x, or y=x,z=x",
    )  # fmt: skip


def add_force_option(parser: Any) -> None:
    """Add --force."""
    parser.add_argument("--force", action="store_true", help="overwrite files that exist")


def add_plot_option(parser: Any) -> None:
    """Add --plot."""
    parser.add_argument("--plot", metavar="FILE.png", help="draw a diagram")


def add_start_option(parser: Any) -> None:
    """Add --from, the position at which an axis starts."""
    parser.add_argument(
        "--from", dest="start", metavar="PLACE",
        help="position at which the carriage starts: 20mm, 30deg; without a unit mm, degrees on a hinge (default: 0)",
    )  # fmt: skip


def add_speed_options(parser: argparse.ArgumentParser, ramp_end: str = "the speed of the move") -> None:
    """Add the options of speeds and ramp times. `ramp_end` names the speed at which the ramp up ends, for the help."""
    group = parser.add_argument_group(
        "speeds (20000 or 20kpps: pulses per second; 50mm/s, 30deg/s: of the carriage; the chip makes the nearest that its "
        "registers allow)"
    )
    group.add_argument("--fl", type=RATE, help="FL: speed at the start and at the stop")
    group.add_argument("--speed", dest="fh1", metavar="SPEED", type=RATE, help="speed of the move, with any chip")
    group.add_argument("--fh1", type=RATE, help="FH1: the same as --speed")
    group.add_argument("--fh2", type=RATE, help="FH2: second speed (PCL-240 family; default: twice FH1)")
    group.add_argument("--accel", type=DURATION, help=f"seconds from FL to {ramp_end} (default: 0.15, to FH2)")
    group.add_argument("--decel", type=DURATION, help=f"seconds from {ramp_end} to FL (default: the same as --accel)")


def add_ramp_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the ramps' shape."""
    group = parser.add_argument_group("ramps")
    group.add_argument(
        "--s-curve", nargs="?", type=float, const=True, default=False, metavar="SHARE",
        help="S-curves; SHARE (above 0, up to 0.5) is the part of the ramp that is curved at each end (needs PCL240MS)",
    )  # fmt: skip
    group.add_argument(
        "--automatic", action=argparse.BooleanOptionalAction,
        help="the chip finds the ramp-down point itself (PCL240MK, PCL240MS)",
    )  # fmt: skip


def add_board_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a board and of the devices on its bus."""
    group = parser.add_argument_group("board")
    group.add_argument(
        "--layout",
        help="ports that reach the chips: pcl240, pcl240-card, nova, nova-8bit, hctl1100, or a file of your own, card.toml "
        "(default: the chip's); docs/layouts.md",
    )
    group.add_argument(
        "--base", type=parse_integer, help="first port of the first chip, such as 0x300 (default: the layout's)"
    )
    group.add_argument("--stride", type=parse_integer, help="ports from one chip to the next (default: the layout's)")
    group.add_argument(
        "--clock", type=INTEGER_FREQUENCY, metavar="HZ", help="reference clock of the chips (default: the data sheet's)"
    )
    group.add_argument("--trace", metavar="FILE.txt", help="write the bus cycles as text; - prints them")
    group.add_argument(
        "--keep", type=int, default=1_000_000, help="number of the latest bus cycles to keep (default: 1,000,000)"
    )
    group.add_argument(
        "--device", action="append", default=[], metavar="KIND:PORT",
        help="another device on the bus: hctl2000, hctl2016, hctl2020, ls7166 with the axis whose encoder it counts, "
        "hctl2016:0x320:x, and the counts of a turn of the motor if not 2000, ls7166:0x330:y:4000; uart:0x3F8; latch:0x378; a "
        "device of your own in C with its number of ports, adc.c:0x340+2",
    )  # fmt: skip
    group.add_argument(
        "--encoder", action="append", default=[], metavar="AXIS=COUNTS",
        help="an encoder for the chip's counter of the real position (RP or EP of the NOVA chips): counts per meter (rad on a "
        "hinge), x=200000, or per turn of the motor, x=2000/turn",
    )  # fmt: skip
    add_place_option(group)


def add_place_option(group: Any) -> None:
    """Add --place."""
    group.add_argument(
        "--place", action="append", default=[], metavar="AXIS=PLACE",
        help="position at which a carriage starts, such as x=62mm; without a unit mm, degrees on a hinge",
    )  # fmt: skip


def add_panel_options(parser: argparse.ArgumentParser) -> None:
    """Add --panel and its options, for a command that drives a stage."""
    group = parser.add_argument_group("panel")
    group.add_argument(
        "--panel", action="store_true",
        help="show a live page in real time; the command begins when a browser shows it, and the page stays at the end; "
        "docs/panel.md",
    )  # fmt: skip
    group.add_argument(
        "--panel-port", type=parse_port, default=7241, help="TCP port; 0 chooses a free one (default: 7241)"
    )
    add_live_page_options(group)


def add_live_page_options(group: Any) -> None:
    """Add the options that every live page has: --no-window and --pace."""
    add_no_window_option(group, "print the link instead of opening a browser", "--no-browser")
    group.add_argument(
        "--pace", type=float, default=1.0, help="simulated seconds per second, 0.001 to 1000 (default: 1)"
    )
    group.add_argument("--speed", dest="pace", type=float, default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def add_no_window_option(group: Any, help_: str, former_name: str) -> None:
    """Add --no-window, the same in every command that opens a window by itself. The former name works and is not listed."""
    group.add_argument("--no-window", action="store_true", help=help_)
    group.add_argument(
        former_name, dest="no_window", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS
    )
