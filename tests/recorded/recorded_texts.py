"""Texts and tools beside the command line: maps, boards and their traces, shapes of recordings, assertions, motors, refusals."""

import itertools
from functools import partial

import mujoco
import numpy as np
from recorded.player import Draw
from recorded.store import digits

from stage import Drive, Stage, faults
from stage.board import Board
from stage.board.layouts import LAYOUTS
from stage.chips import CHIPS, HCTL1100, MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.chips.hctl1100 import core as servo_core
from stage.chips.nova import core as nova_core
from stage.chips.pcl240 import core as pulse_core
from stage.drives import dynamometer
from stage.drives.dc_motors import DC_MOTORS
from stage.drives.motors import MOTORS
from stage.errors import StageError
from stage.recording import geoms
from stage.recording.thin import thin
from stage.sim import plant
from stage.testing import assertions
from stage.testing.path import assert_path_within


def tried(call, *given, **options):
    try:
        return call(*given, **options)
    except (StageError, AssertionError, TypeError, ValueError) as error:
        return f"{type(error).__name__}: {error}"


# --- register maps ---


def maps(name):
    """Every register and field at the ends of its range: the number, what it says, whether it is allowed."""
    map_ = CHIPS[name].MAP
    found = {}
    for r in map_.registers:
        words = (0, 1, r.mask // 2 - 1, r.mask // 2, r.mask // 2 + 1, r.mask - 1, r.mask, r.mask + 1)
        found[r.name] = [[r.value(w), r.allows(r.value(w))] for w in words] + [
            *r.range,
            r.writable,
            r.used,
            digits(r.text),
        ]
        found[f"{r.name} cycles"] = tried(CHIPS[name].register_cycles, r.name, r.range[1])
        found[f"{r.name} checked"] = [
            tried(map_.checked, r.name, v) for v in (r.range[0] - 1, r.range[1] + 1, r.range[0])
        ]
    for place in (*map_.registers, *map_.words):
        for f in place.fields:
            most = min(f.mask >> f.low, 40)
            found[f"{place.name} {f.name}"] = digits(
                repr([f.says(v) for v in range(most + 1)] + [f.text, f.bits, f.mask, f.of(0xAAAAAA)])
            )
    found["commands"] = [
        digits(repr([c.codes, c.what, c.hex, c.legal, c.kind, c.starts, c.together])) for c in map_.commands
    ]
    return {k: v if isinstance(v, str) else digits(repr(v)) for k, v in found.items()} | {
        "unknown": tried(map_.register, "R99")
    }


# --- boards ---


def board_scene(chips, layout, options):
    """Where a layout puts things; a random host, with strays; the trace of it all."""
    made = tried(lambda: Board(Stage("xy", chips=chips, visuals=False), layout, **options))
    if isinstance(made, str):
        return made
    board, d = made, Draw(f"{chips} {layout} {options}")
    first = min(board.link.first if hasattr(board.link, "first") else 0x300, 0x300)
    answers = []
    for _ in range(160):
        port = d.of(0x300, 0x340, first) + d.between(-2, 34)
        kind = d.between(0, 6)
        if kind <= 1:
            board.out8(port, d.of(d.between(0, 255), 0x15, 0x08, 0x41))
        elif kind == 2:
            board.out16(port & ~1, d.between(0, 0xFFFF))
        elif kind == 3:
            answers.append(board.in16(port & ~1))
        elif kind == 4:
            board.delay_us(d.of(0, 5, 300, 1500))
        else:
            for _ in range(d.of(1, 1, 4)):
                answers.append(board.in8(port))
    chips = board.stage.chips
    return {
        "answers": answers, "trace": board.trace.text(), "strays": [str(c) for c in board.strays], "micros": board.micros,
        "kept": [len(board.trace), board.trace.dropped], "interrupt": board.interrupt,
        "diagnostics": [[f"{x.clock} {x.address:X} {x.value:X} {x.message}" for x in c.diagnostics] for c in chips],
    }  # fmt: skip


BOARDS = [
    (PCL240K, None, {}), (PCL240MS, "pcl240-card", {}), (PCL240MK, "pcl240", {"base": 0x344, "stride": 8}), (MCX514, None, {}),
    (MCX514, "nova-8bit", {}), (MCX304, "nova", {"keep_cycles": 20}), (HCTL1100, None, {}), (HCTL1100, "hctl1100", {"base": 0x310}),
    ({"x": PCL240K, "y": MCX514}, None, {}), (PCL240K, "nova", {}), (PCL240K, "isa", {}), (PCL240K, None, {"stride": 3}),
    (PCL240K, None, {"base": -1}), (PCL240K, None, {"base": 1 << 32}), (PCL240K, None, {"keep_cycles": 0}),
]  # fmt: skip


def layouts():
    return {x.name: [x.title, x.ports, x.stride, x.base, x.own, x.chips, x.evidence] for x in LAYOUTS.values()}


# --- shapes ---

SHAPES = """<mujoco><asset><texture name="t" type="2d" builtin="checker" width="4" height="4" rgb1="1 0 0" rgb2="0 .5 1"/>
<material name="m" texture="t" rgba=".5 1 1 1"/></asset><worldbody><geom type="plane" size="1 2 .1"/>
<geom type="plane" size="0 1 .1" pos="0 0 1" euler="30 0 0"/><geom type="box" size=".1 .2 .3" rgba="1 .5 .25 1" pos="1 0 0"/>
<body name="b" pos="0 0 2" euler="0 40 0"><freejoint/><geom type="capsule" size=".1 .3" euler="90 0 0" pos=".1 .2 .3"/>
<geom type="capsule" size=".05 .1"/><geom type="cylinder" size=".1 .4" euler="0 20 0"/><geom type="ellipsoid" size=".1 .2 .3"/>
<geom type="sphere" size=".2" material="m"/><geom type="sphere" size=".1" group="3"/><geom type="sphere" size=".3" rgba="1 1 1 0"/>
</body></worldbody></mujoco>"""


def shapes():
    found = {}
    for name, model in (("all", mujoco.MjModel.from_xml_string(SHAPES)), ("xy", Stage("xy").model)):
        said = {}
        for body in range(model.nbody):
            for what, shape in geoms.shapes(model, body):
                parts = [part.as_arrow_array().to_pylist() for part in shape.as_component_batches()]
                said[f"{body} {what}"] = digits(
                    repr([np.round(np.ravel(p), 6) if p and isinstance(p[0], list) else p for p in parts]), 3
                )
        said["poses"] = (
            [np.asarray(p) for p in geoms.poses(model, np.array([model.qpos0, model.qpos0 + 0.01]))]
            if name == "all"
            else 0
        )
        said["colours"] = digits(repr([geoms.colour(model, g).tolist() for g in range(model.ngeom)]))
        said["seen"] = digits(repr([[geoms.visible(model, g) for g in range(model.ngeom)], geoms.floor(model)]))
        found[name] = said
    return found


def thinned():
    t = np.linspace(0, 1, 400)
    found = {}
    for k, v in enumerate((np.sin(9 * t), np.floor(7 * t), 0 * t, np.abs(t - 0.4))):
        for tolerance in (0.0, 1e-3, 0.1):
            keep = np.zeros(len(t), bool)
            found[f"{k} {tolerance}"] = [tried(thin, t, v.copy(), tolerance, keep), digits(keep.tobytes())]
    return found


# --- refusals of compiled functions ---


def arguments():
    found = {}
    for core in (pulse_core, nova_core, servo_core):
        chip = next(c for c in CHIPS.values() if c.CORE is core)
        rows = np.zeros(1, core.STATE)
        for bad in (
            (rows, 1 << 63), (rows, -(1 << 63) - 1), (rows, 1.5), (rows, "a"), (rows,), (5, 3), (np.zeros(1), 3),
            (np.zeros(0, core.STATE), 3),
            (np.zeros(4, core.STATE)[::2], 3), (rows, None),
        ):  # fmt: skip
            what = [b if isinstance(b, int) else type(b).__name__ for b in bad]
            name = f"{chip.__name__} {what} {np.size(bad[0])}"
            found[name] = str(tried(core.advance, *bad))[:200]
        found[f"{chip.__name__} most"] = tried(core.value if core is servo_core else core.counter, rows, 0)
    return found


# --- assertions for tests of firmware ---


def asserted():
    stage = Stage("xy", visuals=False)
    x = stage.axes["x"]
    x.chip.write(0, 0x84)
    x.chip.write(1, 1)
    found = {}
    stage.place(x=0.01)

    def all_of(about):
        found[about] = [
            tried(assertions.assert_no_lost_steps, stage), tried(assertions.assert_at, x, 0.01), tried(assertions.assert_at,
            x, 0.0101, 5e-5),
            tried(assertions.assert_stopped, stage), tried(assertions.assert_stopped, [x], 1.0),
            tried(assertions.assert_pins, x, org=True, hold=False),
            tried(assertions.assert_no_diagnostics, stage), tried(assertions.assert_pins, x, nothing=True),
        ]  # fmt: skip

    all_of("rest")
    for velocity in (-0.02, 0.02, 1e-5):
        stage.data.qvel[:] = velocity
        all_of(f"velocity {velocity}")
    stage.reset()
    for address, value in (
        (0, 0x81),
        (2, 3),
        (1, 0),
        (0, 0x82),
        (2, 5),
        (0, 0x87),
        (1, 60),
        (0, 0x08),
        (0, 0x40),
        (0, 0x11),
    ):
        x.chip.write(address, value)
    with faults.jam(x):
        stage.run(0.05)
        all_of("jammed")
    board = Board(Stage("xy", visuals=False))
    found["strays none"] = tried(assertions.assert_no_strays, board)
    for port in (0x200, 0x201, 0x202, 0x4FF, 0x200):
        board.in8(port)
    found["strays"] = tried(assertions.assert_no_strays, board)
    found["rate"] = [assertions.pulse_rate(x), assertions.velocity_of(x)]
    with stage.record(1e-3) as recording:
        stage.run(0.01)
    for within in (1e-6, 1.0):
        found[f"path {within}"] = tried(assert_path_within, recording, within=within, line=[(0, 0), (1, 1)])
    return found


# --- motors and models ---


def motors():
    found = {}
    rpm = np.array([30.0, 300.0, 1200.0])
    for name, m in MOTORS.items():
        drive = Drive(m, microsteps=8)
        found[name] = [
            repr(m), dynamometer.closed_form(m, 24.0, m.rated_current if hasattr(m, "rated_current") else 1.5, rpm),
            dynamometer.bound_by_both(m, 24.0, 1.5, rpm), dynamometer.natural_frequency(drive, 5e-6),
            dynamometer.natural_frequency(drive, 5e-6, True), drive.peak_torque, str(drive),
        ]  # fmt: skip
    found |= {name: repr(m) for name, m in DC_MOTORS.items()}
    drive = Drive(MOTORS["17HS4401"], microsteps=4)
    found["pull-in"] = dynamometer.pull_in(drive, 8e-6)
    found["ring"] = dynamometer.ring_down(drive, 8e-6)
    found["bad"] = [
        tried(Drive, MOTORS["17HS4401"], **bad) for bad in ({"microsteps": 300}, {"bus_voltage": 0}, {"current": -1})
    ]
    return found


BROKEN = [
    ("", ""), ('gear="628.3185307"', 'gear="0"'), ('name="x" class="slide"', 'name="q" class="slide"'), ('data="17HS4401"',
    'data="none"'),
    ('armature="3.711"', 'armature="0"'), ('range="-0.158 0.158"', 'range="-0.058 0.058"'), ("gear=", "ctrlrange='-1 1' gear="),
    ('frictionloss="4"', 'frictionloss="-4"'),
]  # fmt: skip


def models():
    """What a stage says of a model with one thing changed."""
    from pathlib import Path

    import stage.models

    folder = Path(stage.models.__file__).parent
    text = (folder / "xy_mast.xml").read_text().replace('file="', f'file="{folder}/')
    found = {name: plant.describe(Stage(name).model) for name in ("xy", "xyz", "xyz_servo")}
    for old, new in BROKEN:
        spec = mujoco.MjSpec.from_string(text.replace(old, new, 1) if old else text)
        found[f"{old} -> {new}"] = str(tried(lambda spec=spec: repr(Stage(spec, visuals=False))))[:500]
    found["bare"] = tried(Stage, mujoco.MjModel.from_xml_string(SHAPES.replace("\n", "")))
    return found


def names():
    """Near misses of names, options of chips, refusals."""
    from stage.chips import chip_class

    found = {
        n: str(tried(chip_class, n)) for n in ("pcl240k", "PCL-240MK", "mcx-514", "hctl 1100", "MCX513", "", "PCL240")
    }
    for cls, hz in itertools.product((PCL240K, MCX304), (0, 1.5, 1e9, "5", None, 100_000_000, True)):
        found[f"{cls.__name__} {hz}"] = str(tried(cls, hz))
    chip = PCL240K()
    found["clocks"] = [tried(chip.advance, n) for n in (-1, 1.5, 1 << 46)]
    found["axis"] = [tried(chip.journal, n) for n in (1, True, "x")]
    found["pins"] = [
        tried(setattr, chip.pins, "hold", True),
        tried(setattr, chip.pins, "el", True),
        tried(getattr, chip.pins, "elplus"),
    ]
    found["restore"] = tried(chip.restore, PCL240K(5_000_000).snapshot())
    found["stage"] = [tried(Stage, "xy", chips=c) for c in (PCL240K().__class__, 5, {"x": "none"}, {"q": PCL240K})][1:]
    return found


FILES = {
    "texts": {
        **{f"map {name}": partial(maps, name) for name in CHIPS}, "layouts": layouts, "names": names, "models": models,
        "assertions": asserted, "motors": motors, "shapes": shapes, "thin": thinned, "arguments": arguments,
    },
    "boards": {f"{k} {layout} {options}": partial(board_scene, chips, layout, options) for k, (chips, layout,
    options) in enumerate(BOARDS)},
}  # fmt: skip
