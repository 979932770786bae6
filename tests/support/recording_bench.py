"""What the tests here share: a short program, a chip alone in a Recording, rows to feed it, and what reads files back."""

import subprocess
from types import SimpleNamespace

import mujoco
import numpy as np

from stage import Drive
from stage.chips import PCL240K
from stage.recording import Recording
from stage.recording.rerun_viewer import build_rerun_environment, find_rerun_executable
from support.programs import load_registers, start_preset

ONE_AXIS = """
<mujoco model="bench"><worldbody><body name="x"><joint name="x" type="slide" axis="1 0 0"/>
<geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>
"""


def drive(stage):
    """X runs into EL-, back off, then X and Y together; about a second."""
    x, y = stage.axes["x"], stage.axes["y"]
    touch = next(s.touch for s in x.plant.switches if s.pin == "el_minus")
    stage.place(x=touch + 0.002)
    load_registers(x.chip, R0=100_000, R1=75, R2=300, R4=300, R5=300, R6=0, R7=30)
    for command in (0x4C, 0x15):
        x.chip.write(0, command)
    stage.run_until(lambda: x.chip.pins.hold, timeout=2)
    start_preset(x.chip, 2000)
    start_preset(y.chip, 1500, minus=True)
    stage.run_until(lambda: x.chip.pins.hold and y.chip.pins.hold, timeout=2)
    stage.run(0.05)


def stage_of(model, axes):
    """Return what a recording needs of a stage: time that stands still, without chips that run."""
    return SimpleNamespace(
        model=model, axes=axes, recording=None, host=None, faults=(), now=0, time=0.0, lock=None,
        state=SimpleNamespace(dt=1_000_000), begin_recording=lambda recording, steps: None, stop_recording=lambda: None,
    )  # fmt: skip


def make_bench(axes=1, mjcf=ONE_AXIS):
    model = mujoco.MjModel.from_xml_string(mjcf)
    table = {
        name: SimpleNamespace(
            name=name, chip=PCL240K(), index=k, joint=0, gear=628.3, meters_per_pulse=3.125e-6, unit="m",
            chip_axis=0, drive=Drive(),
            switches=SimpleNamespace(as_dict=dict),
        )
        for k, name in enumerate("xyz"[:axes])
    }  # fmt: skip
    recording = Recording(stage_of(model, table))
    return SimpleNamespace(recording=recording, chip=table["x"].chip, axes=table, model=model)


def feed(recording, n, rng=None):
    """Feed n rows of a plausible motion into the buffers of a recording, as the engine does."""
    rows = len(recording.samples)
    done = 0
    while done < n:
        free = min(rows - recording.filled, n - done)
        rows_to_fill = slice(recording.filled, recording.filled + free)
        t = (len(recording) + 1 + np.arange(free)) * recording.every
        s = recording.samples[rows_to_fill]
        s["time"] = t[:, None]
        s["position"] = (0.1 * np.sin(t))[:, None]
        s["commanded"] = s["position"] + 1e-6 * np.cos(7 * t)[:, None]
        s["rate"] = np.abs(32_000 * np.cos(t))[:, None]
        s["counter"] = (1e6 - 32_000 * np.sin(t)).astype(int)[:, None]
        recording.positions[rows_to_fill] = 0.1 * np.sin(t)[:, None]
        recording.take_rows(recording.filled + free)
        done += free


def rerun_cli(*args):
    command = [find_rerun_executable(), *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=build_rerun_environment())


def read_rrd(path):
    """{entity: {component: (times ns, list of values)}}; static data have times None."""
    from rerun.chunk import RrdReader

    out = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        time = batch.column("time").to_numpy(zero_copy_only=False).astype(np.int64) if "time" in names else None
        entity = out.setdefault(chunk.entity_path, {})
        for name in names:
            if ":" in name:
                before = entity.get(name)
                values = batch.column(name).to_pylist()
                both = time is not None and before is not None
                entity[name] = (np.concatenate([before[0], time]), before[1] + values) if both else (time, values)
    return out


class Full:
    """A file on a full disk."""

    def seek(self, at): ...

    def write(self, rows):
        raise OSError(28, "No space left on device")
