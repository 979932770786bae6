"""NOVA: page 193 of the MCX514's manual; the failure notice of MCX302, MCX304 and MCX312."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from stage.chips import MCX304, MCX514
from stage.chips.nova import Nova
from stage.firmware import Bench
from stage.firmware.nova.chip_port import ChipPort
from worked_examples.table import example, write_registers

mcx514 = partial(example, "MCX514")
notice = partial(example, "MCX302, 304, 312 notice")
SPEEDS = {"SV": 1000, "DV": 10_000, "AC": 100_000, "TP": 0}


def make_port(chip: type[Nova], **values: int) -> ChipPort:
    """Return the port of a fresh chip, with registers loaded by name."""
    axis_port = ChipPort(Bench(chip()).axes["x"])
    axis_port.write_parameters(**values)
    return axis_port


def measure_drive(p: ChipPort, command: str, seconds: float = 5) -> int:
    """Run a drive command until the axis stops, and return the change of LP in pulses."""
    before = p.read_position()
    p.write_command(command)
    p.wait_until_stopped(seconds)
    return p.read_position() - before


MOVES = (
    ("relative drive, TP = 500: LP changes by", 500, {"TP": 500}, "DRVRL"),
    ("relative drive, TP = -500: LP changes by", -500, {"TP": -500}, "DRVRL"),
    ("counter relative drive, TP = 500: LP changes by", -500, {"TP": 500}, "DRVNR"),
    ("absolute drive to TP = 500 from LP = 2000: LP changes by", -1500, {"TP": 500, "LP": 2000}, "DRVAB"),
)
for says, pulses, values, command in MOVES:
    mcx514("7.2.7", says, pulses, "pulses")(
        lambda values=values, command=command: measure_drive(make_port(MCX514, **SPEEDS | values), command)
    )


@mcx514("7.2.7", "relative drive of 5000, TP = 200 written after 300: pulses made after it", 0)
def _passed() -> int:
    p = make_port(MCX514, **SPEEDS | {"TP": 5000})
    p.write_command("DRVRL")
    while p.read_position() < 300:
        p.axis.wait(1e-4)
    pulses_before = p.read_position()
    p.write_parameters(TP=200)
    p.wait_until_stopped(5)
    return p.read_position() - pulses_before


@mcx514("7.2.7", "drives of TP = 2,147,483,646 and of the next number: the largest without a diagnostic", 2_147_483_646)
def _largest() -> int:
    for value in (2_147_483_646, 2_147_483_647):
        chip = MCX514()
        write_registers(chip, **SPEEDS | {"TP": value})
        chip.write(0, 0x150)
        if chip.diagnostics:
            return value - 1
    return value


@mcx514(
    "7.2.8",
    "manual deceleration, TP = 2000, DP = 1500: pulses when it begins",
    1500,
    "pulses",
    1,
    "the look after a pulse",
)
def _manual() -> int:
    p = make_port(MCX514, **SPEEDS | {"TP": 2000, "DP": 1500})
    p.write_mode_words(WR3=p.map.mask("WR3", "MANLD"))
    p.write_command("DRVRL")
    while not p.axis.pins.dsnd:
        p.axis.wait(2e-5)
    return p.read_position()


FAST = {"R": 800_000, "K": 20_000, "A": 8000, "SV": 400, "V": 2000, "AO": 0}
STOP0, LIMIT, SOFT, S_CURVE = (
    MCX304.MAP.mask(word, name)
    for word, name in (("WR1", "SP0-E"), ("WR2", "LMTMD"), ("WR2", "SLMT+"), ("WR3", "SACC"))
)


def is_driving_after(act: Callable[[ChipPort], None], wr2: int = 0, wr3: int = S_CURVE, start: str = "F_DRV_P") -> int:
    """Return n-DRV of an MCX304 two seconds after an action at the end of a deceleration, in area d of the notice's figure 3.

    Args:
        act: Action on the port.
        wr2: Value of WR2.
        wr3: Value of WR3.
        start: Symbol of the drive command.
    """
    p = make_port(MCX304, **FAST, P=40_000, CP=1_000_000)
    p.write_mode_words(WR1=STOP0, WR2=wr2, WR3=wr3)
    p.write_command(start)
    if start == "F_DRV_P":
        for phase in (False, True):  # until it decelerates, and until it does so no more
            while bool(p.read_status_register(1) & p.map.mask("RR1", "DSND")) is phase:
                p.axis.wait(5e-4)
        p.axis.wait(2e-6 * FAST["K"] / 2)  # area d lasts 2 K us
    else:
        p.axis.wait(2)
    act(p)
    p.axis.wait(2)
    return int(p.is_driving())


def make_pin_action(name: str) -> Callable[[ChipPort], None]:
    """Return an action that asserts an input of the axis."""
    return lambda p: setattr(p.axis.pins, name, True)


def make_command_action(symbol: str) -> Callable[[ChipPort], None]:
    """Return an action that writes a command."""
    return lambda p: p.write_command(symbol)


def set_soft_limit(p: ChipPort) -> None:
    """Set the software limit COMP+ to the present position."""
    p.write_parameters(CP=p.read_position() - 1)


notice("case 1", "26h in area d of an S-curve with fixed pulses: n-DRV 2 s later", 1)(
    lambda: is_driving_after(make_command_action("STOP_DEC"))
)
notice("case 2", "LMT+ in decelerating mode, there", 1)(
    lambda: is_driving_after(make_pin_action("lmt_plus"), wr2=LIMIT)
)
notice("case 3", "the software limit, there", 1)(lambda: is_driving_after(set_soft_limit, wr2=SOFT))
notice("case 4", "STOP0, there", 1)(lambda: is_driving_after(make_pin_action("stop0")))
notice("symptom", "27h, there", 0)(lambda: is_driving_after(make_command_action("STOP_SUDDEN")))
notice("symptom", "LMT+ in sudden mode, there", 0)(lambda: is_driving_after(make_pin_action("lmt_plus")))
notice("symptom", "26h at the end of a linear ramp", 0)(
    lambda: is_driving_after(make_command_action("STOP_DEC"), wr3=0)
)
notice("symptom", "26h in a continuous drive with S-curves", 0)(
    lambda: is_driving_after(make_command_action("STOP_DEC"), start="C_DRV_P")
)
