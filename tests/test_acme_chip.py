"""scripts/acme_chip, the project of docs/your_own_chip.md: as if it were installed, and, slowly, installed by pip."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from support.examples import SEED
from support.packages import ACME, acme, installed

import stage.envs  # noqa: F401
from stage import ArgumentError, Stage, firmware
from stage.board import Board
from stage.chips import chip_class
from stage.cli import main
from stage.testing import chip_conformance
from stage.testing.chip_actions import draw_move


@pytest.fixture(autouse=True)
def install_acme_chip(monkeypatch, tmp_path):
    acme(monkeypatch, tmp_path / "site")


@pytest.fixture(scope="module")
def stage_(tmp_path_factory):
    with pytest.MonkeyPatch.context() as monkeypatch:
        acme(monkeypatch, tmp_path_factory.mktemp("site"))
        return Stage("xy", chips={"x": "acme1000", "y": "acme1000"}, visuals=False)


def test_it_keeps_every_promise_of_a_chip():
    chip_conformance("acme1000", seed=SEED, programs=2)


def test_a_drawn_move_stays_within_the_range_of_the_count_register():
    """Compare the full range with a COUNT register that ends at 50; otherwise a move has 60 to 400 pulses."""
    kind = chip_class("acme1000")
    few = tuple(replace(r, legal=(0, 50)) if r.name == "COUNT" else r for r in kind.MAP.registers)
    short = type("SHORT", (kind,), {"MAP": replace(kind.MAP, registers=few)})
    distances = [draw_move(chip(), 0, np.random.default_rng(1))[1] for chip in (kind, short)]
    assert distances[0] > 50 == distances[1]


def test_it_takes_as_many_pulses_down_as_it_took_up():
    chip = chip_class("acme1000")()
    for name, value in {"START": 1000, "DRIVE": 3000, "SLOPE": 20, "COUNT": 900}.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    chip.write(0, chip.MAP.command("MOVE+").code)
    while not chip.state["slowing"]:
        chip.advance(chip.clock_hz // 20_000)  # at most one pulse
    assert chip.values()["COUNT"] == chip.state["climbed"] > 100


def test_a_move_whose_count_is_set_to_0_is_over():
    chip = chip_class("acme1000")()
    for name, value in {"START": 1000, "DRIVE": 3000, "SLOPE": 20, "COUNT": 900}.items():
        chip.write(chip.MAP.register(name).number, value)
    chip.write(0, chip.MAP.command("MOVE+").code)
    pulses = chip.advance(chip.clock_hz // 10)
    assert pulses > 0
    chip.write(chip.MAP.register("COUNT").number, 0)
    assert (chip.busy(), chip.advance(chip.clock_hz)) == (False, 0)
    assert chip.net() == pulses


def test_an_axis_moves_jogs_and_returns_to_the_origin(stage_):
    stage_.reset()
    stage_.place(x=-0.115)
    x = stage_.axes["x"]
    assert firmware.move(x, 2e-3).stopped_by == "COUNT = 0"
    assert firmware.jog(x, 0.1).ok
    home = firmware.home(x)
    assert (home.ok, home.stopped_by) == (True, "ORG")
    assert x.position == pytest.approx(-0.12, abs=1e-4)
    assert firmware.move(x, pulses=-12_000, speed=0.1).stopped_by == "EL-", "ORG stays asserted to the limit"
    with pytest.raises(ArgumentError, match="draws no lines"):
        firmware.line({"x": 1e-3, "y": 1e-3}, stage_)


def test_board_trace_and_command_line_know_it(stage_, capsys, tmp_path):
    stage_.reset()
    board = Board(stage_)
    board.out16(0x302, 1000)
    board.out16(0x300, 0x15)
    assert "x: START <- 1000" in board.trace.text()
    assert stage_.chips[0].diagnostics[-1].message == "no pulse will come: COUNT is 0"
    move = ["move", "x", "1mm", "--chips", "acme1000", "--model", "xy"]
    assert main([*move, "--vcd", str(tmp_path / "x.vcd"), "--record", str(tmp_path / "x.rrd")]) == 0
    assert "320 of 320" in capsys.readouterr().out
    assert main(["sync", "x=100", "y=200", "--chips", "acme1000", "--model", "xy"]) == 2
    assert "an ACME1000 draws no lines" in capsys.readouterr().err
    assert main(["fault", "lost-write", "--chips", "acme1000", "--model", "xy"]) == 0
    output = capsys.readouterr().out
    assert "happened as claimed" in output
    assert re.search(r"^diagnostics +0 +1$", output, re.M), (
        "its count is used up, and the lint sees that no pulse will come"
    )


@pytest.mark.parametrize("distance", ["10mm", "-10mm"])
def test_its_registers_are_tuned_for_either_direction(capsys, distance):
    """stage tune xy --axis x --chips acme1000 --distance -10mm"""
    options = ["--chips", "acme1000", "--distance", distance, "--trials", "4", "--seed", "1"]
    assert main(["tune", "xy", "--axis", "x", *options]) == 0
    output = capsys.readouterr().out
    assert "START" in output
    assert "SLOPE" in output


@pytest.mark.parametrize(
    "id_",
    ["RegisterTuning-v0", "RegisterBus-v0", "OriginReturn-v0", "BusMacros-v1", "FewShotTuning-v1", "DriftingHome-v1"],
)
def test_environments_know_it(id_):
    env = gymnasium.make(f"stage/{id_}", chip="acme1000", model="xy")
    env.reset(seed=1)
    env.action_space.seed(1)
    *_, info = env.step(env.action_space.sample())
    assert info
    env.close()


@pytest.mark.parametrize("id_", ["SynchronizedMove", "ServoTuning"])
def test_environments_refuse_a_chip_without_lines_or_closed_loop(id_):
    with pytest.raises(ArgumentError, match=r"an ACME1000 .*(draws no lines|closes no loop)"):
        gymnasium.make(f"stage/{id_}-v0", chip="acme1000", model="xy")


def test_a_chip_that_lacks_an_answer_is_refused_with_its_name(monkeypatch, tmp_path):
    (tmp_path / "half_chips.py").write_text(
        "from types import SimpleNamespace\nfrom acme_chips import ACME1000\n"
        "class HALF(ACME1000):\n    CORE = SimpleNamespace(**{**vars(ACME1000.CORE), 'run_window': None})\n"
        "class LOOKS(ACME1000):\n    ENCODERS = True\n"
        "class NAMED(ACME1000):\n    pass\nOTHER = NAMED\nNONE = 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    chips = {name: f"half_chips:{name}" for name in ("HALF", "LOOKS", "OTHER", "NONE")}
    installed(monkeypatch, tmp_path / "half", "half-chips", **chips)
    text = r"chip HALF of package half-chips 1.0 .* is refused: HALF breaks the contract of chips: .* has no answer run_window"
    with pytest.raises(ArgumentError, match=text):
        Stage("xy", chips="half")
    with pytest.raises(
        ArgumentError,
        match=r"no answer scan_edges_and_shafts, @exported\('i8', STATE, .*array_of\(EDGE\), array_of\('i8'\)",
    ):
        chip_class("looks")
    with pytest.raises(ArgumentError, match=r"OTHER .*the class is called NAMED"):
        chip_class("other")
    with pytest.raises(ArgumentError, match=r"NONE .*3 is no class below stage.chips.Chip"):
        chip_class("none")


@pytest.mark.slow
def test_installed_from_a_wheel_and_editable_in_a_fresh_environment(tmp_path):
    """pip install ./acme_chip; stage move x 10mm --chips acme1000"""
    project = shutil.copytree(ACME, tmp_path / "acme_chip", ignore=shutil.ignore_patterns("__pycache__", "_native.so"))
    venv.create(tmp_path / "venv")
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(tmp_path / "venv")}))
    (site / "others.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    python = tmp_path / "venv" / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}

    def run(*command, **more):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=clean | more)
        assert done.returncode == 0, done.stdout + done.stderr
        return done

    def pip(*what):
        run(sys.executable, "-m", "pip", "-q", "--python", str(python), *what)

    move = [str(python), "-m", "stage", "move", "x", "1mm", "--chips", "acme1000", "--model", "xy"]
    pip("install", "setuptools>=80")  # as [build-system] says; isolated, pip would look for PulseStage in the index
    pip("install", "--no-deps", "--no-build-isolation", str(project))
    assert (site / "acme_chips" / "_native.so").is_file()
    assert "ACME1000  acme-chips 0.1.0" in run(str(python), "-m", "stage", "chips").stdout
    for environment in ({}, {"NUMBA_DISABLE_JIT": "1"}):
        done = run(*move, **environment)
        assert "pulses 320 of 320" in done.stdout
        assert "building" not in done.stderr
    run(str(python), "-m", "pytest", "-q", "-c", "/dev/null", "--rootdir", str(tmp_path), str(project / "tests"))
    pip("uninstall", "-y", "acme-chips")
    pip("install", "--no-deps", "--no-build-isolation", "-e", str(project))
    assert "building" not in run(*move).stderr
    maps = project / "acme_chips" / "maps.py"
    maps.write_text(maps.read_text() + "\n# a change\n")
    assert "building the native library of acme_chips" in run(*move).stderr, "of what the core imports"


def test_an_old_setuptools_is_refused_with_the_command_to_install(monkeypatch):
    """pip install --no-build-isolation ./scripts/acme_chip: No module named 'setuptools.command.bdist_wheel'"""
    monkeypatch.delitem(sys.modules, "stage.native.package_build_backend", raising=False)
    monkeypatch.setitem(sys.modules, "setuptools.command.bdist_wheel", None)
    with pytest.raises(
        ImportError, match=r"setuptools 80 or newer, and [\d.]+ is installed: pip install 'setuptools>=80'"
    ):
        importlib.import_module("stage.native.package_build_backend")
