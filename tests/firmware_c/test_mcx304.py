"""scripts/firmware/mcx304: C firmware reproduces the S-curve erratum of NOVA's notice, without and with two fixes."""

import re
from typing import NamedTuple

import pytest

from stage import Stage
from stage.board import Board, HostTimeout, NativeHost
from stage.chips import MCX304
from stage.firmware.path_deviation import replay_pulses

PULSES, SV = 40_000, 4000  # pps
SHORT = 5e-3  # m from the target to EL+
TIMEOUT = 8.0  # simulated s; the drive takes 3.15
ON_TARGET, STOPPED_BEFORE = 0, 20
STOP_COMMAND_S, EARLY = "-DSTOP_AT=80", "-DSTOP_AT=20000"  # in area d; at the drive speed
BARE, BY_INTERRUPT, BY_SPEED = (f"-DWORK_AROUND={k}" for k in range(3))
with_erratum = pytest.mark.parametrize(
    "erratum_fix", [pytest.param(BY_INTERRUPT, id="by interrupt"), pytest.param(BY_SPEED, id="by speed")]
)


class ReadyBoard(NamedTuple):
    stage: Stage
    board: Board
    host: NativeHost
    end: float  # m, where EL+ trips


def prepare_board(library, errata=True):
    """Return a stage with firmware, whose X axis starts where its target is 5 mm before EL+."""
    stage = Stage("xy", chips=lambda: MCX304(errata=errata), visuals=False)
    x = stage.axes["x"]
    end = next(s.touch for s in x.plant.switches if s.pin == "el_plus")
    stage.place(x=end - SHORT - PULSES * x.meters_per_pulse)
    board = Board(stage)
    return ReadyBoard(stage, board, NativeHost(library, board), end)


def test_command_26h_alone_makes_pulses_until_the_run_times_out(firmware):
    stage, _, host, end = prepare_board(firmware("mcx304", BARE, STOP_COMMAND_S))
    x = stage.axes["x"]
    journal = x.chip.journal(x.chip_axis)
    with pytest.raises(HostTimeout, match=r"has not returned after 8 s of simulated time") as caught:
        host.run(TIMEOUT)
    journal.close()
    assert re.search(r"300h W 0126h", str(caught.value)), "the last bus cycles, with the 26h"
    requested, text = host.log[-1]
    assert re.fullmatch(r"stop at 399[23]\d: 26h", text)
    assert x.chip.busy(x.chip_axis)
    pulses = replay_pulses(journal)
    assert len(pulses) == pytest.approx(PULSES - 80 + SV * (TIMEOUT - requested), rel=0.03), "pulses go on at about SV"
    assert x.lost_steps > 0
    assert x.position > end + SHORT, "the carriage stands at its hard stop"
    assert x.chip.diagnostics == [], "nothing that a data sheet forbids: 26h may be given at any time"
    assert host.run_for(1.0) is None
    assert x.chip.busy(x.chip_axis), "and so it goes on"


@with_erratum
def test_each_erratum_fix_ends_the_drive_at_its_target(firmware, erratum_fix):
    stage, board, host, end = prepare_board(firmware("mcx304", erratum_fix, STOP_COMMAND_S))
    x = stage.axes["x"]
    assert host.run(TIMEOUT).code == ON_TARGET
    assert re.fullmatch(r"stop at 399[23]\d: it decelerates anyway", host.log[0][1])
    assert host.log[1][1] == "at 40000"
    stage.run(0.1)
    assert x.position == pytest.approx(end - SHORT, abs=2e-5)
    assert x.lost_steps == 0
    assert x.chip.diagnostics == []
    assert board.strays == []
    calls = sum(cycle.direction == "I" for cycle in board.trace)
    assert calls == (1 if erratum_fix == BY_INTERRUPT else 0)


@with_erratum
def test_each_erratum_fix_also_works_for_an_early_stop(firmware, erratum_fix):
    stage, _, host, end = prepare_board(firmware("mcx304", erratum_fix, EARLY))
    assert host.run(TIMEOUT).code == STOPPED_BEFORE
    assert re.fullmatch(r"stop at 200\d\d: 26h", host.log[0][1])
    x = stage.axes["x"]
    assert 20_000 < int(host.log[1][1].removeprefix("at ")) < PULSES
    assert x.position < end - SHORT
    assert x.lost_steps == 0


def test_a_chip_without_the_erratum_stops_without_a_fix(firmware):
    stage, _, host, _ = prepare_board(firmware("mcx304", BARE, STOP_COMMAND_S), errata=False)
    assert host.run(TIMEOUT).code == ON_TARGET
    assert stage.axes["x"].lost_steps == 0


@pytest.mark.parametrize("flag", [BARE, BY_INTERRUPT])
def test_two_runs_are_the_same_to_the_bit(firmware, flag):
    observed_results = []
    for _ in range(2):
        stage, board, host, _ = prepare_board(firmware("mcx304", flag, STOP_COMMAND_S))
        host.run_for(3.3)
        observed_results.append((stage.snapshot().state.tobytes(), board.trace.lines().tobytes(), tuple(host.log)))
    assert observed_results[0] == observed_results[1]


def test_a_broken_register_write_is_named_with_its_cycle_and_leaves_a_recording(firmware, tmp_path):
    change = ("s_curve_stop.c", "MCX304_A, 8000)", "MCX304_A, 80000)")
    stage, board, host, _ = prepare_board(firmware("mcx304", BY_SPEED, STOP_COMMAND_S, change=change))
    with stage.record() as recording:
        host.run_for(0.5)
    chip = stage.chips[0]
    printed_text = chip.diagnostics[0]
    moment = printed_text.clock / chip.clock_hz
    assert "A = 14464" in printed_text.message, "what is left of it in 16 bits"
    assert "takes 1 to 8000" in printed_text.message
    cycle = min((c for c in board.trace if c.direction == "W"), key=lambda cycle: abs(cycle.seconds - moment))
    print(f"{printed_text.message}\n{cycle}")
    assert (cycle.port, cycle.value, cycle.seconds) == (0x300, 0x0102, pytest.approx(moment, abs=1e-6))
    assert recording.save(tmp_path / "broken.rrd").stat().st_size > 10_000
    assert recording.to_vcd(tmp_path / "broken.vcd").stat().st_size > 1000


def test_the_driver_detects_a_missing_chip(firmware):
    board = Board(Stage("xyz", chips=MCX304, visuals=False), base=0x400)
    assert NativeHost(firmware("mcx304", BARE, STOP_COMMAND_S), board).run(TIMEOUT).code == 10
    assert {cycle.port for cycle in board.strays} == {0x300}
