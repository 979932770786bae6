"""`stage tune`: the formula, a search that keeps its margin, and a proof by moves that the search did not make."""

import json
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.board import Board, NativeHost, NoCompilerError, build
from stage.board.firmware_library import find_compiler
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, PCL240MS
from stage.chips.cycle_descriptions import Statement
from stage.cli import main
from stage.drives.dynamometer import compute_natural_frequency
from stage.envs.reduced_model import reduce_model
from stage.errors import ArgumentError, StageError
from stage.firmware.driver import ImmediateOperations, Speeds, get_driver
from stage.tune import MoveCase, Task, bus_listing, proof, tune
from stage.tune.c_header import format_c_header
from stage.tune.formula import Load, compute_speeds
from stage.tune.move_runner import MoveOutcomes, MoveRunner
from stage.tune.position_sampler import SAMPLE_INTERVAL_S
from stage.tune.register_planners import create_planner
from stage.tune.search import compute_time_limit, search_registers

PULSES, PAYLOAD = 400, 2.0
LIMIT = 0.1  # s


def make_task(chip=PCL240K, **settings):
    stage = Stage(reduce_model("xy", "x"), chips=chip, visuals=False)
    return Task(stage, "x", **{"pulses": PULSES, "payload": PAYLOAD, "hold": 0.02, **settings})


@pytest.fixture(scope="module")
def task():
    return make_task()


@pytest.fixture(scope="module")
def runner(task):
    with MoveRunner(task, create_planner(task), fleet_size=8) as runner:
        yield runner


@pytest.fixture(scope="module")
def result():
    pytest.importorskip("optuna")
    return tune(make_task(), trials=8, moves=8, seed=3)


def test_the_answer_keeps_step_up_to_the_margin_in_moves_that_the_search_did_not_make(result):
    answer = result.answer
    assert answer.is_proved
    assert answer.proof.good_count == answer.proof.move_count == 8
    assert answer.spare_payload >= result.task.margin == pytest.approx(0.6)
    assert f"keeps step in 8 of 8 drawn machines with up to {2.6} kg" in str(result)
    formula = result.answers[0]
    assert formula.name == "formula"
    if result.selected_name == "search":
        assert answer.proof.mean_time < formula.proof.mean_time - 5e-4
        assert "faster than the formula's" in result.explain_selection()


@pytest.mark.parametrize("chip", [PCL240K, PCL240MS, MCX514, MCX304, HCTL1100])
def test_a_negative_distance_gets_the_bytes_of_a_move_in_the_minus_direction(chip):
    """Regression: `stage tune xy --distance -100mm` printed the bytes of +100 mm."""
    plus, minus = (tune(make_task(chip, pulses=direction * PULSES), by="formula", moves=4) for direction in (1, -1))
    assert (minus.task.pulses, minus.task.direction, minus.json()["pulses"]) == (PULSES, -1, -PULSES)
    assert minus.answer.plan == plus.answer.plan, "a proof moves in both directions"
    assert f"({-PULSES} " in str(minus)
    assert f"({-PULSES} " in minus.c_source()
    traveled_pulses = []
    for result in (plus, minus):
        stage = result.task.copy_stage()
        axis = stage.axes["x"]
        start = axis.position
        for cycle in result.bus_cycles:
            if cycle.address is None:
                stage.run(cycle.value * 1e-9)
            else:
                axis.chip.write(cycle.address, cycle.value)
        stage.run(LIMIT)
        traveled_pulses.append((axis.position - start) / axis.meters_per_pulse)
    assert traveled_pulses == pytest.approx([PULSES, -PULSES], abs=10)


def test_the_listed_bus_cycles_make_the_move_and_leave_the_listed_register_values(result):
    stage = result.task.copy_stage()
    axis = stage.axes["x"]
    for cycle in result.bus_cycles:
        axis.chip.write(cycle.address, cycle.value)
    values = axis.chip.values()
    assert not axis.chip.diagnostics
    for name, value in result.answer.plan.registers.items():
        assert values[name] == value
        assert re.search(
            rf"^{name} +{value} +{value:0{3}X}h".replace(f"{value:03X}", f"0*{value:X}"),
            result.format_register_table(),
            re.M,
        )
    stage.run(0.5)
    assert (axis.chip.net(), axis.lost_steps) == (PULSES, 0)


def test_the_c_header_compiles_without_a_warning_and_makes_the_same_move(result, tmp_path):
    try:
        find_compiler()
    except NoCompilerError as error:
        pytest.skip(str(error))
    (tmp_path / "tuned.h").write_text(result.c_source("x_axis"))
    (tmp_path / "driver.c").write_text("""
        #define _DEFAULT_SOURCE
        #define PULSESTAGE_LINUX_IO
        #include <pulsestage.h>
        #include "tuned.h"
        static void write_chip(unsigned address, unsigned long value) { ps_out8(0x300 + address, (unsigned char)value); }
        static void wait_us(unsigned long us) { usleep((unsigned)us); }
        PULSESTAGE_MAIN
        {
            x_axis_move(write_chip, wait_us);
            while (inb(0x300) & 0x40)
                ;
            usleep(100000);
            return X_AXIS_R2;
        }
        """)
    flags = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", f"-I{tmp_path}")
    board = Board(result.task.copy_stage())
    axis = board.stage.axes["x"]
    host_result = NativeHost(build(tmp_path / "driver.c", tmp_path / "driver.so", flags), board, isolated=False).run()
    registers = result.answer.plan.registers
    assert host_result.code == registers["R2"]
    values = axis.chip.values()
    assert {name: values[name] for name in registers} == registers
    assert (axis.chip.net(), axis.lost_steps) == (PULSES, 0)


def test_a_move_that_loses_steps_or_does_not_arrive_is_not_good(task, runner):
    plans = runner.planner
    too_fast = plans.build_plan(plans.compute_speeds(1.5)._replace(drive=100_000, up=2e-3, down=2e-3), {}, "linear")
    formula = plans.build_formula_plan()
    cases = [MoveCase(PAYLOAD, 0.0, 1), MoveCase(PAYLOAD, 7.0, -1)]
    outcome = runner.run_moves([too_fast, formula], cases, LIMIT)
    assert outcome.in_step.tolist() == [[False, False], [True, True]]
    requested = task.is_within_payload(cases)
    assert outcome.find_passed_moves(task, requested).tolist() == [[False, False], [True, True]]
    stopped_early = runner.run_moves([formula], cases, 0.05)
    assert np.isnan(stopped_early.arrival_times).all()
    assert not stopped_early.find_passed_moves(task, requested).any()


def test_the_arrival_time_equals_that_of_the_same_move_on_a_stage(task, runner):
    plan = runner.planner.build_formula_plan()
    arrived = float(runner.run_moves([plan], [MoveCase(PAYLOAD, 0.0, 1)], LIMIT).arrival_times[0, 0])
    stage = task.copy_stage()
    axis = stage.axes["x"]
    goal = task.place_at_start(stage, MoveCase(PAYLOAD, 0.0, 1))
    get_driver(axis).write_move(ImmediateOperations(axis), plan.registers, PULSES)
    begin, last = stage.time, 0.0
    while stage.time < begin + LIMIT:
        stage.run(5e-4)
        if abs(axis.position - goal) > task.tolerance:
            last = stage.time - begin
    assert arrived == pytest.approx(last, abs=1e-6)


def test_a_seed_gives_the_same_search_with_one_and_two_threads(task):
    pytest.importorskip("optuna")
    searches = []
    for workers in (1, 2):
        with MoveRunner(task, create_planner(task), workers, fleet_size=6 + workers) as runner:
            cases = task.build_corner_cases(np.random.default_rng(1), 1)
            searches.append([t[1:] for t in search_registers(runner, cases, cases[:1], LIMIT, 17, seed=5)[0]])
    assert searches[0] == searches[1]


@pytest.mark.parametrize(("first", "further"), [(0.05, 0.03), (0.03, 0.05)])
def test_the_time_of_a_leading_trial_is_the_slowest_of_all_its_cases(task, runner, first, further):
    pytest.importorskip("optuna")
    cases, further_cases = [MoveCase(0.0, 0.0, 1)], [MoveCase(0.0, 1.0, 1), MoveCase(0.0, 2.0, -1)]

    def run_moves(plans, cases_of_move, limit):
        shape = len(plans), len(cases_of_move)
        times = np.full(shape, first if len(cases_of_move) == 1 else further)
        return MoveOutcomes(times, np.ones(shape, bool), np.zeros(shape))

    lanes = SimpleNamespace(planner=runner.planner, task=task, run_moves=run_moves)
    ranked, _ = search_registers(lanes, cases, further_cases, LIMIT, 1, seed=0)
    assert ranked[0].max_time == 0.05


def test_the_time_of_a_trial_is_that_of_its_slowest_move_within_the_payload(task, runner):
    pytest.importorskip("optuna")
    cases, limits, never_arrives = [MoveCase(0.0, 0.0, 1), MoveCase(PAYLOAD + 0.6, 0.0, 1)], [], []

    def run_moves(plans, cases_of_move, limit):
        limits.append(limit)
        times = np.array([[np.nan if never_arrives else 0.04, 0.09]] * len(plans))
        return MoveOutcomes(times, np.ones(times.shape, bool), np.zeros(times.shape))

    lanes = SimpleNamespace(planner=runner.planner, task=task, run_moves=run_moves)
    ranked, _ = search_registers(lanes, cases, [], LIMIT, 16, seed=0)
    assert {(trial.max_time, trial.failed_moves) for trial in ranked} == {(0.04, 0)}
    assert limits == [LIMIT, compute_time_limit(0.04, task.hold)], "a move that is slower than the best is cut off"
    never_arrives.append(True)
    assert search_registers(lanes, cases, [], LIMIT, 1, seed=0)[0][0][2:] == (1.5 * LIMIT, 1)


def test_a_move_that_is_not_sampled_for_the_full_hold_has_not_arrived(task, runner):
    plan, case = runner.planner.build_formula_plan(), MoveCase(PAYLOAD, 0.0, 1)
    arrived = float(runner.run_moves([plan], [case], LIMIT).arrival_times[0, 0])
    for extra_s, is_arrival_expected in ((0.0, True), (-SAMPLE_INTERVAL_S, False)):
        again = runner.run_moves([plan], [case], arrived + task.hold + extra_s).arrival_times[0, 0]
        assert (again == arrived) == is_arrival_expected
        assert np.isnan(again) != is_arrival_expected


def test_the_start_rate_of_a_plan_never_exceeds_its_drive_rate(runner):
    plan = runner.planner.build_plan(Speeds(1000.0, 2000.0, 0.1, 0.1), {"start": 1.0, "drive": -1.0}, "linear")
    assert plan.speeds.start == plan.speeds.drive == pytest.approx(2000 / 1.5)


def test_ctrl_c_ends_the_search_with_the_trials_so_far(task, runner):
    pytest.importorskip("optuna")

    def interrupt_search(done, best):
        raise KeyboardInterrupt

    ranked, stopped = search_registers(
        runner,
        task.build_corner_cases(np.random.default_rng(1), 1)[:2],
        [],
        LIMIT,
        100,
        0,
        on_progress=interrupt_search,
    )
    assert stopped
    assert len(ranked) == 8


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"axis": "w"}, "unknown axis 'w'. Known: x, y."),
        ({"pulses": 200_000}, r"has room for 1 to 95935 pulses between its limit switches \(299.797 mm\)"),
        ({"payload": -1.0}, "0 or more"),
        ({"tolerance": 0.0}, "both more than 0"),
    ],
)
def test_impossible_tasks_are_refused_before_any_move(settings, message):
    arguments = {"axis": "x", "pulses": PULSES, **settings}
    with pytest.raises(ArgumentError, match=message):
        Task(Stage("xy", chips=PCL240K, visuals=False), **arguments)


def test_the_error_of_a_payload_that_is_too_heavy_names_the_largest_possible_one():
    task = Task(Stage("xyz", chips=PCL240K, visuals=False), "z", pulses=1000, payload=80.0)
    with pytest.raises(ArgumentError, match=r"80 kg on axis z: .* Up to [\d.]+ kg it works"):
        create_planner(task).build_formula_plan()


def test_the_load_of_a_vertical_axis_includes_its_weight():
    stage = Stage("xyz", chips=PCL240K, visuals=False)
    z, x = (create_planner(Task(stage, name, pulses=1000, payload=3.0)).build_load(3.0) for name in "zx")
    assert z.weight_per_kg == pytest.approx(9.81)
    assert z.weight > 3.0 * 9.81
    assert x.weight == x.weight_per_kg == 0


def test_friction_helps_to_brake_and_hinders_the_start(task):
    load = replace(Load.from_axis(task.stage.axes["x"]).add_mass(10.0), friction=8.0)
    speeds = compute_speeds(load, 40_000)
    assert speeds.start == pytest.approx(load.pull_in_rate / 8)
    top, low = speeds.drive / load.pulses_per_metre, speeds.start / load.pulses_per_metre
    thrust = float(load.compute_max_thrust(np.array([top]))[0]) / 1.5
    braking_friction = load.friction + load.damping * top
    for seconds, force in ((speeds.up, thrust - braking_friction), (speeds.down, thrust + braking_friction)):
        gentle = (top - low) * compute_natural_frequency(load.drive, load.inertia_at_rotor) / 4
        assert seconds == pytest.approx((top - low) / min(force / load.mass, gentle), rel=1e-6)
    assert speeds.down < 0.9 * speeds.up


def test_the_weight_of_a_vertical_axis_excludes_the_inertia_of_rotor_and_screw():
    stage = Stage("xyz", chips=PCL240K, visuals=False)
    z, model = stage.axes["z"], stage.model
    carried = model.body_subtreemass[model.jnt_bodyid[z.joint]]
    load = Load.from_axis(z)
    assert load.mass > carried + 0.1
    assert load.weight == pytest.approx(9.81 * carried)
    assert load.add_mass(2.0).weight == pytest.approx(9.81 * (carried + 2))


def test_a_payload_that_the_axis_does_not_move_adds_no_mass_to_its_load():
    """Task(stage, "y", payload=9.0, payload_on=...) of the body that only x moves"""
    stage = Stage("xy", chips=PCL240K, visuals=False)
    names = [stage.model.body(int(stage.model.jnt_bodyid[stage.axes[a].joint])).name for a in "xy"]
    other = {a: names[1 - k] for k, a in enumerate("xy")}
    masses = {}
    for axis in "xy":
        task = Task(stage, axis, pulses=PULSES, payload=9.0, payload_on=other[axis])
        masses[axis] = create_planner(task).build_load(9.0).mass - create_planner(task).build_load(0.0).mass
    assert sorted(masses.values()) == pytest.approx([0.0, 9.0])


def test_a_task_has_the_documented_defaults():
    stage = Stage("xy", chips={"x": PCL240K, "y": HCTL1100}, visuals=False)
    x, y = Task(stage, "x", pulses=-PULSES, payload=2.0), Task(stage, "y", pulses=PULSES)
    steps = {axis.name: axis.meters_per_pulse for axis in stage.axes.values()}
    assert (x.pulses, x.hold, x.pulses_per_electrical_turn, y.pulses_per_electrical_turn) == (PULSES, 0.05, 64, 4)
    assert (x.margin, y.margin) == pytest.approx((0.6, 0.3 * y.moving_mass))
    assert (x.tolerance, y.tolerance) == pytest.approx((16 * steps["x"], 10 * steps["y"]))
    assert (x.overshoot, x.payload_with_margin) == pytest.approx((2 * x.tolerance, 2.6))
    assert Task(stage, "x", pulses=PULSES, judge_at="work").overshoot == np.inf
    rng = np.random.default_rng(0)
    for cases in (x.build_corner_cases(rng, 2), x.draw_cases(rng, 16)):
        assert {case.direction for case in cases} == {1, -1}
        assert {0.0, 2.0, 2.6} <= {round(case.payload, 9) for case in cases}
        assert max(abs(case.start_offset) for case in cases) <= 32
        assert max(case.payload for case in cases) == pytest.approx(2.6)


def test_the_spare_payload_is_the_last_one_below_the_first_that_loses_a_step():
    """Two rounds of eight payloads, each at six rotor angles in both directions"""
    task = SimpleNamespace(margin=0.5, payload=2.0, moving_mass=1.0, pulses_per_electrical_turn=64)
    observed = []

    def measure_with_maximum(maximum):
        def run_moves(plans, cases, limit):
            observed.extend(cases)
            return SimpleNamespace(in_step=np.array([[case.payload - 2.0 <= maximum for case in cases]]))

        return proof.measure_spare_payload(
            SimpleNamespace(task=task, run_moves=run_moves), None, LIMIT, np.random.default_rng(0)
        )

    assert measure_with_maximum(9.0) == (2.0, True)
    assert measure_with_maximum(0.8) == (pytest.approx(0.78125), False)
    assert measure_with_maximum(0.76) == (0.75, False), "the first of the second round loses steps"
    assert measure_with_maximum(0.0) == (0.0, False)
    assert measure_with_maximum(1.7499) == (pytest.approx(1.71875), False)
    directions = {}
    for case in observed:
        directions.setdefault(case.payload, []).append(case.direction)
    assert all(sum(signs) == 0 for signs in directions.values())


def test_the_time_saved_is_reported_with_twice_its_standard_error():
    formula, results = (proof.Proof(3, 3, np.array(times), 0.0) for times in ([2.0, 4.0, 6.0], [1.0, 2.0, 3.0]))
    assert proof.compute_time_saved(formula, results) == pytest.approx((2.0, 2 / np.sqrt(3)))
    one = proof.Proof(1, 1, np.array([1.0]), 0.0)
    assert proof.compute_time_saved(one, one) == (0.0, SAMPLE_INTERVAL_S)
    assert (formula.mean_time, formula.max_time, formula.is_passed) == (4.0, 6.0, True)


def test_a_move_that_overshoots_within_the_payload_is_not_good(task):
    distance = task.overshoot
    outcome = MoveOutcomes(
        np.array([[0.1, 0.1, 0.1]]), np.array([[True] * 3]), np.array([[distance, 1.01 * distance, 1.01 * distance]])
    )
    assert outcome.find_passed_moves(task, np.array([True, True, False])).tolist() == [[True, False, True]]


def test_both_ramps_of_a_servo_have_the_longer_duration():
    plans = create_planner(make_task(HCTL1100))
    plans.unloaded = replace(plans.unloaded, friction=10.0)
    speeds, computed = plans.compute_speeds(1.5), compute_speeds(plans.build_load(PAYLOAD), PULSES, 1.5)
    assert computed.down < computed.up
    assert (speeds.up, speeds.down) == (computed.up, computed.up)


def test_a_c_header_sums_waits_and_escapes_comments(task):
    rows = [
        bus_listing.RegisterValue("TP", -40_000, 8, "goal /* of */ a move", ""),
        bus_listing.RegisterValue("SV", 7, 4, "start", "pps"),
    ]
    cycles = [
        bus_listing.BusCycle(6, -1, "a */"),
        bus_listing.BusCycle(None, 1_000_000, ""),
        bus_listing.BusCycle(None, 500_000, ""),
    ]
    text = format_c_header("x", "", [], rows, [*cycles, bus_listing.BusCycle(0, 2, "go")], task.stage.axes["x"].chip)
    assert re.search(r"#define X_TP +-40000L /\* goal / \* of \* / a move \*/", text)
    assert re.search(r"#define X_SV +7 /\* start, pps \*/", text)
    assert "{6, 0xFF, 1500}, /* a * / */" in text
    assert "{0, 0x02, 0}, /* go */" in text


def test_a_register_has_the_digits_that_its_bits_need(task):
    places = {place.name: place.bits for place in task.stage.axes[task.axis].chip.MAP.places}
    register_values = bus_listing.list_register_values(
        task, [Statement(0, "register", "", "", name, 1) for name in places]
    )
    assert {r.name: r.digits for r in register_values} == {
        name: len(f"{(1 << bits) - 1:X}") for name, bits in places.items()
    }
    assert any(bits % 4 for bits in places.values())


def test_a_register_that_was_written_twice_is_listed_once_with_its_last_value(task):
    statements = [Statement(0, "register", "", "", name, value) for name, value in (("R1", 1), ("R2", 2), ("R1", 3))]
    assert [
        (r.name, r.value)
        for r in bus_listing.list_register_values(task, [*statements, Statement(0, "command", "11", "start")])
    ] == [
        ("R2", 2),
        ("R1", 3),
    ]


@pytest.mark.parametrize(
    ("chip", "goal", "write"),
    [
        (MCX514, ("TP", PULSES), "outw(value, 0x300 + 2 * address)"),
        (PCL240MS, ("R0", PULSES), "outb(value, 0x300 + address)"),
        (HCTL1100, ("R29", PULSES & 0xFF), "outb(address, 0x300); outb(value, 0x300 + 1)"),
    ],
)
def test_chips_are_tuned_through_their_drivers_in_both_directions(chip, goal, write):
    task = make_task(chip)
    plans = create_planner(task)
    assert ("s_curve" in plans.ramp_shapes) == (chip is not HCTL1100)
    plan = plans.build_formula_plan()
    with MoveRunner(task, plans, fleet_size=2) as runner:
        outcome = runner.run_moves([plan], [MoveCase(0.0, 5.0, 1), MoveCase(PAYLOAD, 0.0, -1)], 0.4)
    assert outcome.find_passed_moves(task, np.array([True, True])).all()
    program = bus_listing.build_program(plans, plan, PULSES)
    table = {r.name: r.value for r in bus_listing.list_register_values(task, bus_listing.decode_program(task, program))}
    assert table[goal[0]] == goal[1]
    assert plan.registers.items() <= table.items()
    text = format_c_header("x", "", [], [], bus_listing.list_bus_cycles(task, program), task.stage.axes["x"].chip)
    assert write in text


def test_ramps_that_the_chip_refuses_as_too_short_are_lengthened(task):
    plans = create_planner(task)
    real, wanted = plans.driver.compute_move_registers, plans.compute_speeds(1.5)

    def refuse_short_ramps(fl, fh, up, down, *more):
        if min(up, down) < 0.2:
            raise ArgumentError("too steep")
        return real(fl, fh, up, down, *more)

    plans.driver.compute_move_registers = refuse_short_ramps
    speeds = plans.build_formula_plan().speeds
    assert 0.2 <= speeds.down < 0.25
    assert (speeds.start, speeds.drive) == (wanted.start, wanted.drive)


def test_a_camera_on_a_mast_arrives_later_than_its_carriage():
    stage = Stage("xy_mast", chips=PCL240MS, visuals=False)
    arrived = []
    for site in (None, "camera"):
        task = Task(stage, "x", pulses=3200, payload=0.5, tolerance=2e-3, judge_at=site)
        plans = create_planner(task)
        with MoveRunner(task, plans, fleet_size=1) as runner:
            arrived.append(
                float(runner.run_moves([plans.build_formula_plan()], [MoveCase(0.5, 0.0, 1)], 3.0).arrival_times[0, 0])
            )
    assert arrived[1] > arrived[0] + 0.3
    with pytest.raises(ArgumentError, match="mirror"):
        Task(stage, "x", pulses=3200, judge_at="mirror")


@pytest.mark.slow
@pytest.mark.parametrize("chip", [PCL240K, PCL240MS, MCX514, MCX304, HCTL1100])
def test_a_search_of_96_trials_beats_the_formula_by_10_ms(chip):
    task = Task(
        Stage("xy", chips=chip, visuals=False), "x", pulses=32_000 if chip is not HCTL1100 else 20_000, payload=2.0
    )
    results = tune(task, trials=96)
    assert results.selected_name == "search"
    assert results.answer.is_proved
    assert results.answer.proof.mean_time < results.answers[0].proof.mean_time - 0.01


def test_the_command_writes_its_files_and_refuses_before_the_run(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["tune", "xy", "--distance", "1mm", "--settle", "50um", "10ms", "--by", "formula", "--moves", "4"]
    assert main([*command, "-o", "out", "--json"]) == 0
    message = json.loads(capsys.readouterr().out)
    assert message == json.loads((tmp_path / "out/tuned.json").read_text())
    assert message["spare"] == pytest.approx(0.3 * Task(Stage("xy", visuals=False), "x", PULSES).moving_mass), (
        "30 % of the moving mass"
    )
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"tuned.h", "tuned.txt", "tuned.json", "tuned.png"}
    assert (tmp_path / "out/tuned.png").read_bytes().startswith(b"\x89PNG")
    for invalid_command, message in (
        ([*command, "-o", "out"], "give --force"),
        ([*command, "-o", "no/where"], "no is no folder"),
        ([*command, "--spare", "much"], "--spare much: give percent of the payload, such as 30%, or kg, such as 0.6."),
        ([*command, "--settle", "5kg", "1s"], "--settle 5kg: must be greater than 0, in one of nm, um, mm, cm, m"),
        (["tune", "xy"], "--distance: registers are for one distance"),
        ([*command, "--axis", "q"], "unknown axis 'q'. Known: x, y."),
    ):
        assert main(invalid_command) == 2
        assert message in capsys.readouterr().err


def test_an_interrupted_search_prints_its_result_and_exits_with_130(result, capsys, monkeypatch):
    monkeypatch.setattr("stage.tune.tune", lambda *arguments, **settings: replace(result, interrupted=True))
    assert main(["tune", "xy", "--distance", "1mm", "--trials", "8"]) == 130
    assert ", ended by Ctrl-C)" in capsys.readouterr().out


def test_the_error_without_optuna_names_the_extra_and_the_alternative(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert main(["tune", "xy", "--distance", "5mm"]) == 2
    assert (
        "pip install -e '.[tune]' in a checkout of PulseStage; or leave it at the formula: --by formula."
        in capsys.readouterr().err
    )


def test_invalid_arguments_of_tune_are_refused(task):
    for settings in ({"by": "luck"}, {"trials": 0}, {"moves": 0}, {"trials": True}):
        with pytest.raises(ArgumentError):
            tune(task, **settings)
    assert issubclass(ArgumentError, StageError)
