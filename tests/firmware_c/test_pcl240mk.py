"""C firmware of scripts/firmware/pcl240mk homes three PCL-240MK and moves them along a line; faults in it are
diagnosed."""

import ctypes
import platform
import random
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from support.examples import SEED

from stage import Stage
from stage.board import Board, NativeHost
from stage.board.firmware_library import find_compiler
from stage.chips import PCL240MK
from stage.firmware.path_deviation import compute_path_deviation, replay_pulses
from stage.firmware.pcl240 import emulated_preset_move

EXAMPLES = Path(__file__).resolve().parents[2] / "scripts" / "firmware"
LINE = {"x": 20_000, "y": 12_000, "z": 5_000}
SPEED = (255, 4080, 193, 193, 153)  # that of home_and_line.c
NO_CHIP, NOT_HOMED, MISSING_CHIP_CODE = 10, 20, 40
LINE_OK, LINE_TOO_LONG, LINE_TOO_SHORT, LINE_TOO_SLOW = range(4)
TIMEOUT = 60.0  # simulated s
NEAR = {"x": -0.115, "y": -0.065, "z": -0.009}  # m, 5 mm before ORG


class Ran(NamedTuple):
    """A whole run of the firmware."""

    stage: Stage
    board: Board
    code: int
    log: list
    homed: dict  # m, where each axis was when the firmware had homed it
    paths: dict  # of each axis: seconds, directions of the pulses of the line


def run(library, isolated=False, **places):
    stage = Stage("xyz", chips=PCL240MK, visuals=False)
    stage.place(**places)
    board = Board(stage)
    host = NativeHost(library, board, isolated=isolated)
    journals = {name: axis.chip.journal() for name, axis in stage.axes.items()}
    homed = {}
    for k, name in enumerate(stage.axes):
        host.run_until(lambda k=k: len(host.log) > k, timeout=TIMEOUT, poll=0.01)
        homed[name] = stage.axes[name].position
    result = host.run(TIMEOUT)
    began = next(seconds for seconds, text in host.log if text == "line")
    paths = {}
    for name, journal in journals.items():
        journal.close()
        pulses = replay_pulses(journal)
        seconds = pulses["clock"] / stage.axes[name].chip.clock_hz
        paths[name] = seconds[seconds > began], pulses["direction"][seconds > began]
    return Ran(stage, board, result.code, host.log, homed, paths)


def org(axis):
    return next(s.touch for s in axis.plant.switches if s.pin == "org")


@pytest.fixture(scope="module")
def library(firmware):
    return firmware("pcl240mk")


@pytest.fixture(scope="module")
def finished_run(library):
    return run(library, **NEAR)


def test_three_axes_are_homed_within_a_pulse_of_orgs_edge(finished_run):
    for name, position in finished_run.homed.items():
        axis = finished_run.stage.axes[name]
        print(f"{name}: {(position - org(axis)) * 1e6:+.2f} um")
        assert position == pytest.approx(org(axis), abs=axis.meters_per_pulse)


@pytest.mark.parametrize(
    "places",
    [
        pytest.param({"x": 0.14, "y": 0.08, "z": 0.03}, id="far from ORG", marks=pytest.mark.slow),
        pytest.param({"x": -0.119, "y": -0.0697, "z": -0.0138}, id="between SD and ORG", marks=pytest.mark.slow),
        pytest.param({"x": -0.1205, "y": -0.0705, "z": -0.0142}, id="on ORG"),
        pytest.param({"x": -0.1501, "y": -0.1001, "z": -0.0401}, id="on the end limit behind ORG"),
    ],
)
def test_homing_from_any_position_ends_at_the_same_pulse(library, finished_run, places):
    again = run(library, **places)
    assert again.code == 0
    for name, axis in again.stage.axes.items():
        assert again.homed[name] == pytest.approx(finished_run.homed[name], abs=axis.meters_per_pulse)
        assert axis.lost_steps == 0


def test_the_line_ends_on_its_pulses_and_no_step_is_lost(finished_run):
    assert finished_run.code == 0
    for name, pulses in LINE.items():
        axis = finished_run.stage.axes[name]
        assert finished_run.paths[name][1].tolist() == [1] * pulses
        assert f"{name}: at {pulses}" in [text for _, text in finished_run.log]
        assert axis.lost_steps == 0
        assert axis.position - finished_run.homed[name] == pytest.approx(pulses * axis.meters_per_pulse, abs=1e-5)


def test_pulses_stay_within_two_of_the_line_and_end_together(finished_run):
    max_distance = compute_path_deviation(list(finished_run.paths.values()), list(LINE.values())).pulses
    ends = [seconds[-1] for seconds, _ in finished_run.paths.values()]
    print(f"{max_distance:.2f} pulses from the line, ends within {np.ptp(ends) * 1e3:.2f} ms")
    assert max_distance <= 2
    assert np.ptp(ends) < 2 / 250, "two pulses of the slowest axis at FL"


def test_a_reader_of_the_data_sheet_finds_no_mistake(finished_run):
    assert [axis.chip.diagnostics for axis in finished_run.stage.axes.values()] == [[], [], []]
    assert finished_run.board.strays == []


@pytest.mark.parametrize("isolated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_two_runs_are_the_same_to_the_bit(library, finished_run, isolated):
    again = run(library, isolated, **NEAR)
    assert again.stage.snapshot().state.tobytes() == finished_run.stage.snapshot().state.tobytes()
    assert again.board.trace.lines().tobytes() == finished_run.board.trace.lines().tobytes()
    assert again.log == finished_run.log


class Speed(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_uint16) for name in ("R1", "R2", "R4", "R5", "R7"))


class MoveStruct(ctypes.Structure):
    _fields_ = (("pulses", ctypes.c_int32), ("speed", Speed), ("R6", ctypes.c_uint32))


def plan_line(library, distances, speed=SPEED):
    """Call line_plan of line.c; return its result and the moves that it has planned."""
    moves = (MoveStruct * len(distances))()
    distances_array = (ctypes.c_int32 * len(distances))(*distances)
    return ctypes.CDLL(str(library)).line_plan(
        len(distances), distances_array, ctypes.byref(Speed(*speed)), moves
    ), moves


def test_random_lines_stay_within_two_and_a_half_pulses(library):
    seed = SEED
    print("seed", seed)
    rng = random.Random(seed)
    max_distance = []
    for _ in range(40):
        distances = [
            rng.choice((-1, 1)) * rng.randint(100, 30_000),
            rng.randint(3000, 30_000),
            rng.randint(100, 30_000),
        ]
        code, moves = plan_line(library, distances)
        assert code == LINE_OK
        order = sorted(range(3), key=lambda k: abs(distances[k]))
        paths = []
        for k, move in enumerate(moves):
            s = move.speed
            assert move.pulses == distances[k]
            row = np.array([abs(move.pulses), s.R1, s.R2, s.R2, s.R4, s.R5, move.R6, s.R7], np.int64)
            started = order.index(k) * 1e-6
            paths.append(
                (emulated_preset_move.trace_preset_move(row, PCL240MK) / PCL240MK.DEFAULT_CLOCK_HZ + started, 1)
            )
        max_distance.append(compute_path_deviation(paths, np.abs(distances).tolist()).pulses)
    print(f"median {np.median(max_distance):.2f}, largest {max(max_distance):.2f}")
    assert np.median(max_distance) <= 1.5
    assert max(max_distance) <= 2.5, "of 3000 the worst was 2.06"


@pytest.mark.parametrize(
    ("distances", "speed", "code"),
    [
        ((16_777_216, 5), SPEED, LINE_TOO_LONG),
        ((2000, 1000, 0), SPEED, LINE_TOO_SHORT),
        ((0, 0), SPEED, LINE_TOO_SHORT),
        ((20_000, 1), SPEED, LINE_TOO_SLOW),
        ((20_000, 0, -20_000), SPEED, LINE_OK),
    ],
)
def test_a_line_that_no_registers_make_is_refused(library, distances, speed, code):
    assert plan_line(library, distances, speed)[0] == code


def test_the_driver_detects_a_missing_chip_and_the_board_lists_its_stray_cycles(library):
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    board = Board(stage)
    host = NativeHost(library, board)
    assert host.run(TIMEOUT).code == NO_CHIP + 2
    assert host.log[-1][1] == "z: no chip at 308h"
    assert {cycle.port for cycle in board.strays} == {0x308, 0x309, 0x30A, 0x30B}


def test_an_org_that_never_comes_ends_at_the_limit(library):
    stage = Stage("xyz", chips=PCL240MK, visuals=False)
    stage.place(x=-0.14)
    x = stage.axes["x"]
    x.switches.stick("org", False)
    host = NativeHost(library, Board(stage))
    assert host.run(TIMEOUT).code == NOT_HOMED
    assert x.position == pytest.approx(-0.150, abs=1e-3)
    assert not x.chip.busy()


def test_an_end_limit_on_the_line_stops_the_other_axes_too(library):
    stage = Stage("xyz", chips=PCL240MK, visuals=False)
    stage.place(**NEAR)
    host = NativeHost(library, Board(stage))
    host.run_until(lambda: host.log and host.log[-1][1] == "line", timeout=TIMEOUT, poll=0.01)
    host.run_for(0.5)
    stage.axes["y"].switches.stick("el_plus", True)
    assert host.run(TIMEOUT).code == MISSING_CHIP_CODE
    for axis in stage.axes.values():
        assert not axis.chip.busy()
        assert axis.lost_steps == 0
        assert axis.chip.values()["R0"] > 0, "it was stopped on its way"


BROKEN = {  # in pcl240.c: what is replaced, by what; the last byte of the cycle, and what is said of it
    "R6 is not written": (
        "    pcl240_write(chip, PCL240_R6, move->down_point);\n",
        "",
        0x15,
        "R6 = 0 in a high-speed preset move",
    ),
    "R5 is written to R4": (
        "PCL240_R5, speed->decel)",
        "PCL240_R4, speed->decel)",
        0x15,
        "R5 = 0: rates below 2 hold the speed",
    ),
    "R7 is written as 1": (
        "PCL240_R7, speed->multiplier)",
        "PCL240_R7, speed->multiplier >> 7)",
        0x01,
        "takes 2 to 1023",
    ),
    "no reset command before the next start": (
        "    pcl240_command(chip, PCL240_RESET);\n    pcl240_control(chip, PCL240_ORG_ENABLE",
        "    pcl240_control(chip, PCL240_ORG_ENABLE",
        0x10,
        "start after a stop without the reset command 08h is ignored",
    ),
}


@pytest.mark.parametrize(
    "what", [next(iter(BROKEN)), *(pytest.param(what, marks=pytest.mark.slow) for what in list(BROKEN)[1:])]
)
def test_a_broken_register_write_is_named_with_its_cycle_and_leaves_a_recording(firmware, tmp_path, what):
    old, new, value, message = BROKEN[what]
    stage = Stage("xyz", chips=PCL240MK, visuals=False)
    stage.place(x=-0.118, y=-0.068, z=-0.0125)
    board = Board(stage)
    with stage.record() as recording:
        host = NativeHost(firmware("pcl240mk", change=("pcl240.c", old, new)), board)
        code = host.run(TIMEOUT).code
    printed_text = next(d for d in stage.axes["x"].chip.diagnostics if message in d.message)
    moment = printed_text.clock / stage.axes["x"].chip.clock_hz
    named = [cycle for cycle in board.trace if cycle.direction == "W" and cycle.port in range(0x300, 0x304)]
    cycle = min(named, key=lambda cycle: abs(cycle.seconds - moment))
    print(f"returned {code}; {printed_text.message}\n{cycle}")
    assert (cycle.value, cycle.seconds) == (value, pytest.approx(moment, abs=1e-6))
    assert str(cycle) in board.trace.text()
    assert recording.save(tmp_path / "broken.rrd").stat().st_size > 10_000
    assert recording.to_vcd(tmp_path / "broken.vcd").stat().st_size > 1000


def test_a_line_without_a_ramp_down_stops_abruptly(firmware, finished_run):
    """The firmware itself notices nothing: it counts pulses, as the chip does."""
    old, new, *_ = BROKEN["R6 is not written"]
    bang = run(firmware("pcl240mk", change=("pcl240.c", old, new)), **NEAR)
    assert bang.code == 0
    for name, pulses in LINE.items():
        seconds, _ = bang.paths[name]
        rate = 1 / np.diff(seconds)[-1]
        assert rate == pytest.approx(16_000 * pulses / LINE["x"], rel=0.01), "it stops from FH1"
        assert 1 / np.diff(finished_run.paths[name][0])[-1] < rate / 10


def test_the_same_driver_compiles_for_a_card_in_a_pc(firmware, tmp_path):
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        pytest.skip("port I/O from user space is a matter of Linux on x86")
    sources = [EXAMPLES / "hal" / "hal_linux.c", *sorted((EXAMPLES / "pcl240mk").glob("*.c"))]
    command = [
        *find_compiler().split(),
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-O2",
        f"-I{EXAMPLES / 'hal'}",
        *map(str, sources),
    ]
    finished_run = subprocess.run(
        [*command, "-o", str(tmp_path / "program")], capture_output=True, text=True, check=False
    )
    assert (finished_run.returncode, finished_run.stderr) == (0, "")
