"""Bus programs for the NOVA chips that several tests run; command codes come from the register maps."""

from stage.chips.nova import MCX514

HARDWARE_LIMITS = 0x0800  # WR2 of the MCX514; on the older chips they are always on


def command(chip, symbol, axes=1):
    chip.write(0, axes << 8 | chip.MAP.command(symbol).code)


def load(chip, axes=1, **values):
    """Parameters by name: WR6, WR7, then the command."""
    for name, value in values.items():
        chip.write(6, value & 0xFFFF)
        chip.write(7, value >> 16 & 0xFFFF)
        command(chip, name, axes)


def prepare(chip, axes=1):
    """A rate that every default axis follows, limits that stop at once: 500 to 10,000 pps (older chips: 8,000) in 0.15 s."""
    if isinstance(chip, MCX514):
        load(chip, axes, SV=500, DV=10_000, AC=63_000)
        chip.write(2, HARDWARE_LIMITS)
    else:
        load(chip, axes, R=8_000_000, SV=500, V=8000, A=400, AO=0)


def move(chip, pulses, axes=1):
    """A fixed-pulse drive at that rate."""
    prepare(chip, axes)
    if isinstance(chip, MCX514):
        load(chip, axes, TP=pulses)
        command(chip, "DRVRL", axes)
    else:
        load(chip, axes, P=abs(pulses))
        command(chip, "F_DRV_M" if pulses < 0 else "F_DRV_P", axes)


def run_on(chip, axes=1, minus=False):
    """A drive without an end, at that rate."""
    prepare(chip, axes)
    plus_minus = ("DRVVP", "DRVVM") if isinstance(chip, MCX514) else ("C_DRV_P", "C_DRV_M")
    command(chip, plus_minus[minus], axes)
