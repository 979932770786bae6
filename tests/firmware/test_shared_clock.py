"""A chip that follows another by SYNI makes pulses of CLOCK speed / (8192 R7) with the leader's R7, and procedures plan by it."""

import contextlib
import io
import random

import pytest
from support.examples import SEED, scaled

from stage import ArgumentError, Stage, StageError, firmware
from stage.chips import PCL240K, PCL240MS
from stage.cli import main
from stage.firmware import Bench, Profile, plan
from stage.firmware.pcl240 import chip_port, driver
from stage.firmware.pcl240.chip_port import explain_missing_pulses

HZ = 4_915_200
GOOD = 2.0  # pulses from the line


def make_stage_with_followers(pairs, chips=PCL240K, model="xyz"):
    return Stage(model, chips=chips, syni=pairs, visuals=False)


def write_registers(axis, **registers):
    firmware.ChipPort(axis).write_registers(**registers)


def run_command(*argv):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*argv])
    return code, out.getvalue(), err.getvalue()


@pytest.mark.parametrize(
    ("distances", "syni"),
    [
        ({"x": 12_000, "y": 8000}, {"y": "x"}),
        ({"x": 8000, "y": 12_000}, {"y": "x"}),
        ({"x": 12_000, "y": -8000, "z": 3001}, {"y": "x", "z": "x"}),
        ({"x": 12_000, "y": 8000, "z": -3001}, {"z": "y"}),
    ],
)
@pytest.mark.parametrize(("chip", "s_curve"), [(PCL240K, False), (PCL240MS, True)])
def test_axes_that_share_a_clock_on_a_line_have_the_same_multiplier_and_lose_no_step(distances, syni, chip, s_curve):
    """Regression: in `stage sync x=12000 y=8000 --syni y=x`, y had another R7 and lost 436 steps."""
    report = firmware.synchronized_move(distances, make_stage_with_followers(syni, chip), s_curve=s_curve)
    assert report.ok
    assert report.distances == distances
    assert report.deviation.pulses < GOOD
    assert report.deviation.pulses == pytest.approx(report.plan.deviation, abs=0.1), "as the plan predicts"
    r7 = {name: axis.registers["R7"] for name, axis in report.plan.axes.items()}
    assert all(r7[follower] == r7[leader] for follower, leader in syni.items())
    common_rate = max(r.peak_rate / abs(r.pulses) for r in report.axes.values())
    assert all(r.peak_rate / abs(r.pulses) == pytest.approx(common_rate, rel=1e-4) for r in report.axes.values())


@pytest.mark.parametrize("distances", [{"x": 0, "y": 8000}, {"y": 8000, "z": 3000}, {"y": 3000, "z": 8000}])
@pytest.mark.parametrize("r7", [60, 41])
def test_a_follower_of_an_axis_at_rest_is_planned_with_the_leaders_multiplier(distances, r7):
    stage = make_stage_with_followers({"y": "x"})
    write_registers(stage.axes["x"], R7=r7)
    report = firmware.line(distances, stage, pulses=True)
    assert report.ok
    assert report.plan.axes["y"].registers["R7"] == r7
    rate = report.plan.axes["y"].registers["R2"] * HZ / (8192 * r7)
    assert report.axes["y"].peak_rate == pytest.approx(rate)
    assert report.deviation.pulses < GOOD


def test_random_lines_with_a_shared_multiplier_stay_near_the_line():
    print("seed", SEED)
    rng = random.Random(SEED)
    for _ in range(scaled(8)):
        distances = {"x": rng.randint(500, 20_000), "y": rng.randint(500, 20_000)}
        planned = plan(distances, shared=("x", "y"), rate=rng.uniform(4000, 20_000), fl=rng.uniform(500, 2000))
        assert planned.axes["x"].registers["R7"] == planned.axes["y"].registers["R7"]
        assert planned.deviation < 4.0, (distances, str(planned))


def test_a_plan_that_a_follower_cannot_keep_is_refused_before_the_first_bus_cycle():
    stage = make_stage_with_followers({"y": "x"})
    planned = plan({"x": 12_000, "y": 8000})
    with pytest.raises(
        ArgumentError, match=r"the plan has R7 = \d+ for axis y.* the clock of axis x \(SYNI\) with R7 ="
    ):
        firmware.synchronized_move(planned, stage)
    write_registers(stage.axes["x"], R7=1000)
    with pytest.raises(ArgumentError, match=r"axis y would have to run at 1.6e\+04 pps, and with R7 = 1000"):
        firmware.line({"y": 8000}, stage, pulses=True)
    assert [axis.chip.net() for axis in stage.axes.values()] == [0, 0, 0]


def test_moves_of_a_clock_follower_have_the_requested_rates():
    stage = make_stage_with_followers({"y": "x"})
    y = stage.axes["y"]
    write_registers(stage.axes["x"], R7=60)
    report = firmware.move(y, pulses=8000, speed=8000 * y.meters_per_pulse)
    assert (report.ok, report.peak_rate) == (True, pytest.approx(8000, rel=1e-3))
    for report in (firmware.preset_move(y, 20_000), firmware.continuous_move(y, 0.3, -1)):
        assert report.peak_rate == pytest.approx(16_000, rel=1e-3)
    assert firmware.home(y).stopped_by == "ORG"
    with pytest.raises(ArgumentError, match=r"axis x \(SYNI\), which has R7 = 60: Profile.of\(..., multiplier=60\)"):
        firmware.preset_move(y, 8000, Profile.of(multiplier=30))


def test_a_follower_of_a_leader_without_a_clock_is_refused_before_the_first_bus_cycle():
    stage = make_stage_with_followers({"y": "x"})
    y, message = stage.axes["y"], r"axis y makes no pulses: its chip counts the clock of axis x \(SYNI\), whose R7 is 0"
    for act in (
        lambda: firmware.move(y, pulses=100),
        lambda: firmware.preset_move(y, 100),
        lambda: firmware.dual_rate_move(y, 40_000),
        lambda: firmware.home(y),
        lambda: firmware.jog(y, 0.1),
        lambda: firmware.line({"y": 100}, stage, pulses=True),
    ):
        with pytest.raises(StageError, match=message):
            act()
    assert y.chip.values()["R0"] == 0


def test_the_error_of_a_wait_for_pulses_without_a_clock_names_the_cause():
    stage = make_stage_with_followers({"y": "x"})
    for axis, message in (
        (stage.axes["y"], "clock of axis x .SYNI., whose R7 is 0"),
        (Bench(PCL240K()).axes["x"], "its R7 is 0"),
    ):
        port = firmware.ChipPort(axis)
        port.write_registers(R0=100, R1=100)
        port.write_control_mode(chip_port.PRESET)
        port.write_command(chip_port.START["FL"])
        with pytest.raises(StageError, match=message) as caught:
            port.wait_until_stopped(0.01)
        assert "more time" not in str(caught.value)


def test_the_command_plans_followers_and_names_a_leader_without_a_clock():
    code, out, _ = run_command("sync", "x=12000", "y=8000", "--syni", "y=x")
    assert code == 0
    assert out.count("0 full steps lost") == 2
    for argv in (["move", "y", "8000"], ["home", "y"], ["dual-rate", "y", "40000"]):
        code, _, err = run_command(*argv, "--syni", "y=x")
        assert code != 0
        assert "counts the clock of axis x (SYNI), whose R7 is 0" in err


@pytest.mark.parametrize(
    ("rates", "phases"),
    [
        ("FL,FH1", ["fkeep", "fup", "fkeep", "fdown", "fkeep"]),
        ("fh1,fl", ["fup", "fkeep", "fdown", "fkeep"]),
        ("FH1,FH2,FH1", ["fup", "fkeep", "fup", "fkeep", "fdown", "fkeep", "fdown", "fkeep"]),
    ],
)
def test_the_command_makes_the_dual_rates_of_the_data_sheet(monkeypatch, rates, phases):
    """Section 6: (1) constant FL, then a ramp up to FH1; (2) FH1, then a ramp down to FL"""
    planned, real = [], driver.dual_rate_move
    monkeypatch.setattr(
        driver, "dual_rate_move", lambda *args, **kwargs: planned.append(real(*args, **kwargs)) or planned[0]
    )
    code, _, _ = run_command("dual-rate", "x", "20000", "--rates", rates, "--dwell", "0.15")
    assert (code, planned[0].pulses) == (0, 20_000)
    waveform = planned[0].waveforms
    observed = [
        next((p for p in ("fup", "fdown", "fkeep") if waveform.pin(p)[k]), "") for k in range(len(waveform.edges))
    ]
    moving = [p for p, runs in zip(observed, waveform.running, strict=True) if runs]
    assert [p for k, p in enumerate(moving) if not k or moving[k - 1] != p] == phases


def test_the_minimum_pulses_that_a_refused_dual_rate_move_names_are_accepted():
    code, _, err = run_command("dual-rate", "x", "4000")
    assert code != 0
    assert "give more, dwell less, or ask for fewer rates" in err
    assert run_command("dual-rate", "x", "8000", "--dwell", "0.01")[0] == 0
    assert run_command("dual-rate", "x", "4000", "--rates", "FH1")[0] == 0


@pytest.mark.parametrize(("pulses", "is_possible"), [(400, True), (310, True), (290, False)])
def test_a_follower_runs_at_one_step_of_the_leaders_multiplier_or_faster(pulses, is_possible):
    """CLOCK / (8192 R7) is 300 pps with R7 = 2; of 16,000 pulses at 16,000 pps y has as many pps as pulses."""
    if is_possible:
        planned = plan({"x": 16_000, "y": pulses}, multipliers={"y": 2})
        assert planned.axes["y"].registers["R7"] == 2
    else:
        with pytest.raises(ArgumentError, match="with R7 = 2, which it hears at SYNI, it makes 300 to"):
            plan({"x": 16_000, "y": pulses}, multipliers={"y": 2})


def test_explain_silence_names_a_leader_whose_multiplier_makes_no_clock():
    y = make_stage_with_followers({"y": "x"}).axes["y"]
    write_registers(y.stage.axes["x"], R7=60)
    assert explain_missing_pulses(y) == ""
    for address, datum in ((0, 0x87), (2, 0), (1, 1)):  # R7 = 1, which the firmware itself does not write
        y.stage.axes["x"].chip.write(address, datum)
    assert "the clock of axis x (SYNI), whose R7 is 1" in explain_missing_pulses(y)
