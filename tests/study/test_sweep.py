"""stage.study and scripts/sweep.py: nothing is lost and nothing counts twice, whoever is killed; results do not depend on where."""

import importlib.util
import json
import os
import pty
import random
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import pytest
from examples import SEED

pytest.importorskip("pyarrow", reason="studies are kept in Parquet files: pip install pyarrow")

import pyarrow.dataset
import pyarrow.parquet as pq

from stage.chips import PCL240K, PCL240MS
from stage.errors import ArgumentError, StageError
from stage.study import Definition, Processes, Ray, Record, Study, Threads, Trial, Values, read, read_definition, run
from stage.study.objectives import SPACE, preset_moves, profile_of

HERE = Path(__file__).parent
SWEEP = HERE.parents[1] / "scripts" / "sweep.py"
MINE = {"R2": "400:3600", "R4": "10:600:log", "R7": "12"}
TRIALS = 80


def objective(name):
    return f"sweep_objectives:{name}"


def definition(function="valley", trials=TRIALS, **options):
    return Definition(objective(function), space=MINE, trials=trials, seed=240, options=options)


def results(folder, definition, executor=None, **more):
    """Run a study without disturbance; its table."""
    with Study.open(folder, definition) as study, executor or Threads(definition.objective, 2) as where:
        run(study, where, **more)
    return read(folder)


@pytest.fixture(scope="module")
def cluster():
    """The address of a Ray cluster of two workers on this machine."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install ray")
    from ray.cluster_utils import Cluster

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    node = {"num_cpus": 2, "include_dashboard": False, "object_store_memory": 100_000_000}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    yield cluster.address
    cluster.shutdown()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed") / "study"
    return results(folder, definition(sleep=0.0), Threads(objective("valley"), 1))


def command(folder, *more, trials=TRIALS, name="valley"):
    space = [f"{register}={values}" for register, values in MINE.items()]
    return [
        sys.executable, str(SWEEP), "--out", str(folder), "--trials", str(trials), "--seed", "240", "--workers", "2",
        "--objective", objective(name), "--space", *space, *more,
    ]  # fmt: skip


@pytest.fixture
def swept(monkeypatch, capsys):
    """Runs the command in this process, beside its objectives; its exit code, and what it printed on stdout and stderr."""
    spec = importlib.util.spec_from_file_location("sweep", SWEEP)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    monkeypatch.chdir(HERE)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def run(command):
        monkeypatch.setattr(sys, "argv", command[1:])
        return script.main(), *capsys.readouterr()

    return run


def start(*args, **more):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command(*args, **more), cwd=HERE, start_new_session=True, **pipes)


def recorded(folder):
    """How many trials a reader of the folder sees now."""
    parts = folder / "trials"
    if not any(parts.glob("part-*")):
        return 0
    return pyarrow.dataset.dataset(parts, format="parquet").count_rows()


def wait_for(condition, seconds=40):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds} s for {condition}"
        time.sleep(0.01)


def log_of(path):
    """(id, pid) of each evaluation."""
    return [tuple(map(int, line.split())) for line in path.read_text().splitlines()]


def assert_all_once(table, undisturbed):
    assert table["id"].to_pylist() == list(range(TRIALS))
    assert table.equals(undisturbed)


# Killed drivers


@pytest.mark.parametrize(
    "way", ["processes", *(pytest.param(way, marks=pytest.mark.slow) for way in ("threads", "ray"))]
)
def test_a_killed_driver_resumes_with_the_same_command_and_runs_only_what_lacks(way, tmp_path, undisturbed, request):
    seed = SEED
    print(f"seed {seed}")
    rng = random.Random(seed)
    folder, log = tmp_path / "study", tmp_path / "log"
    how = {"processes": [], "threads": ["--threads"]}.get(way)
    how = ["--ray", request.getfixturevalue("cluster")] if how is None else how
    options = ["--option", f"log={log}", "sleep=0.08"]  # so that it is killed in the middle on a busy machine, too
    driver = start(folder, *how, *options)
    target = rng.randrange(1, 20)
    wait_for(lambda: recorded(folder) >= target or driver.poll() is not None)
    time.sleep(rng.random() * 0.3)
    driver.kill()
    driver.communicate()
    assert driver.returncode == -signal.SIGKILL
    kept = read(folder)["id"].to_pylist()
    assert target <= len(kept) < TRIALS
    time.sleep(0.1)  # a trial that was under way may still end
    again = start(folder, *how, *options)
    out, err = again.communicate(timeout=60)
    assert again.returncode == 0, err
    assert f"{TRIALS} of {TRIALS} trials done, 0 failed" in out
    assert_all_once(read(folder), undisturbed)
    evaluated = Counter(id for id, _ in log_of(log))
    assert all(evaluated[id] == 1 for id in kept)
    assert set(evaluated) == set(range(TRIALS))
    assert recorded(folder) == TRIALS  # no row is there twice, not even to a plain reader


def test_workers_end_when_their_driver_is_killed(tmp_path):
    folder, log = tmp_path / "study", tmp_path / "log"
    driver = start(folder, "--option", f"log={log}", "sleep=0.03")
    wait_for(lambda: log.exists() and len({pid for _, pid in log_of(log)}) == 2)
    driver.kill()
    driver.communicate()
    wait_for(lambda: not any(alive(pid) for _, pid in log_of(log)), 10)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_ctrl_c_records_what_is_finished_and_says_how_to_go_on(number, tmp_path, undisturbed):
    folder, log = tmp_path / "study", tmp_path / "log"
    driver = start(folder, "--option", f"log={log}", "sleep=0.03")
    wait_for(lambda: log.exists() and len(log_of(log)) > 20)
    if number == signal.SIGINT:
        os.killpg(driver.pid, number)  # as a terminal does: the workers get it, too
    else:
        driver.send_signal(number)
    out, err = driver.communicate(timeout=20)
    assert driver.returncode == 130
    kept = recorded(folder)
    assert 18 < kept < TRIALS
    assert len(log_of(log)) - kept <= 2  # those that ran
    assert f"{kept} of {TRIALS} trials done" in out
    assert err == f"stopped; {TRIALS - kept} trials lack. To go on: {shlex.join(['python', *driver.args[1:]])}\n"
    assert_all_once(results(folder, definition(log=str(log), sleep=0.03)), undisturbed)


# Killed workers


def killing(log, deaths):
    """A progress callback that kills a worker now and then, by the pids in the log."""
    killed = []

    def progress(tally):
        if len(killed) < deaths and log.exists() and len(log_of(log)) > 20 * (len(killed) + 1):
            pid = log_of(log)[-1][1]
            if pid not in killed and alive(pid):
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    return progress, killed


def test_the_trial_of_a_killed_worker_process_is_run_again(tmp_path, undisturbed, monkeypatch):
    log = tmp_path / "log"
    progress, killed = killing(log, 2)
    wanted = definition(log=str(log))
    with Study.open(tmp_path / "study", wanted) as study, Processes(wanted.objective, 2) as workers:
        tally = run(study, workers, progress=progress)
        pids = set(workers.pids)
    assert len(killed) == 2
    assert not pids & set(killed)
    assert tally.again <= 2
    assert_all_once(read(tmp_path / "study"), undisturbed)
    assert len(log_of(log)) <= TRIALS + 2


def test_a_worker_killed_in_its_sleep_takes_no_trial_along(tmp_path):
    wanted = definition(trials=6, sleep=0.0)
    with Processes(wanted.objective, 1) as workers:
        outcomes = []
        for id in range(6):
            workers.submit(wanted.trial(id))
            while not (got := workers.wait(1)):
                pass
            outcomes += got
            if id == 2:
                os.kill(workers.pids[0], signal.SIGKILL)
                workers._workers[0].process.join()  # /proc calls it dead before its threads have let go of the pipe
    assert [(id, outcome.kind) for id, outcome in outcomes] == [(id, "values") for id in range(6)]


def test_a_trial_that_kills_every_worker_is_given_up_and_the_others_are_done(tmp_path):
    log = tmp_path / "log"
    wanted = definition("kills_its_worker_at_five", trials=12, log=str(log), sleep=0.0)
    table = results(tmp_path / "study", wanted, Processes(wanted.objective, 2))
    rows = table.to_pylist()
    assert [r["id"] for r in rows if r["status"] == "failed"] == [5]
    assert rows[5]["error"] == "took 5 workers with it; the last one: killed by SIGKILL"
    assert Counter(id for id, _ in log_of(log)) == {id: 5 if id == 5 else 1 for id in range(12)}


def test_the_trial_of_a_killed_ray_worker_is_run_again(cluster, tmp_path, undisturbed):
    log = tmp_path / "log"
    progress, killed = killing(log, 2)
    wanted = definition(log=str(log))
    with Study.open(tmp_path / "study", wanted) as study, Ray(wanted.objective, 2, cluster) as workers:
        tally = run(study, workers, progress=progress)
    assert len(killed) == 2
    assert 1 <= tally.again <= 4
    assert_all_once(read(tmp_path / "study"), undisturbed)


# Trials that raise


@pytest.mark.parametrize("executor", [Threads, Processes])
def test_a_trial_that_raises_is_tried_twice_more_and_recorded_with_its_message(executor, tmp_path):
    log = tmp_path / "log"
    wanted = definition("raises_at_five", trials=12, log=str(log), sleep=0.0)
    rows = results(tmp_path / "study", wanted, executor(wanted.objective, 2)).to_pylist()
    assert rows[5]["status"] == "failed"
    assert rows[5]["error"] == f"ValueError: R4 = {rows[5]['R4']} is not to my taste"
    assert rows[5]["attempts"] == 3
    assert rows[5]["score"] is None
    assert all(r["status"] == "done" and r["attempts"] == 1 and r["error"] is None for r in rows if r["id"] != 5)
    assert Counter(id for id, _ in log_of(log))[5] == 3
    results(tmp_path / "study", wanted)
    assert Counter(id for id, _ in log_of(log))[5] == 3  # a failure is a result, too


@pytest.mark.parametrize("executor", [Threads, Processes])
def test_a_trial_that_exits_fails_and_ends_nothing_else(executor, tmp_path):
    wanted = definition("exits_at_five", trials=12, sleep=0.0)
    rows = results(tmp_path, wanted, executor(wanted.objective, 2)).to_pylist()
    assert [(r["id"], r["error"]) for r in rows if r["status"] == "failed"] == [(5, "SystemExit: enough")]
    assert len(rows) == 12


def test_a_trial_that_succeeds_at_the_second_attempt_is_done(tmp_path):
    wanted = definition("fails_at_first", trials=5, log=str(tmp_path / "log"))
    rows = results(tmp_path / "study", wanted, Threads(wanted.objective, 1)).to_pylist()
    assert [(r["status"], r["attempts"], r["score"], r["error"]) for r in rows] == [
        ("done", 2, k, None) for k in range(5)
    ]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nothing", "returned None: a dict of numbers"),
        ("words", "a='ten': a number of 64 bits"),
        ("huge", f"a={2**64}: a number of 64 bits"),
        ("register", "measured 'R2'"),
        ("own", "measured 'id'"),
    ],
)
def test_an_objective_that_measures_nonsense_fails_its_trial_with_a_reason(name, message, tmp_path):
    wanted = definition("measures_nonsense", trials=1, name=name)
    assert message in results(tmp_path / "study", wanted)["error"][0].as_py()


# Results do not depend on where and how


def test_every_executor_gives_the_same_bits_for_real_moves(tmp_path):
    wanted = Definition("stage.study.objectives:preset_moves", space=SPACE, trials=8, seed=3, options={"pulses": 4000})
    tables = [
        results(tmp_path / f"{k}", wanted, executor(wanted.objective, count))
        for k, (executor, count) in enumerate([(Threads, 1), (Threads, 3), (Processes, 2)])
    ]
    assert set(tables[0]["status"].to_pylist()) == {"done"}
    assert len(set(tables[0]["score"].to_pylist())) == 8
    assert tables[0].equals(tables[1])
    assert tables[0].equals(tables[2])


@pytest.mark.slow
def test_a_local_ray_gives_the_same_bits_for_real_moves(tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install ray")
    wanted = Definition("stage.study.objectives:preset_moves", space=SPACE, trials=8, seed=3, options={"pulses": 4000})
    here = results(tmp_path / "here", wanted)
    assert results(tmp_path / "ray", wanted, Ray(wanted.objective, 2)).equals(here)


def test_a_preset_move_is_measured_as_its_report_says(tmp_path):
    gentle = {"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}
    good = preset_moves(Trial(0, gentle, 1, {"pulses": 8000}))
    assert (good["lost_steps"], good["reached"]) == (0, 1)
    assert good["duration"] == pytest.approx(8000 / 32_000 + 620 * 400 / 4_915_200, rel=0.02)
    assert good["duration"] <= good["score"] < good["duration"] + 0.02
    assert 0 < good["vibration"] < 20e-6
    harsh = preset_moves(Trial(1, gentle | {"R2": 2800, "R4": 10, "R5": 10}, 1, {"pulses": 8000}))
    assert harsh["lost_steps"] > 0
    assert harsh["reached"] == 0
    assert harsh["score"] > 10


def test_a_camera_on_a_mast_rings_less_after_s_curves():
    registers = {"R1": 4, "R2": 1280, "R4": 963, "R5": 963, "R7": 12}
    options = {"model": "xy_mast", "chips": "pcl240ms", "pulses": 42_100, "rest": 0.5}
    linear = preset_moves(Trial(0, registers, 1, options))
    curved = preset_moves(Trial(0, registers | {"R14": 0, "R15": 0}, 1, options))
    assert curved["vibration"] < linear["vibration"] / 2
    assert linear["vibration"] == pytest.approx(0.62e-3, rel=0.2)  # README


def test_a_study_may_grow_and_its_first_trials_stay(tmp_path):
    short = results(tmp_path / "study", definition(trials=10, sleep=0.0))
    long = results(tmp_path / "study", definition(trials=25, sleep=0.0))
    assert long.slice(0, 10).equals(short)
    assert long["id"].to_pylist() == list(range(25))
    assert read_definition(tmp_path / "study").trials == 25


# The folder


def test_another_study_in_the_folder_is_refused_with_what_differs_unless_forced(tmp_path):
    folder = tmp_path / "study"
    first = results(folder, definition(trials=4, sleep=0.0))
    other = Definition(objective("valley"), space=MINE | {"R4": "10:300"}, trials=4, seed=7, options={"sleep": 0.01})
    with pytest.raises(ArgumentError, match="another study") as error:
        Study.open(folder, other)
    for line in (
        "seed: 240 before, 7 now",
        "space R4: 10:600:log before, 10:300 now",
        "options sleep: 0.0 before, 0.01 now",
    ):
        assert line in str(error.value)
    assert read(folder).equals(first)
    with pytest.raises(ArgumentError, match="trials: 4 before, 3 now; a study only grows"):
        Study.open(folder, definition(trials=3, sleep=0.0))
    with Study.open(folder, other, force=True) as study:
        assert study.pending() == [0, 1, 2, 3]
    assert read(tmp_path / "study.1").equals(first)


def test_other_versions_of_the_packages_make_another_study(tmp_path):
    first = definition(trials=2)
    Study.open(tmp_path, first).close()
    path = tmp_path / "study.json"
    path.write_text(path.read_text().replace(first.versions["mujoco"], "3.0.0"))
    with pytest.raises(ArgumentError, match=f"versions mujoco: 3.0.0 before, {first.versions['mujoco']} now"):
        Study.open(tmp_path, first)


def test_two_processes_cannot_add_to_one_study(tmp_path):
    with Study.open(tmp_path, definition()), pytest.raises(StageError, match="another process is at work"):
        Study.open(tmp_path, definition())
    Study.open(tmp_path, definition()).close()


def test_a_trial_recorded_twice_counts_once(tmp_path):
    wanted = definition(trials=3)
    with Study.open(tmp_path, wanted) as study:
        study.append([Record(wanted.trial(k), {"score": 1.0 * k}) for k in (0, 1)])
        study.append([Record(wanted.trial(k), {"score": 9.0}) for k in (1, 2)])
        assert (study.done, study.pending()) == (3, [])
    assert recorded(tmp_path) == 3
    (tmp_path / "trials" / "part-000099.parquet").write_bytes(
        (tmp_path / "trials" / "part-000001.parquet").read_bytes()
    )
    assert recorded(tmp_path) == 5  # someone copied a part
    assert read(tmp_path)["score"].to_pylist() == [0.0, 1.0, 9.0]
    with Study.open(tmp_path, wanted) as study:
        assert (study.done, study.pending()) == (3, [])


def test_a_write_that_a_kill_cuts_short_leaves_no_trace(tmp_path):
    wanted = definition(trials=4)
    with Study.open(tmp_path, wanted) as study:
        study.append([Record(wanted.trial(0), {"score": 1.0})])
    whole = (tmp_path / "trials" / "part-000001.parquet").read_bytes()
    stray = tmp_path / "trials" / ".part-000002.parquet.tmp"
    stray.write_bytes(whole[: len(whole) // 2])
    assert recorded(tmp_path) == 1
    assert read(tmp_path).num_rows == 1
    with Study.open(tmp_path, wanted) as study:
        assert study.pending() == [1, 2, 3]
        assert not stray.exists()


def test_columns_that_come_later_are_in_every_part_also_after_a_kill(tmp_path, monkeypatch):
    wanted = definition("columns_vary", trials=8)
    table = results(tmp_path / "study", wanted, Threads(wanted.objective, 1), batch=1)
    assert table["score"].to_pylist() == [None, None, 2.0, 3.0, 4.5, 5.5, 6.5, 7.5]
    assert table["late"].to_pylist() == [None] * 6 + [6, 7]
    plain = pyarrow.dataset.dataset(tmp_path / "study" / "trials", format="parquet").to_table().sort_by("id")
    assert plain.equals(table)
    with Study.open(tmp_path / "cut", wanted) as study:
        for k in range(3):
            study.append([Record(wanted.trial(k), error="nothing yet")])
        replaced, real = [], os.replace

        def dies_at_the_third(source, target):
            replaced.append(target)
            if len(replaced) == 3:
                raise KeyboardInterrupt
            real(source, target)

        monkeypatch.setattr(os, "replace", dies_at_the_third)
        with pytest.raises(KeyboardInterrupt):
            study.append([Record(wanted.trial(3), {"score": 3})])
        monkeypatch.undo()
    assert read(tmp_path / "cut")["id"].to_pylist() == [0, 1, 2]
    with Study.open(tmp_path / "cut", wanted) as study:
        assert study.pending() == [3, 4, 5, 6, 7]
    assert len({pq.read_schema(p) for p in (tmp_path / "cut" / "trials").glob("part-*")}) == 1


def test_the_folder_can_be_read_at_any_time_while_a_study_runs(tmp_path):
    wanted = definition(sleep=0.002)
    counts, over = [], threading.Event()

    def look():
        while not over.is_set():
            counts.append((recorded(tmp_path), read(tmp_path).num_rows))

    Study.open(tmp_path, wanted).close()
    reader = threading.Thread(target=look)
    reader.start()
    try:
        results(tmp_path, wanted, batch=3)
    finally:
        over.set()
        reader.join()
    assert all(a <= b for (a, b) in counts)
    assert counts == sorted(counts)
    assert len({a for a, _ in counts}) > 3


def test_a_study_whose_driver_was_killed_before_its_first_trial_can_be_read_and_gone_on_with(tmp_path):
    wanted = definition(trials=3, sleep=0.0)
    (tmp_path / "trials").mkdir()
    (tmp_path / "study.json").write_text(wanted.to_json())
    assert read(tmp_path).num_rows == 0
    assert read(tmp_path).column_names[:5] == ["id", "seed", "status", "attempts", "error"]
    assert results(tmp_path, wanted).num_rows == 3


def test_a_folder_that_cannot_be_one_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StageError, match="cannot be a study's folder"):
        Study.open(tmp_path / "file", definition())
    with pytest.raises(ArgumentError, match="holds no study"):
        read(tmp_path)


def test_a_part_that_cannot_be_read_is_named(tmp_path):
    results(tmp_path, definition(trials=3, sleep=0.0))
    part = tmp_path / "trials" / "part-000001.parquet"
    part.write_bytes(part.read_bytes()[:-9])
    with pytest.raises(StageError, match=r"part-000001\.parquet cannot be read"):
        read(tmp_path)


# Definitions


def test_values_are_drawn_within_their_range_and_a_log_range_is_even_on_a_log_scale():
    ids = range(3000)
    wanted = Definition("a:b", space={"R1": "7", "R2": "3,5", "R4": "2:4", "R5": "1:1000:log"}, trials=3000, seed=1)
    drawn = {name: Counter(wanted.trial(k).registers[name] for k in ids) for name in wanted.space}
    assert set(drawn["R1"]) == {7}
    assert set(drawn["R2"]) == {3, 5}
    assert set(drawn["R4"]) == {2, 3, 4}
    assert min(drawn["R4"].values()) > 850
    below = sum(count for value, count in drawn["R5"].items() if value < 32)
    assert 1400 < below < 1600
    assert 1 <= min(drawn["R5"]) < max(drawn["R5"]) <= 1000
    assert len({wanted.trial(k).seed for k in ids}) == 3000


def test_a_grid_has_every_combination_once():
    grid = Definition("a:b", "grid", space={"R2": "400:800/3", "R4": "10:1000:log/3", "R7": "12,24"})
    points = [tuple(grid.trial(k).registers.values()) for k in range(grid.trials)]
    assert points[:3] == [(400, 10, 12), (400, 10, 24), (400, 100, 12)]
    assert len(set(points)) == len(points) == 18
    assert {p[0] for p in points} == {400, 600, 800}


def test_a_definition_survives_its_file(tmp_path):
    for wanted in (definition(note=["a", 1.5]), Definition("a:b", "list", rows=[{"R2": 5}, {"R2": 6}])):
        assert Definition.from_json(wanted.to_json()) == wanted


def test_registers_of_a_trial_are_a_profile_and_what_lacks_or_is_unknown_is_named():
    plain = {"R1": 25, "R2": 500, "R4": 90, "R5": 80, "R7": 12}
    made = profile_of(plain, PCL240K)
    assert made.registers() == plain | {"R3": 500}
    assert (made.spans, made.chip) == (None, PCL240K)
    assert profile_of(plain | {"R3": 7}, PCL240K).R3 == 7
    for curved, spans in (({"R14": 5}, (5, 0)), ({"R15": 6}, (0, 6)), ({"R14": 5, "R15": 6}, (5, 6))):
        assert profile_of(plain | curved, PCL240MS).spans == spans
    with pytest.raises(ArgumentError, match="unknown PCL240K speed register 'R14'"):
        profile_of(plain | {"R14": 5}, PCL240K)
    for name in plain:
        with pytest.raises(ArgumentError, match=f"a preset move needs {name}, too"):
            profile_of({n: v for n, v in plain.items() if n != name}, PCL240K)
    for options, message in (
        ({"pulse": 3}, "unknown option 'pulse'"),
        ({"chips": "mcx514"}, "unknown chip"),
        ({"axis": "w"}, "axis 'w'"),
    ):
        with pytest.raises(ArgumentError, match=message):
            preset_moves(Trial(0, plain, 1, {"model": "xy"} | options))


@pytest.mark.parametrize(
    ("was", "now", "lines"),
    [
        ({}, {}, []),
        ({}, {"trials": 9}, []),
        ({}, {"trials": 4}, ["trials: 5 before, 4 now; a study only grows"]),
        ({}, {"space": {"R4": "3", "R2": "1:2"}}, ["order of registers: R2 R4 before, R4 R2 now"]),
        ({}, {"space": {"R2": "1:2"}}, ["space R4: 3 before, not given now"]),
        ({}, {"objective": "a:c"}, ["objective: a:b before, a:c now"]),
        ({}, {"options": {"rest": 1}}, ["options rest: not given before, 1 now"]),
        ({"method": "list", "rows": [{"R2": 1}]}, {"method": "list", "rows": [{"R2": 2}]},
         ["rows: 1 before, 1 now, not the same"]),
        ({"method": "list", "rows": [{"R2": 1}]}, {"method": "list", "rows": [{"R2": 1}, {"R2": 2}]},
         ["rows: 1 before, 2 now, not the same"]),
    ],
)  # fmt: skip
def test_what_keeps_a_study_from_going_on_is_told_line_by_line(was, now, lines):
    usual = {"objective": "a:b", "space": {"R2": "1:2", "R4": "3"}, "trials": 5}
    first, second = (Definition(**usual | g | ({"trials": 0, "space": {}} if "rows" in g else {})) for g in (was, now))
    assert first.differences(second) == lines


@pytest.mark.parametrize("text", ["", "a", "5:4", "0:9:log", "1:9:lin", "1:9/1", "1:9/x", "1:2:log:3", "1.5", "-5:5"])
def test_values_that_make_no_sense_are_refused(text):
    with pytest.raises(ArgumentError, match="R2="):
        Values.parse("R2", text)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"method": "best"}, "unknown method"),
        ({"space": {}}, "give a space"),
        ({"trials": 0}, "1 or more"),
        ({"seed": -1}, "seed=-1"),
        ({"method": "grid", "space": {"R2": "1:5"}, "trials": 0}, "a grid needs points"),
        ({"method": "list", "rows": [{"R2": 1}, {"R4": 1}]}, "all of the same registers"),
        ({"options": {"a": {1}}}, "study.json must be able to hold them"),
    ],
)
def test_a_definition_that_makes_no_sense_is_refused(given, message):
    with pytest.raises(ArgumentError, match=message):
        Definition(**({"objective": "a:b", "space": MINE, "trials": 5} | given))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_colon", "give module:function"),
        ("not.there:f", "No module named"),
        ("sweep_objectives:nothing", "has no nothing"),
        ("sweep_objectives:not_a_function", "is not a function"),
    ],
)
@pytest.mark.parametrize("executor", [Threads, Processes])
def test_an_objective_that_is_not_there_ends_the_run_and_records_nothing(name, message, executor, tmp_path):
    wanted = Definition(name, space=MINE, trials=3)
    with pytest.raises(StageError, match=message):
        results(tmp_path, wanted, executor(name, 1))
    assert recorded(tmp_path) == 0


def test_without_ray_everything_else_works_and_ray_says_what_to_install(tmp_path, monkeypatch):
    args = command(tmp_path, "--threads", "--option", "sleep=0", trials=3)[1:]
    blocked = f"import runpy, sys; sys.modules['ray'] = None; sys.argv = {args}; runpy.run_path({args[0]!r}, run_name='__main__')"
    made = subprocess.run([sys.executable, "-c", blocked], cwd=HERE, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert recorded(tmp_path) == 3
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(StageError, match="Ray is not installed: pip install"):
        Ray(objective("valley"), 2)


def test_without_pyarrow_a_study_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("stage.study.trials.pa", None)
    for use in (lambda: Study.open(tmp_path, definition()), lambda: read(tmp_path)):
        with pytest.raises(StageError, match="pip install 'pulsestage"):
            use()


def test_a_ray_that_is_not_there_is_said_to_be_out_of_reach():
    pytest.importorskip("ray", reason="Ray is not installed: pip install ray")
    with pytest.raises(StageError, match="cannot be reached"):
        Ray(objective("valley"), address="nonsense")


# The command


def test_progress_is_one_line_of_a_terminal_and_nothing_in_a_pipe(tmp_path, swept):
    ours, theirs = pty.openpty()
    args = command(tmp_path / "shown", "--threads", "--option", "sleep=0.005")
    shown = subprocess.Popen(args, cwd=HERE, stdout=subprocess.PIPE, stderr=theirs)
    os.close(theirs)
    said = b""
    while True:
        try:
            said += os.read(ours, 4096)
        except OSError:  # how a terminal says that the other side has gone
            break
    os.close(ours)
    shown.communicate()
    text = said.decode()
    assert text.count("\n") == 1
    assert f"{TRIALS} of {TRIALS} done, 0 failed, 0 running" in text
    assert "/s, " in text
    assert "best " in text
    _, said, progress = swept(command(tmp_path / "piped", "--threads", "--option", "sleep=0"))
    assert progress == ""
    assert len(said.splitlines()) == 2


def test_the_report_prints_the_best_trials_and_what_failed(tmp_path, swept):
    wanted = definition("raises_at_five", trials=12, sleep=0.0)
    table = results(tmp_path, wanted).to_pylist()
    _, said, _ = swept([sys.executable, str(SWEEP), "--report", "--out", str(tmp_path), "--top", "3"])
    lines = said.splitlines()
    assert lines[0] == f"{tmp_path}: 11 of 12 trials done, 1 failed"
    assert lines[3].split() == ["id", "score", "twice", "R2", "R4", "R7"]
    best = sorted((t["score"], t["id"]) for t in table if t["id"] != 5)[:3]
    assert [int(line.split()[0]) for line in lines[4:7]] == [id for _, id in best]
    assert f"failed, 1: {table[5]['error']}" in said


def test_the_trials_of_a_file_are_run_in_its_order(tmp_path, swept):
    rows = [{"R2": 1000, "R4": 200}, {"R2": 900, "R4": 100}]
    (tmp_path / "trials.csv").write_text("R2,R4\n1000,200\n900,100\n")
    listed = ["--list", str(tmp_path / "trials.csv"), "--out", str(tmp_path / "study"), "--threads"]
    code, _, errors = swept([sys.executable, str(SWEEP), *listed, "--objective", objective("valley")])
    assert code == 0, errors
    assert read(tmp_path / "study").select(["R2", "R4"]).to_pylist() == rows


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--trials", "0"], "how many?"),
        (["--space", "R2"], "'R2': give NAME=VALUE"),
        (["--list", "no.csv"], "leave --grid, --trials and --space out"),
        (["--ray", "--threads"], "not both"),
        (["--workers", "0"], "workers=0"),
        (["--report"], "holds no study"),
    ],
)
def test_wrong_usage_says_what_to_do_and_makes_no_trials(more, message, tmp_path, swept):
    wrong = command(tmp_path / "study", *more)
    if message == "how many?":  # as a process, too
        made = subprocess.run(wrong, cwd=HERE, capture_output=True, text=True)
        code, said = made.returncode, made.stderr
    else:
        code, _, said = swept(wrong)
    assert code == 2
    assert message in said
    assert said.startswith("sweep: ")
    assert recorded(tmp_path / "study") == 0


def test_study_json_says_what_the_study_is(tmp_path):
    Study.open(tmp_path, definition(trials=3)).close()
    said = json.loads((tmp_path / "study.json").read_text())
    assert said["objective"] == objective("valley")
    assert said["space"] == MINE
    assert (said["seed"], said["trials"], said["method"]) == (240, 3, "random")
