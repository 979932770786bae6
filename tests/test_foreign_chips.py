"""Chips that installed packages bring, by the entry points `pulsestage.chips`: known by their names wherever a chip is given."""

import subprocess
import sys

import gymnasium
import pytest
from support.packages import installed

import stage.envs  # noqa: F401
from stage import LoadError, Stage, firmware
from stage.chips import CHIPS, PCL240MS, chip_class
from stage.cli import main
from stage.errors import ArgumentError, add_article


@pytest.fixture
def toy_package(monkeypatch, tmp_path):
    installed(monkeypatch, tmp_path / "site", "toy-chips", TOY="toy:TOY")


def test_a_chip_of_an_installed_package_is_known_by_its_name(toy_package):
    assert "TOY" in CHIPS
    assert chip_class("toy") is chip_class("To-Y") is chip_class("t_o_y") is CHIPS["TOY"]
    stage_ = Stage("xy", chips={"x": "toy", "y": "pcl240ms"}, visuals=False)
    assert [type(chip).__name__ for chip in stage_.chips] == ["TOY", "PCL240MS"]
    assert firmware.move(stage_.axes["x"], pulses=100).ok
    assert firmware.move(stage_.axes["y"], pulses=100).ok
    assert type(Stage("xy", chips="toy", visuals=False).chips[0]).__name__ == "TOY"


def test_an_entry_point_with_extras_is_read(monkeypatch, tmp_path):
    installed(monkeypatch, tmp_path / "site", "toy-chips", **{"TOY8": "toy:TOY8 [fast]"})
    assert chip_class("toy-8").AXES == 8
    del CHIPS["TOY8"]  # loaded, it would stay known without its package


def test_the_command_line_takes_it(toy_package, capsys):
    assert main(["move", "x", "320", "--fl", "1000", "--chips", "toy", "--model", "xy"]) == 0
    assert "pulses 320 of 320" in capsys.readouterr().out
    assert main(["registers", "toy"]) == 0
    assert "a chip of two registers" in capsys.readouterr().out
    assert main(["chips"]) == 0
    assert "TOY" in (said := capsys.readouterr().out)
    assert "toy-chips 1.0" in said
    assert "PCL240MS" in said


def test_environments_take_it(toy_package):
    env = gymnasium.make("stage/RegisterBus-v0", chip="toy", model="xy")
    env.reset(seed=1)
    env.step(env.action_space.sample())
    env.close()


def test_an_unknown_chip_is_refused_with_a_list_of_known_names(toy_package):
    with pytest.raises(ArgumentError, match=r"unknown chip 'TOYS'. Did you mean 'TOY'\? Known: .*PCL240K.*TOY"):
        chip_class("toys")


def test_a_package_that_cannot_be_loaded_is_named_and_all_else_works(toy_package, monkeypatch, tmp_path, capsys):
    (tmp_path / "broken_chips.py").write_text("import nothing_of_this_name\n")
    monkeypatch.syspath_prepend(tmp_path)
    installed(monkeypatch, tmp_path / "more", "broken-chips", "0.3", BROKEN="broken_chips:BROKEN", GONE="toy:GONE")
    message = r"chip BROKEN of package broken-chips 0\.3 .* cannot be loaded: ModuleNotFoundError: No module named 'nothing_of_this"
    with pytest.raises(LoadError, match=message):
        chip_class("broken")
    with pytest.raises(LoadError, match=r"chip GONE of package broken-chips .* cannot be loaded: AttributeError"):
        Stage("xy", chips="gone")
    assert chip_class("toy").__name__ == "TOY"
    assert chip_class("pcl240ms") is PCL240MS
    assert main(["chips"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("broken-chips 0.3" in line and "cannot be loaded" in line for line in lines) == 2
    assert main(["move", "x", "320", "--chips", "broken"]) == 2
    assert "cannot be loaded" in capsys.readouterr().err


def test_a_name_that_two_packages_bring_is_refused_and_one_of_ours_stays_ours(monkeypatch, tmp_path, capsys):
    installed(monkeypatch, tmp_path / "a", "one", TOY="toy:TOY", PCL240MS="toy:TOY")
    installed(monkeypatch, tmp_path / "b", "other", "2.0", toy="toy:TOY")
    monkeypatch.delitem(CHIPS._loaded, "TOY", raising=False)
    with pytest.raises(ArgumentError, match=r"chip TOY: package (one 1\.0|other 2\.0) .* and package .*Uninstall one"):
        chip_class("toy")
    monkeypatch.setattr(CHIPS, "_told", set())
    assert chip_class("pcl240ms") is chip_class("PCL-240MS") is PCL240MS
    assert chip_class("pcl240k").__name__ == "PCL240K"
    errors = capsys.readouterr().err.splitlines()
    message = (
        "PulseStage: PCL240MS is one of PulseStage's own chips, and stays it, though one 1.0 has one of this name: give"
    )
    assert [line.startswith(message) for line in errors] == [True], "once, where the name is used"
    lines = {line.name: line for line in CHIPS.list_chips() if line.problem}
    assert lines.keys() == {"TOY", "PCL240MS"}
    assert "is one of PulseStage's own" in lines["PCL240MS"].problem


def test_a_package_installed_twice_counts_once_and_one_that_exits_is_reported(monkeypatch, tmp_path):
    """Installed in the system and once more in a virtual environment that sees it; and `raise SystemExit(0)` in a module"""
    (tmp_path / "quitting_chips.py").write_text("raise SystemExit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(CHIPS._loaded, "TOY", raising=False)
    for site in ("a", "b"):
        installed(monkeypatch, tmp_path / site, "one", TOY="toy:TOY", QUITS="quitting_chips:QUITS")
    assert chip_class("toy").__name__ == "TOY"
    with pytest.raises(LoadError, match=r"chip QUITS of package one 1\.0 .* cannot be loaded: SystemExit: 0"):
        chip_class("quits")


def test_a_built_in_chip_is_created_without_reading_package_metadata():
    code = (
        "import stage, stage.chips, sys; stage.chips.chip_class('pcl240k'); print('importlib.metadata' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"


def test_the_command_line_assigns_a_chip_to_each_axis(toy_package, capsys):
    chips = ["--model", "xy", "--chips", "x=toy,y=pcl240ms"]
    assert main(["move", "y", "100", *chips]) == 0
    assert main(["move", "x", "100", *chips]) == 0
    capsys.readouterr()
    assert main(["move", "x", "100", "--chips", "x=toy,y"]) == 2
    assert "AXIS=CHIP" in capsys.readouterr().err
    assert main(["move", "x", "100", "--chips", "x=toy,x=toy"]) == 2
    assert "axis x already has toy" in capsys.readouterr().err


def test_names_have_the_article_that_they_are_spoken_with():
    names = "PCL240K MCX304 HCTL1100 ACME1000 TMC5160 8254 LS7166 TOY atmega328p cortex-m4 8AXIS XR2206".split()
    articles = " ".join(add_article(name).split()[0] for name in names)
    assert articles == "a an an an a an an a an a an an"


def test_an_egg_info_package_that_claims_a_built_in_name_is_reported(monkeypatch, tmp_path, capsys):
    """setup.py develop leaves NAME.egg-info where pip leaves NAME.dist-info"""
    installed(monkeypatch, tmp_path, "elder", PCL240MS="toy:TOY")
    (tmp_path / "elder-1.0.dist-info").rename(tmp_path / "elder.egg-info")
    (tmp_path / "elder.egg-info" / "METADATA").rename(tmp_path / "elder.egg-info" / "PKG-INFO")
    monkeypatch.setattr(CHIPS, "_told", set())
    assert chip_class("pcl240ms") is PCL240MS
    assert "though elder 1.0 has one of this name" in capsys.readouterr().err
