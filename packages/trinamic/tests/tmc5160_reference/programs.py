"""Random programs for a TMC5160 as data: lists of (clock, kind, args) that any chip can play.

    program = random_program(seed)          the same seed, the same program, on every Python
    answers = play(chip, program, clocks)   chip: advance, write, read, transfer, set_pin, set_load

Kinds and args: "write" (address, value); "read" (address,); "transfer" (datagram of 40 bits,); "pin" (name, level);
"load" (lam, emf). An event of clock c comes after clock c and before clock c + 1. Everything is chosen so that much
happens within 200,000 clocks: ramps of some ten thousand clocks, hundreds of steps, targets a few hundred steps away.
"""

import random

from tmc5160_reference.registers import ADDRESS, TABLE

CLOCKS = 200_000
PINS = ("REFL_STEP", "REFR_DIR", "ENCA_DCIN_CFG5", "ENCB_DCEN_CFG4", "ENCN_DCO_CFG6", "DRV_ENN")
READABLE = [address for address, _, access, *_ in TABLE if access != "W"]
WATCHED = [ADDRESS[name] for name in "XACTUAL VACTUAL RAMP_STAT TSTEP DRV_STATUS XLATCH X_ENC MSCNT".split()]
POSITION, PLUS, MINUS, HOLD = range(4)


def build_write(name, value):
    return "write", (ADDRESS[name], value & 0xFFFFFFFF)


def draw_speed(rng, limit=1 << 18):
    """Draw a speed evenly over the octaves from 2^13 on: 2048 clocks a step at the slowest."""
    return min(int(2 ** rng.uniform(13, 20)), limit - 1)


def draw_rate(rng):
    return int(2 ** rng.uniform(12.5, 16)) - 1


def draw_target(rng):
    return rng.choice((rng.randint(-9, 9), rng.randint(-200, 200), rng.randint(-200, 200), rng.randint(-800, 800)))


def draw_setup(rng):
    """Draw the writes before clock 1: driver, ramp, switches."""
    v1 = rng.choice((0, draw_speed(rng, 1 << 20)))
    return [
        build_write("CHOPCONF", rng.choice((0x10000003, 0x10000003, 0x18000003, 0x12000003, 0x100C0003, 0x10000000))),
        build_write("GCONF", rng.choice((0x0, 0x0, 0x4, 0x14, 0x4004, 0x8000))),
        build_write("IHOLD_IRUN", rng.randint(0, 31) | rng.randint(0, 31) << 8 | rng.choice((0, 1)) << 16),
        build_write("TPOWERDOWN", rng.choice((0, 0, 1))),
        *draw_thresholds(rng),
        build_write("COOLCONF", draw_coolconf(rng)),
        build_write("VSTART", rng.choice((0, draw_speed(rng)))),
        build_write("A1", draw_rate(rng)), build_write("V1", v1), build_write("AMAX", draw_rate(rng)),
        build_write("VMAX", draw_speed(rng, 1 << 23)),
        build_write("DMAX", draw_rate(rng)), build_write("D1", draw_rate(rng)), build_write("VSTOP", draw_speed(rng)),
        build_write("TZEROWAIT", rng.choice((0, 0, rng.randint(1, 20)))),
        build_write("SW_MODE", rng.choice((0x000, 0x003, 0x0A3, 0x803, 0x9E3, 0x413, 0x66F))),
        build_write("RAMPMODE", rng.choice((POSITION, POSITION, POSITION, PLUS, MINUS))),
        build_write("XTARGET", draw_target(rng)),
    ]  # fmt: skip


def draw_thresholds(rng):
    """Draw thresholds around the TSTEPs of these speeds, 16 to 2048; 0 is off."""
    return [
        build_write(name, rng.choice((0, int(2 ** rng.uniform(4, 12))))) for name in ("TPWMTHRS", "TCOOLTHRS", "THIGH")
    ]


def draw_coolconf(rng):
    return (
        rng.choice((0, rng.randint(1, 15))) | rng.randint(0, 3) << 5 | rng.randint(0, 15) << 8
        | rng.choice((0, 1)) << 24 | rng.randint(1, 3) << 13 | rng.choice((0, 1)) << 15 | rng.choice((0, 0, 5, 120)) << 16
    )  # fmt: skip


def draw_change(rng):
    """Draw one action of a host, a switch or a load: a list of (kind, args)."""
    kind = rng.choice(CHANGES)
    if kind == "target":
        return [build_write("XTARGET", draw_target(rng))]
    if kind == "position":
        return [build_write("XACTUAL", draw_target(rng))]
    if kind == "mode":
        return [build_write("RAMPMODE", rng.choice((POSITION, POSITION, PLUS, MINUS, HOLD)))]
    if kind == "speed":
        return [
            build_write(
                "VMAX", rng.choice((0, draw_speed(rng, 1 << 23), draw_speed(rng, 1 << 23), draw_speed(rng, 1 << 23)))
            )
        ]
    if kind == "ramp":
        name = rng.choice(("A1", "AMAX", "DMAX", "D1", "VSTART", "VSTOP", "V1"))
        limit = {"V1": 1 << 20}.get(name, 1 << 18)
        return [
            build_write(
                name,
                draw_speed(rng, limit) if name.startswith("V") else rng.choice((0, draw_rate(rng), draw_rate(rng))),
            )
        ]
    if kind == "switch":
        return [("pin", (rng.choice(PINS[:2]), rng.random() < 0.35))]
    if kind == "switch mode":
        return [build_write("SW_MODE", rng.randrange(1 << 12))]
    if kind == "encoder":
        return [("pin", (rng.choice(PINS[2:5]), rng.choice((True, False))))]
    if kind == "encoder set-up":
        return [
            build_write("ENCMODE", rng.randrange(1 << 11)), build_write("ENC_DEVIATION", rng.choice((0, 100))),
            build_write("ENC_CONST", rng.choice((0x10000, 0x003307D0, 0xFFE60FA0, rng.randrange(1 << 32)))),
        ]  # fmt: skip
    if kind == "flags":
        return [build_write(rng.choice(("RAMP_STAT", "GSTAT", "ENC_STATUS")), rng.choice((0xFFFF, 0x80, 0x40, 0x100C)))]
    if kind == "load":
        return [("load", (rng.choice((0, rng.randint(0, 1024), 1024)), rng.randint(0, 1024)))]
    if kind == "driver":
        return rng.choice((
            [("pin", ("DRV_ENN", rng.choice((True, False, False))))],
            [build_write("IHOLD_IRUN", rng.randrange(1 << 17))],
            [build_write("COOLCONF", draw_coolconf(rng))],
            [build_write("GCONF", rng.choice((0, 4, 2, 0x10, 0x4004)))],
            draw_thresholds(rng),
        ))  # fmt: skip
    if kind == "transfer":
        return [("transfer", (rng.choice(READABLE) << 32 | rng.randrange(1 << 32),))]
    return [("read", (rng.choice(READABLE),))]


CHANGES = (
    *("target speed ramp switch load".split() * 3), *("mode transfer read driver flags".split() * 2),
    "position", "switch mode", "encoder", "encoder", "encoder set-up",
)  # fmt: skip


def random_program(seed, clocks=CLOCKS, changes=40):
    """Draw a program [(clock, kind, args), ...] in order of time; its setup comes at clock 0."""
    rng = random.Random(f"tmc5160 {seed}")
    program = [(0, *event) for event in draw_setup(rng)]
    for clock in sorted(rng.randrange(clocks) for _ in range(changes)):
        program += [(clock, *event) for event in draw_change(rng)]
        if rng.random() < 0.5:  # look while things move; some looks come in the very same place between two clocks
            later = min(clock + rng.choice((0, 1, 2, 1000)), clocks - 1)
            program += [(later, "read", (address,)) for address in WATCHED]
    return sorted(program, key=lambda event: event[0])  # stable: events of one clock keep their order


def play(chip, program, clocks=CLOCKS):
    """Play a program on a fresh chip and return its reads: (clock, kind, args, answer) each."""
    now, answers = 0, []
    for clock, kind, args in program:
        if clock > now:
            chip.advance(clock - now)
            now = clock
        method = {"pin": "set_pin", "load": "set_load"}.get(kind, kind)
        answer = getattr(chip, method)(*args)
        if kind in ("read", "transfer"):
            answers.append((clock, kind, args, answer))
    chip.advance(clocks - now)
    return answers
