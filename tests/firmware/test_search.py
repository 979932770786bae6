"""What the results of an origin return that was written as a program say: every way in which it can end."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.chips import MCX304, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.chips.pcl240.state import S_ORG, S_ZERO
from stage.firmware import Bench
from stage.firmware.driver import get_driver
from stage.firmware.nova.home_program import HomeSearchProgram
from stage.firmware.pcl240 import origin_return
from stage.firmware.pcl240.home_program import FourRunHomeProgram
from stage.sim.program import Program

RESULTS = {"leave": 0, "search": 7000, "back off": 500, "approach": 480}  # pulses


def make_search(kind, chip, ez=0):
    settings = SimpleNamespace(leave=1000, back_off=500, multiplier=60, settle=0.01, limit=2.0, ez=ez)
    return kind(get_driver(Bench(chip()).axes["x"]), settings)


def decode_results(program, results, **choices):
    """Decode results, a dictionary {mark: value} for each run, of a row with these choices."""
    table = np.zeros((len(results), max(program.result_indices.values()) + 1), np.int64)
    for row, message in zip(table, results, strict=True):
        for name, value in message.items():
            row[program.result_indices[name]] = value
    rows = np.array(
        [list((dict(zip(program.choices.ranges, program.choices.low, strict=True)) | choices).values())] * len(results)
    )
    return program.decode_results(table, rows)._asdict()


def make_results_of_four_runs(approach_status=S_ORG, index=0xFF, pulses=RESULTS, **changed_status):
    """Make the results of four successful runs, with changed status bytes by name; -1 stands for a timeout."""
    status = {"leave": S_ZERO, "search": S_ORG, "back off": S_ZERO, "approach": approach_status} | {
        name.replace("_", " "): s for name, s in changed_status.items()
    }
    out = {}
    for name, s in status.items():
        count = -pulses[name] & 0xFFFFFF if name in ("search", "approach") else 0
        out |= {f"{name} time": min(s, 0) if s < 0 else 1000, f"{name} 0": max(s, 0)}
        out |= {f"{name} {k}": count >> 8 * (k - 1) & 0xFF for k in (1, 2, 3)}
    return out, index


DIRECTIONS = {  # late, home, end_limit, released
    "as it should": (make_results_of_four_runs(), (0, 1, 0, 1)),
    "with every other bit": (
        make_results_of_four_runs(leave=0xFF & ~S_ORG, search=0xFF, back_off=0xFF & ~S_ORG, approach_status=0xFF),
        (0, 1, 0, 1),
    ),
    "the leaving met a limit": (make_results_of_four_runs(leave=0), (0, 1, 1, 1)),
    "no ORG ahead": (make_results_of_four_runs(search=0), (0, 1, 1, 1)),
    "the backing off met a limit": (make_results_of_four_runs(back_off=0), (0, 1, 1, 1)),
    "ORG not released": (make_results_of_four_runs(back_off=S_ZERO | S_ORG), (0, 0, 0, 0)),
    "the approach met a limit": (make_results_of_four_runs(approach_status=0), (0, 0, 1, 1)),
    **{f"too long: {run}": (make_results_of_four_runs(**{run: -1}), (1, 0, 0, None)) for run in ("leave", "search", "back_off")},
    "too long: approach": (make_results_of_four_runs(approach_status=-1), (1, 0, 0, 1)),
}  # fmt: skip


def test_every_stop_reason_of_an_origin_return_in_four_runs_is_reported():
    reported = decode_results(
        make_search(FourRunHomeProgram, PCL240K), [r for (r, _), _ in DIRECTIONS.values()], back_off=500
    )
    for k, (name, (_, expected)) in enumerate(DIRECTIONS.items()):
        observed = [int(reported[what][k]) for what in ("timed_out", "home", "end_limit", "released")]
        assert all(e in (None, s) for s, e in zip(observed, expected, strict=True)), (name, observed)
    assert set(reported["searched"]) == {7000}
    assert set(reported["overrun"]) == {480 - 500}


@pytest.mark.parametrize(
    ("chip", "bit"), [(PCL240MS, 0x10), (PCL240MK, 0x40)], ids=["bit 20 of R17", "status bit 6 of a start"]
)
def test_a_return_to_the_index_pulse_is_home_only_if_the_pulse_ended_it(chip, bit):
    """The MK has no EZ monitor: that it accepts a start towards the end limit says that the limit did not end the return."""
    runs = make_search(FourRunHomeProgram, chip, ez=2)
    results = [make_results_of_four_runs()[0] | {"index": index} for index in (bit, 0xFF & ~bit)]
    assert decode_results(runs, results)["home"].tolist() == [True, False]


@pytest.mark.parametrize("chip", [MCX304, MCX514])
@pytest.mark.parametrize("ez", [0, 1])
def test_every_stop_reason_of_an_automatic_home_search_is_reported(chip, ez):
    program = make_search(HomeSearchProgram, chip, ez)
    (mask, high), (error, _) = (program._bits[name] for name in (f"stop{ez + 1}", "error"))
    on, off = (mask, 0xFFFF & ~mask) if high else (0xFFFF & ~mask, mask)
    good = {name: 1000 for name in program.result_indices if "time" in name} | {
        "left 6": 800, "ended 6": -6200 & 0xFFFF, "ended 7": -6200 >> 16 & 0xFFFF, f"stop{ez + 1}": on,
    }  # fmt: skip
    times = [name for name in program.result_indices if "time" in name]
    results = [
        good, good | {"error": 0xFFFF & ~error, f"stop{ez + 1}": 0xFFFF & ~off}, good | {"left 6": 799},
        good | {f"stop{ez + 1}": off},
        good | {"error": error}, *(good | {name: -1} for name in times), *(good | {name: 0} for name in times),
    ]  # fmt: skip
    reported = decode_results(program, results, leave=800)
    n = len(times)
    assert reported["home"].tolist() == [True, True, True, False, False] + [False] * n + [True] * n
    assert reported["timed_out"].tolist() == [False] * 5 + [True] * n + [False] * n
    assert reported["end_limit"].tolist() == [False, False, True, True, False] + [False] * 2 * n
    assert reported["released"].tolist() == [True] * 4 + [False] + [True] * 2 * n
    assert reported["searched"].tolist() == [7000] * 2 + [6999] + [7000] * (2 + 2 * n)


@pytest.mark.parametrize("ez", [1, 2, 16])
def test_an_origin_return_to_the_index_pulse_counts_from_fl_on(ez):
    """R13: end at the ez-th EZ, counted from where the axis runs at FL; not from ORG on, at the speed of the search"""
    program, chip = make_search(FourRunHomeProgram, PCL240MK, ez), PCL240MK()
    value = 1 << 21 | 1 << 20 | (ez - 1) << 16
    assert value == PCL240MK.MAP.register("R13").mask & value
    wanted = Program().register(0, chip, "R13", value).ops
    rows = program.write_program(program.choices.low).ops
    assert any(rows[k : k + len(wanted)] == wanted for k in range(len(rows)))
    written = {}
    status = SimpleNamespace(org=False, _replace=lambda **_: status)
    axis = SimpleNamespace(wait=lambda _: None, chip=chip)
    port = SimpleNamespace(
        extended=True, axis=axis, write_register=written.__setitem__,
        write_control_mode=lambda _: None, write_command=lambda _: None, wait_until_stopped=lambda _: status,
        read_status=lambda: status,
    )  # fmt: skip
    run = SimpleNamespace(port=port, find_stop_reason=lambda: "EZ")
    assert origin_return._run_to_origin(run, -1, False, 1.0, ez) == "EZ"
    assert written == {"R13": value}


@pytest.mark.parametrize(
    ("kind", "chip"), [(FourRunHomeProgram, PCL240K), (HomeSearchProgram, MCX514), (HomeSearchProgram, MCX304)]
)
def test_the_nearest_row_of_any_request_is_within_the_register_ranges(kind, chip):
    """search.find_nearest_row(fl, fh, ramp, approach, leave, back_off)"""
    program = make_search(kind, chip)
    ranges = program.choices.ranges
    for wishes in ((1e-9, 1e-9, 1e-9, 1e-9, -1, -1), (1e12, 2e12, 1e9, 1e12, 10**9, 10**9)):
        row = program.choices.to_dict(program.find_nearest_row(*wishes))
        assert all(low <= row[name] <= high for name, (low, high) in ranges.items())
        end = 0 if wishes[4] < 0 else 1
        assert row["leave"] == ranges["leave"][end]
