"""Speed, as ratios measured in one run: pairs interleaved, medians with spread.

make bench        or: python scripts/benchmark.py [--rounds N] [--json FILE]
"""

import argparse
import json
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

from stage import Stage
from stage.chips import PCL240K, PCL240MS
from stage.firmware import Bench, Port, Profile

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from programs import load_registers
from reference.pcl240 import ReferencePCL240K

STEPS = 4000
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def timed(work):
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def moving_stage():
    """Three chips that keep three motors running for as long as the benchmark needs."""
    stage = Stage("xyz", chips=PCL240K)
    for axis in stage.axes.values():
        load_registers(axis.chip, R0=0, R1=25, R2=100, R3=100, R4=1500, R5=1500, R6=0, R7=30)
        for command in (0x08, 0x40, 0x15):
            axis.chip.write(0, command)
    stage.run(0.3)
    return stage


def closed_loop(rounds):
    """Steps per second of the whole stage, with and without recording, beside mj_step on the same model and state."""
    stage, bare = moving_stage(), []
    closed, recorded = [], []
    start = stage.snapshot()
    data = mujoco.MjData(stage.model)
    with stage.record() as recording:  # the mean torque of the run keeps the bare carriages moving alike
        stage.step(STEPS)
    torque = [recording.columns[f"{name}/torque"].mean() for name in stage.axes]
    for _ in range(rounds):
        stage.restore(start)
        closed.append(timed(lambda: stage.step(STEPS)))
        mujoco.mj_setState(stage.model, data, start.state, STATE)
        data.ctrl[:] = torque
        bare.append(timed(lambda: mujoco.mj_step(stage.model, data, STEPS)))
        stage.restore(start)
        with stage.record():
            recorded.append(timed(lambda: stage.step(STEPS)))
    return np.array(bare), np.array(closed), np.array(recorded)


def running_chip(r4=300):
    chip = PCL240K()
    load_registers(chip, R0=0xFFFFFF, R1=50, R2=8000, R3=50, R4=r4, R5=r4, R6=0, R7=2)
    chip.write(0, 0x40)
    chip.write(0, 0x11)
    return chip


def ramping_chip():
    """The fastest ramp there is, up and down for ever: every second clock a speed step."""
    chip = running_chip(2)
    chip.write(0, 0x08)
    chip.write(0, 0x15)
    return chip


def ramps_of(spans):
    """Work: a chip that ramps up and down twenty times, 7950 speed steps each way; its profile's `spans`."""
    chip = PCL240MS()
    port = Port(Bench(x=chip).axes["x"])
    profile = Profile(50, 8000, 8000, 3, 3, 2, spans=spans, chip=PCL240MS)
    port.write_registers(**profile.registers(), R0=0xFFFFFF)
    for command in (0x08, 0x40, 0x15):
        port.command(command)

    def work():
        for _ in range(20):
            port.axis.wait(60_000 / chip.clock_hz)
            port.command(0x14)
            port.axis.wait(60_000 / chip.clock_hz)
            port.command(0x15)

    return work


def s_curve_in_the_engine(rounds):
    """Seconds for half a second of three axes ramping up and down: with S-curves, and with linear ramps."""
    stage, seconds = Stage("xyz", chips=PCL240MS), {(0, 0): [], None: []}
    for _ in range(rounds):
        for spans, times in seconds.items():
            stage.reset()
            profile = Profile(500, 4000, 4000, 400, 400, 100, spans=spans, chip=PCL240MS)
            ports = [Port(axis) for axis in stage.axes.values()]
            for port in ports:
                port.command(0x08)
                port.write_registers(**profile.registers())
                port.command(0x40)
                port.command(0x15)

            def work(ports=ports):
                stage.run(0.29)
                for port in ports:
                    port.command(0x14)
                stage.run(0.29)

            times.append(timed(work))
    return np.array(seconds[0, 0]), np.array(seconds[None])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = {}

    def row(name, values, unit):
        values = np.asarray(values, float)
        rows[name] = {"median": float(np.median(values)), "min": values.min(), "max": values.max(), "unit": unit}
        print(f"{name:58}{np.median(values):>14,.4g}  {unit:16} {values.min():.4g} .. {values.max():.4g}", flush=True)

    bare, closed, recorded = closed_loop(args.rounds)
    row("closed loop / bare mj_step, throughput", bare / closed, "ratio")
    row("the same with recording every ms", bare / recorded, "ratio")
    row("closed loop, steps", STEPS / closed, "steps/s")

    clocks = 10_000_000_000
    chip, reference = running_chip(), ReferencePCL240K()
    for address, value in [(0, 0x81), (1, 50), (0, 0x87), (1, 2), (0, 0x40), (0, 0x10)]:
        reference.write(address, value)
    fast = [timed(lambda: chip.advance(clocks)) for _ in range(args.rounds)]
    slow = [timed(lambda: [reference.tick() for _ in range(20_000)]) for _ in range(3)]
    row("chip at constant speed", clocks / np.array(fast), "clocks/s")
    row("  beside the tick reference", clocks / np.array(fast) / (20_000 / np.median(slow)), "times")
    ramp = []
    for _ in range(args.rounds):
        chip = ramping_chip()
        ramp.append(timed(lambda c=chip: c.advance(2 * 7950)))
    row("chip on its fastest ramp (R4 = 2)", 2 * 7950 / np.array(ramp), "clocks/s")
    shapes = {spans: [] for spans in (None, (0, 0), (1000, 1000))}
    for _ in range(args.rounds):
        for spans, seconds in shapes.items():
            seconds.append(timed(ramps_of(spans)))
    for spans, name in (((0, 0), "S-curve"), ((1000, 1000), "S-curve with linear part")):
        row(f"{name} / linear ramp, time", np.array(shapes[spans]) / np.array(shapes[None]), "ratio")
    curved, linear = s_curve_in_the_engine(args.rounds)
    row("S-curve move / linear move in the engine, time", curved / linear, "ratio")
    traced = []
    for _ in range(args.rounds):
        chip = running_chip()
        traced.append(timed(lambda c=chip: c.trace(16384 * 1000)))
    row("traced pulses", 8_000_000 / np.array(traced), "pulses/s")
    axis = moving_stage().axes["x"]
    row("bus cycles from Python, on a stage", 20_000 / np.array(
        [timed(lambda: [axis.chip.read(0) for _ in range(20_000)]) for _ in range(args.rounds)]), "cycles/s")  # fmt: skip
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
