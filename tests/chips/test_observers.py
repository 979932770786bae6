"""Whoever looks at a chip changes nothing: neither a bit of its snapshots nor what it does afterwards."""

import contextlib
import random

import pytest
from support.examples import SEED, scaled

from stage import Stage
from stage.chips import CHIPS

CHIP_OBSERVERS = {
    "values": lambda chip, axis: chip.values(),
    "values_of": lambda chip, axis: chip.axis_values(axis),
    "dump": lambda chip, axis: chip.dump(),
    "repr": lambda chip, axis: repr(chip),
    "pins": lambda chip, axis: chip.axes[axis].pins.as_dict(),
    "pins of the chip": lambda chip, axis: chip.pins.as_dict() if hasattr(chip, "pins") else repr(chip.axes[0].pins),
    "input word": lambda chip, axis: chip.input_word(axis),
    "output word": lambda chip, axis: chip.output_word(axis),
    "net": lambda chip, axis: chip.net(axis),
    "shaft": lambda chip, axis: chip.get_shaft(axis) if chip.ENCODERS or chip.SERVO else None,
    "lint": lambda chip, axis: [
        list(chip.lint(k, v)) for k in range(chip.ADDRESSES) for v in (0, 0x150, chip.DATA_MASK)
    ],
    "tried start": lambda chip, axis: chip.would_start_drive(0, 0x150, axis),
    "listener": lambda chip, axis: chip.make_describer(),
    "decoder": lambda chip, axis: chip.decoder(axis),
    "diagnostics": lambda chip, axis: list(chip.diagnostics),
    "twin": lambda chip, axis: chip.make_replica().advance(10_000),
    "snapshot": lambda chip, axis: chip.snapshot(),
    "core": lambda chip, axis: [
        getattr(chip.CORE, name).with_gil(chip.pointer, axis) for name in ("read_counter", "read_status", "is_busy")
    ],
    "peek": lambda chip, axis: [chip.CORE.peek.with_gil(chip.pointer, k) for k in range(chip.ADDRESSES)],
}
STARTS = (0x15, 0x10, 0x151, 0x152, 0x120, 0x121, 0x122, 0x161, 0x173, 0x175)
"""Start commands of the families, among the random words."""


def act(chip, rng):
    """Make one random change of a chip, as a host or a machine would."""
    axis, what = rng.randrange(chip.AXES), rng.randrange(10)
    if what < 4:
        likely = rng.random() < 0.5
        address, value = rng.randrange(chip.ADDRESSES), rng.randrange(chip.DATA_MASK + 1) >> rng.randrange(9)
        chip.write(0 if likely else address, rng.choice(STARTS) if likely else value)
    elif what < 5:
        chip.read(rng.randrange(chip.ADDRESSES))
    elif what < 7 and (chip.ENCODERS or chip.SERVO):
        chip.set_shaft(rng.uniform(-50, 50), rng.choice((0.0, 0.25, rng.uniform(-1.5, 1.5))), axis)
    elif what < 8:
        with contextlib.suppress(Exception):  # pins of an encoder are driven by its shaft
            setattr(chip.axes[axis].pins, rng.choice(list(chip.INPUTS)), rng.random() < 0.5)
    else:
        chip.advance(rng.randrange(1, 3_000))


def observe(chip, rng):
    """Call each observer, in random order."""
    for name in rng.sample(sorted(CHIP_OBSERVERS), len(CHIP_OBSERVERS)):
        before = chip.snapshot()
        CHIP_OBSERVERS[name](chip, rng.randrange(chip.AXES))
        assert chip.snapshot().record == before.record, f"{name} of {type(chip).__name__} changes the state"


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_observing_a_chip_leaves_its_bits_as_they_were_and_what_it_does_the_same(name):
    """values(), dump(), pins ... of a chip whose shaft turns: the next snapshot differed"""
    for seed in range(SEED, SEED + scaled(6)):
        print("PULSESTAGE_SEED", seed)
        observed, alone = CHIPS[name](), CHIPS[name]()
        acts, samples = random.Random(seed), random.Random(seed + 1)
        for chip in (observed, alone):
            acts.seed(seed)
            for _ in range(60):
                act(chip, acts)
                if chip is observed and samples.random() < 0.3:
                    observe(chip, samples)
        assert observed.snapshot().record == alone.snapshot().record
        assert observed.diagnostics == alone.diagnostics


@pytest.mark.parametrize("name", ["MCX514", "MCX512", "MCX304", "MCX314AS", "PCL240MS", "HCTL1100"])
def test_observing_a_stage_leaves_its_bits_as_they_were(name):
    """repr, _repr_html_, positions, switches and the chips' values between runs of a stage whose shafts turn"""
    options = {} if CHIPS[name].SERVO or not CHIPS[name].ENCODERS else {"encoders": {"x": 200_000, "y": -12_345}}
    observed, alone = (Stage("xy", chips=CHIPS[name], visuals=False, **options) for _ in range(2))
    for k in range(6):
        for stage in (observed, alone):
            stage.data.qvel[:] = 0.1 - 0.03 * k  # pushed
            stage.run(0.0013)
        before = observed.snapshot()
        repr(observed), observed._repr_html_(), observed.faults, observed.payload(), observed.time
        for axis in observed.axes.values():
            repr(axis), axis.position, axis.commanded, axis.lost_steps, axis.switches.as_dict(), repr(axis.pins)
            observe(axis.chip, random.Random(k))
        for other in (observed, alone):
            assert other.snapshot().state.tobytes() == before.state.tobytes()
