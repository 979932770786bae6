"""The compiled loops, a few physics steps at a time: short enough to run uncompiled, too, where they make the same bits and where
`make coverage` sees their lines."""

import copy
import hashlib
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support import nova_programs as nova
from support import servo_programs as servo
from support.examples import FIXED
from support.programs import start_preset

from stage import Fleet, Program, SimulationError, Stage, faults
from stage.board import Board
from stage.board.bus import host_record
from stage.chips import HCTL1100, MCX302, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.native import COMPILED
from stage.recording import recording
from stage.sim import program_player
from stage.sim import stage_state as stage_state

pytestmark = pytest.mark.usefixtures("elsewhere")


def make_stage():
    return Stage("xyz", chips={"x": PCL240MS, "y": PCL240K}, visuals=False)


def start_move(chip, r2, minus=False):
    """At r2 x 120 pps, at once."""
    p = Program()
    for name, value in {"R2": r2, "R7": 5}.items():
        p.register(0, chip, name, value)
    for command in (0x08, 0x48 if minus else 0x40, 0x11):
        p.command(0, command)
    for _, _, address, value in p.ops:
        chip.write(address, value)


def move_over_a_switch():
    """X runs over its SD switch and back; the edges and samples of its recording."""
    stage = make_stage()
    x = stage.axes["x"]
    sd = next(s.touch for s in x.plant.switches if s.pin == "sd_plus")
    stage.place(x=sd - 5e-5)
    with stage.record(every=5e-4) as recorded:
        start_move(x.chip, 40)
        stage.run_until(lambda: x.chip.pins.sd_plus, timeout=0.05)
        x.chip.write(0, 0x08)
        start_move(x.chip, 40, minus=True)
        stage.run_until(lambda: not x.chip.pins.sd_plus, timeout=0.05)
    assert recorded.columns["x/sd_plus"].any()
    return stage.snapshot().state.tobytes(), *(recorded.columns[name].tobytes() for name in sorted(recorded.columns))


def turn_over_an_index_mark():
    """X turns over the index pulse of its encoder, forth and back; when the chip saw it."""
    stage = make_stage()
    x = stage.axes["x"]
    turn = 2 * np.pi / stage.state.axis_table["gear"][0]
    observed = []
    for minus in (False, True):
        stage.place(x=(stage.state.axis_table["index_at"][0] + (0.007 if minus else -0.007)) * turn)
        start_move(x.chip, 60, minus)
        for on in (True, False):
            stage.run_until(lambda on=on: x.chip.pins.ez == on, timeout=0.05, poll=1e-4)
            observed.append(stage.time)
        x.chip.write(0, 0x08)
        stage.run_until(lambda: x.chip.pins.hold, timeout=0.05)
    return str(observed), stage.snapshot().state.tobytes()


def play_every_operation():
    """A host's program: write, read, wait, poll until stopped or out of patience, measure, look."""
    fleet = Fleet([make_stage()], threads=1)
    chip = fleet.stages[0].axes["x"].chip
    p = Program().command(0, 0x08)
    for name, value in {"R0": 12, "R2": 30, "R7": 5}.items():
        p.register(0, chip, name, value)
    p.command(0, 0x44).command(0, 0x11).wait(1e-3).read(0, 0).until_stopped([0], 0.05).measure(1e-3).sample_position(0)
    p.command(0, 0x08).command(0, 0x40).command(0, 0x11).until_stopped([0, 1], 2e-3)
    played = fleet.play([p])
    assert played.results[0, -1] < 0, "X has not stopped"
    return played.results.tobytes(), played.extremes.tobytes(), fleet.truth().tobytes()


def load(chip, **values):
    for name, value in values.items():
        r = chip.MAP.register(name)
        chip.write(0, 0x80 | r.number)
        for k in reversed(range((r.bits + 7) // 8)):
            chip.write(1 + k, value >> 8 * k & 0xFF)


def pack_fields(pulses):
    """Concatenate the bytes of the fields without the padding between them, which is undefined."""
    return b"".join(pulses[name].tobytes() for name in pulses.dtype.names)


def run_preset_moves():
    """Preset moves of the three chips: linear and S-curves, R6 and the automatic point, with FH correction and without."""
    for make in (PCL240K, PCL240MK, PCL240MS):
        kinds = [{}] if make is PCL240K else [{}, {"R14": 0x1000}, {"R14": 30, "R15": 50}, {"R14": 0x8000}]
        moves = list(itertools.product((40, 120), (0x44, 0x5C), kinds))
        step = (3 if make is PCL240K else 5) if FIXED else 1
        for pulses, control, kind in moves[::step]:  # each length, each control, each kind
            chip = make()
            load(chip, R1=50, R2=200, R3=300, R4=120, R5=90, R7=15)
            chip.write(0, 0x08)
            load(chip, R0=pulses, R6=0xFFFFFE if control == 0x5C else 30, **kind)
            for command in (0xC8, control, 0x37):
                chip.write(0, command)
            started = chip.trace(300_000)
            chip.write(0, 0x15)  # to FH1 in motion
            started = np.concatenate([started, chip.trace(20_000), chip.trace(20_000_000)])
            assert len(started) == pulses
            yield pack_fields(started) + bytes(chip.read(a) for a in range(4)) + chip.snapshot().record


def run_with_switches():
    """Origin returns to ORG and to EZ, a slow-down, an end limit, a decelerating stop, pulses counted from outside."""
    for make, control, r13, stop in (
        (PCL240K, 0x43, None, "org"), (PCL240MS, 0x61, 0x210000, "ez"), (PCL240MS, 0x69, 0x310000, "ez"),
        (PCL240MK, 0x40, None, "el_plus"), (PCL240K, 0x42, None, 0x1D), (PCL240K, 0x44, None, "extp"),
    ):  # fmt: skip
        chip = make()
        load(chip, R0=3, R1=50, R2=400, R4=120, R5=90, R7=15, **({"R13": r13} if r13 else {}))
        for command in (0x08, 0xD1 if stop == "extp" else 0xC8, control, 0x11 if stop == "extp" else 0x15):
            chip.write(0, command)
        texts = [chip.trace(60_000)]
        for on in (True, False):
            chip.pins.sd_plus = on
            texts.append(chip.trace(40_000))
        if stop == 0x1D:
            chip.write(0, stop)
        for _ in range(4):
            chip.pins.org = True
            for on in (True, False):
                if stop != 0x1D:
                    setattr(chip.pins, stop, on)
                texts.append(chip.trace(10_000))
        assert chip.pins.hold, f"{make.__name__} {stop}"
        yield b"".join(map(pack_fields, texts)) + chip.snapshot().record


def replay_journal():
    """Record the journal of a move and return its replay, with and without every pulse, as bytes."""
    chip = PCL240MS()
    load(chip, R0=60, R1=50, R2=150, R4=120, R5=90, R7=15)
    observed = []
    journal = chip.journal()
    for command in (0x08, 0x44, 0x15):
        chip.write(0, command)
    chip.advance(100_000)
    chip.pins.sd_plus = True
    chip.advance(5_000_000)
    journal.close()
    for every_pulse in (False, True):
        observed.append(np.concatenate(list(journal.replay_in_pieces(every_pulse, size=100))).tobytes())
    return observed


def move_several_axes():
    """NOVA chips: linear ramps and S-curves of two axes, a new speed in motion, a decelerating stop, a limit, a journal."""
    for make in (MCX514, MCX302):
        of_514 = make is MCX514
        chip = make()
        journal = chip.journal(1)
        names = ("SV", "DV", "AC", "DC", "JK") if of_514 else ("SV", "V", "A", "D", "K")
        values = (2000, 50_000, 20_000_000, 9_000_000, 900_000_000) if of_514 else (200, 5000, 8000, 4000, 3)
        for axes, curved in ((1, 4), (2, 2)):
            nova.load(chip, axes, **dict(zip(names, values, strict=True)), **({} if of_514 else {"R": 800_000}))
            chip.write(2, 0x0800 if of_514 else 0)
            chip.write(3, curved)
            nova.load(chip, axes, **{"TP" if of_514 else "P": 70 * axes})
        nova.command(chip, "DRVRL" if of_514 else "F_DRV_P", 3)
        texts = [chip.trace(20_000)]
        nova.load(chip, 3, **{names[1]: values[1] * 6 // 10})
        texts.append(chip.trace(30_000))
        yield b"".join(map(pack_fields, texts)) + bytes(chip.read(k) & 0xFF for k in range(8)) + chip.snapshot().record
        nova.command(chip, "DRVSBRK" if of_514 else "STOP_DEC", 1)
        texts = [chip.trace(60_000)]
        nova.command(chip, "DRVVP" if of_514 else "C_DRV_P", 1)
        texts.append(chip.trace(9_000))
        chip.axes[0].pins.lmt_plus = True
        texts.append(chip.trace(600_000))
        assert not chip.axes[0].pins.drive
        assert not chip.axes[1].pins.drive
        journal.close()
        yield b"".join(map(pack_fields, texts)) + chip.snapshot().record
        for every_pulse in (of_514,) if FIXED else (False, True):
            yield np.concatenate(list(journal.replay_in_pieces(every_pulse, size=100))).tobytes()
    stage = Stage("xyz", chips={"x": MCX514, "y": MCX514, "z": PCL240K}, visuals=False)
    x, chip = stage.axes["x"], stage.axes["x"].chip
    stage.place(x=next(s.touch for s in x.plant.switches if s.pin == "el_plus") - 3e-5)
    nova.load(chip, 3, SV=4000, DV=4000)
    chip.write(2, 0x0800)
    nova.command(chip, "DRVVP", 3)
    stage.run_until(lambda: not x.pins.drive, timeout=0.03)
    assert chip.net(1) > chip.net(0) - 2 > 0
    yield stage.snapshot().state.tobytes()


def run_closed_loop():
    """A servo holds, moves, runs into its limit; a stepper beside it; journals and a program on a fleet."""
    stage = Stage("xyz_servo", chips={"x": HCTL1100, "y": PCL240K}, visuals=False)
    x = stage.axes["x"]
    stage.place(x=next(s.touch for s in x.plant.switches if s.pin == "el_plus") - 3e-4)
    fleet = Fleet([copy.copy(stage)], threads=1)
    with stage.record(every=5e-4) as recorded:
        x.chip.write(0x13, 0)
        servo.control(x.chip)
        start_preset(stage.axes["y"].chip, 20)
        servo.trapezoid(x.chip, 40)
        stage.run(0.008)
        servo.run_on(x.chip, 3)
        stage.run_until(lambda: x.pins.limit, timeout=0.04)
        stage.run(0.001)
    assert x.pins.init
    yield stage.snapshot().state.tobytes()
    for name in sorted(recorded.columns):
        yield recorded.columns[name].tobytes()
    yield np.concatenate(list(recorded.journals["x"].replay_in_pieces(every_pulse=True, size=100))).tobytes()
    p = Program()
    servo.control(type("Bus", (), {"write": staticmethod(lambda *w: p.write(0, *w))}))
    p.register(0, x.chip, "R29", 30).register(0, x.chip, "R28", 5).register(0, x.chip, "R26", 0x80).write(0, 0, 0x08)
    played = fleet.play([p.until_stopped([0], 0.01).read(0, 0x14).sample_position(0)])
    yield played.results.tobytes() + fleet.truth().tobytes()


def count_encoder():
    """RP of an MCX514 follows the carriage, by two; a comparator on it stops the drive; the journal."""
    stage = Stage("xyz", chips=MCX514, encoders={"x": 320_000, "y": -5e5}, visuals=False)
    x = stage.axes["x"]
    journal = x.chip.journal()
    nova.load(x.chip, 3, SV=6000, DV=6000, MR0=9, TP=100)
    nova.load(x.chip, MRM=1, S0M=0x0150)
    nova.command(x.chip, "DRVRL", 3)
    observed = []
    for _ in range(8):
        stage.run(7e-4)
        nova.command(x.chip, "R-RP", 2)
        observed.append(int(x.chip.read(6)))
    journal.close()
    assert len(set(observed)) > 4
    yield repr(observed)
    yield stage.snapshot().state.tobytes()
    yield np.concatenate(list(journal.replay_in_pieces(every_pulse=True, size=100))).tobytes()


def run_on_a_board():
    """A host behind ports: moves, polls, stray ports, interrupts, a write that gets lost; and one that may run ahead."""
    for lazy in (False, True):
        stage = Stage("xyz", chips={"x": PCL240K, "y": PCL240MS}, visuals=False)
        board, observed = Board(stage), []
        board.link.record["lazy"] = lazy
        with stage.record(every=5e-4) as recorded:
            for port in (0x300, 0x304):
                for number, value in {"0": 5, "1": 500, "7": 5}.items():
                    board.out8(port, 0x80 | int(number))
                    for byte in (2, 1, 0):
                        board.out8(port + 1 + byte, value >> 8 * byte & 0xFF)
                board.out8(port, 0x44)
                board.out8(port, 0x30)
            while board.in8(0x304) & 0x40 and stage.time < 1e-3:
                observed.append(board.in16(0x301) + board.in8(0x2FF))
            board.link.make_request(host_record.SETTLE, 0, 0)
            faults.lost_write(stage.axes["y"], address=0)
            board.on_interrupt(
                lambda board=board, observed=observed: (
                    observed.append(board.micros),
                    board.out8(0x300, 0),
                    board.out8(0x304, 0),
                )
            )
            board.delay_us(6000)
        assert "lost on the way" in str(board.trace)
        yield repr([observed, list(board.trace), stage.axes["x"].chip.diagnostics])
        yield stage.snapshot().state.tobytes()
        for name in sorted(recorded.columns):
            yield recorded.columns[name].tobytes()


def read_all_addresses():
    """An int, and not a number of NumPy's."""
    for chip in (PCL240MS(), MCX302(), MCX514(), HCTL1100()):
        yield repr([chip.read(address) for address in range(chip.ADDRESSES)])


def draw_line_by_two_chips():
    """X and Y on one MCX514, the master, Z on another."""
    one, two = (lambda: MCX514()), (lambda: MCX514())
    chips = {"x": one, "y": one, "z": two}
    stage = Stage("xyz", chips=chips, multichip=["x", "z"], bus_cycle=0.0, visuals=False)
    master, slave = stage.chips
    for chip, code, value in (
        *((master, code, value) for code, value in ((0x104, 40_000), (0x105, 60_000), (0x102, 9_000_000))),
        (master, 0x106, 60), (master, 0x206, -7), (slave, 0x106, 33),
        (slave, 0x2A, 2 << 10 | 1), (slave, 0x60, 0), (master, 0x2A, 1 << 10 | 3), (master, 0x61, 0),
    ):  # fmt: skip
        chip.write(6, value & 0xFFFF)
        chip.write(7, value >> 16 & 0xFFFF)
        chip.write(0, code)
    journal = slave.journal()
    stage.run(0.00125)
    yield from (chip.state.tobytes() for chip in stage.chips)
    yield journal.replay_waveforms(every_pulse=True).edges.tobytes()


SCENES = (
    run_on_a_board,
    run_preset_moves,
    replay_journal,
    run_with_switches,
    move_over_a_switch,
    turn_over_an_index_mark,
    play_every_operation,
    move_several_axes,
    run_closed_loop,
    count_encoder,
    read_all_addresses,
    draw_line_by_two_chips,
)


def hash_scenes():
    """Run every scene and return the hash of its result by name."""
    text = {}
    for scene in SCENES:
        parts = (part if isinstance(part, bytes) else part.encode() for part in scene())
        text[scene.__name__] = hashlib.sha256(b"|".join(parts)).hexdigest()
    return text


def test_one_switch_says_whether_hot_functions_are_compiled():
    text = "from stage.native import COMPILED; print(COMPILED)"
    for value, expected in ((None, "True"), ("0", "True"), ("", "True"), ("1", "False")):
        environment = {k: v for k, v in os.environ.items() if k != "NUMBA_DISABLE_JIT"}
        environment |= {} if value is None else {"NUMBA_DISABLE_JIT": value}
        requested = subprocess.run(
            [sys.executable, "-c", text], env=environment, capture_output=True, text=True, check=True
        )
        assert requested.stdout.strip() == expected


def test_compiled_and_uncompiled_make_the_same_bits():
    other = subprocess.run(
        [sys.executable, "-c", "import json, test_uncompiled as t; print(json.dumps([t.COMPILED, t.hash_scenes()]))"],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1" if COMPILED else "0"},
        cwd=Path(__file__).parent, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert json.loads(other) == [not COMPILED, hash_scenes()]


def test_a_program_of_a_driver_in_python_makes_the_same_bits():
    fleet, stage = Fleet([make_stage()], threads=1), make_stage()
    chip = stage.axes["y"].chip
    p = Program().command(1, 0x08).register(1, chip, "R0", 9).register(1, chip, "R2", 30).register(1, chip, "R7", 5)
    p.command(1, 0x44).command(1, 0x11).until_stopped([1], 0.05).measure(1e-3).sample_position(1).read(1, 0).wait(1e-4)
    ops = np.array(p.ops)
    results, extremes = np.zeros(len(ops), np.int64), np.full((stage.model.nq, 2), np.inf) * [1, -1]
    assert program_player.play_in_python(stage, ops, results, extremes) == program_player.PLAYED
    played = fleet.play([p])
    assert (played.results[0] == results).all()
    assert (played.extremes[0] == extremes).all()
    assert fleet.stages[0].snapshot().state.tobytes() == stage.snapshot().state.tobytes()


@pytest.mark.parametrize("operation", ["wait", "measure", "until_stopped", "read"])
def test_a_stage_that_diverges_ends_its_program(operation):
    fleet = Fleet([make_stage()], threads=1)
    fleet.stages[0].data.qfrc_applied[:] = 1e30
    p = Program()
    if operation == "read":
        for _ in range(2000):
            p.read(0, 0)
    else:
        start_preset(fleet.stages[0].axes["x"].chip, 100)
        {"wait": p.wait, "measure": p.measure, "until_stopped": lambda s: p.until_stopped([0], s)}[operation](0.01)
    assert fleet.play([p]).diverged.all()


def test_by_hand_a_stage_that_diverges_ends_its_program():
    stage = make_stage()
    stage.data.qfrc_applied[:] = 1e30
    ops = np.array(Program().wait(0.01).ops)
    assert program_player.play_in_python(stage, ops, np.zeros(1, np.int64), np.zeros((3, 2))) == program_player.DIVERGED


def test_room_for_few_samples_and_edges_loses_none(monkeypatch):
    """The loop returns when its room is full, and goes on."""
    full = move_over_a_switch()
    monkeypatch.setattr(recording, "BUFFER_ROWS", 7)
    monkeypatch.setattr(stage_state, "SPARE_EDGE_COUNT", 8 * 2)  # that is: full with the first edge
    assert move_over_a_switch() == full


def test_a_diverging_stage_says_so():
    stage = make_stage()
    stage.data.qfrc_applied[:] = 1e30
    with pytest.raises(SimulationError):
        stage.run(0.01)
