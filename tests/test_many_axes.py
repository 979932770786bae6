"""A chip of eight axes: on its own, on a stage, in recordings and programs. Nothing in PulseStage says how many a chip may have."""

import numpy as np
import pytest
from support.many_axes import rail_model
from toy import TOY8

from stage import Fleet, Program, Stage, firmware


@pytest.fixture(scope="module")
def eight():
    return Stage(rail_model(8), chips=TOY8)


def test_the_axes_of_a_bare_chip_make_separate_pulses():
    chip = TOY8()
    for j in range(8):
        for name, value in (("RATE", 1000 * (j + 1)), ("COUNT", 10 + j)):
            for cycle in chip.register_cycles(name, value, j):
                chip.write(*cycle)
        chip.write(0, chip.MAP.command(f"{'MINUS' if j % 2 else 'PLUS'}{j}").code)
    pulses = chip.trace(100_000)
    assert [int((pulses["axis"] == j).sum()) for j in range(8)] == [10 + j for j in range(8)]
    assert [chip.net(j) for j in range(8)] == [-(10 + j) if j % 2 else 10 + j for j in range(8)]
    assert (np.diff(pulses["clock"]) >= 0).all()


def test_it_moves_the_eight_axes_of_a_stage(eight, tmp_path):
    assert len(eight.chips) == 1
    with eight.record() as recording:
        for k, axis in enumerate(eight.axes.values()):
            assert firmware.move(axis, pulses=50 + k).ok
            assert axis.position == pytest.approx((50 + k) * axis.meters_per_pulse, abs=20e-6)
    assert [recording.columns[f"a{k}/pulses"][-1] for k in range(8)] == [50 + k for k in range(8)]
    recording.to_vcd(tmp_path / "eight.vcd")
    recording.save(tmp_path / "eight.rrd")


def test_its_snapshots_and_programs_are_of_all_axes(eight):
    eight.reset()
    before = eight.snapshot()
    program = Program()
    for k, axis in enumerate(eight.axes.values()):
        program.register(k, axis.chip, "RATE", 2000, k).register(k, axis.chip, "COUNT", 20 + k, k)
        program.command(k, axis.chip.MAP.command(f"PLUS{k}").code)
    Fleet([eight], 1).play([program.until_stopped(range(8), 1.0)])
    places = [axis.position for axis in eight.axes.values()]
    assert [eight.chips[0].net(k) for k in range(8)] == [20 + k for k in range(8)]
    eight.restore(before)
    Fleet([eight], 1).play([program])
    assert [axis.position for axis in eight.axes.values()] == places
