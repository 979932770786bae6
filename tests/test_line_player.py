"""Programs in Python that make the steps of STEP/DIR axes themselves."""

import copy

import numpy as np
import pytest

from stage import ArgumentError, Stage, StageError
from stage.chips import STEPDIR
from stage.sim.pin_edge_player import PIN_EDGE, play_pin_edges


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", chips="stepdir", drives="a4988")


def test_lines_are_attributes_of_the_chip():
    chip = STEPDIR()
    assert (chip.step, chip.dir, chip.enable, chip.limit, chip.probe) == (False, False, True, False, False)
    chip.dir = chip.step = True
    chip.enable = False
    assert (chip.pins.step, chip.pins.dir, chip.pins.enable, chip.net()) == (True, True, False, -1)
    for pin, line in {"el_plus": "limit_plus", "el_minus": "limit_minus", "org": "origin", "probe": "probe"}.items():
        setattr(chip.pins, pin, True)
        assert getattr(chip, line)
        assert chip.limit == (line != "probe" and line != "origin")
        setattr(chip.pins, pin, False)
        assert not getattr(chip, line)


@pytest.mark.parametrize("line", ["limit", "limit_plus", "limit_minus", "origin", "probe"])
def test_a_line_that_the_stage_drives_cannot_be_set(line):
    chip = STEPDIR()
    with pytest.raises(StageError, match=f"{line} is driven by the stage and can only be read"):
        setattr(chip, line, True)
    assert chip.input_word(0) == STEPDIR.INPUTS["enable"]


@pytest.mark.parametrize(
    ("chips", "find", "name", "message"),
    [
        ("stepdir", lambda axis: axis.chip, "stepp", r"The STEPDIR has no attribute 'stepp'\. Did you mean step\?"),
        ("stepdir", lambda axis: axis.chip, "direction", r"no attribute 'direction'\. Did you mean dir\? Lines that"),
        ("stepdir", lambda axis: axis, "step", r"Axis x has no attribute 'step' .* stage\.axes\['x'\]\.chip\.step\."),
        ("stepdir", lambda axis: axis.chip.axes[0], "step", r"Input pins are set as pins\.step = True"),
        (
            "pcl240k",
            lambda axis: axis.chip,
            "step",
            r"The PCL240K has no attribute 'step'\. Input pins are set as pins\.",
        ),
        ("pcl240k", lambda axis: axis.chip, "el_plus", r"set as pins\.el_plus = True: el_plus, el_minus,"),
        ("pcl240k", lambda axis: axis, "org", r"stage\.axes\['x'\]\.pins\.org\."),
        ("mcx304", lambda axis: axis.chip, "pulse", r"The MCX304 has no attribute 'pulse'"),
    ],
)
def test_an_attribute_that_does_not_exist_cannot_be_set(chips, find, name, message):
    target = find(Stage("xyz", chips=chips, visuals=False).axes["x"])
    for same in (target, copy.copy(target)):
        with pytest.raises(AttributeError, match=message) as refused:
            setattr(same, name, True)
        assert isinstance(refused.value, StageError)
        assert name not in vars(same)


def test_pulses_are_those_of_a_loop_to_the_nanosecond(stage):
    one, other = copy.deepcopy(stage), copy.deepcopy(stage)
    one.axes["y"].chip.dir = other.axes["y"].chip.dir = True
    one.axes["y"].pulse(300, rate=3000, high=4e-6)
    for k in range(300):
        other.run_to(round(k * 1e9 / 3000))
        other.axes["y"].chip.step = True
        other.run(4e-6)
        other.axes["y"].chip.step = False
    other.run_to(100_000_000)
    assert one.now == other.now
    assert one.axes["y"].chip.state.tobytes() == other.axes["y"].chip.state.tobytes()
    assert np.array_equal(one.data.qpos, other.data.qpos)
    assert one.axes["y"].chip.net() == -300


def test_pulses_are_the_same_in_any_number_of_calls(stage):
    one, other = copy.deepcopy(stage), copy.deepcopy(stage)
    one.axes["x"].pulse(200_000, rate=500_000, high=1e-6)
    for _ in range(20):
        other.axes["x"].pulse(10_000, rate=500_000, high=1e-6)
    assert one.axes["x"].chip.net() == 200_000
    assert one.axes["x"].chip.state.tobytes() == other.axes["x"].chip.state.tobytes()


def test_a_journal_has_each_edge_of_many(stage):
    stage = copy.deepcopy(stage)
    journal = stage.axes["x"].chip.journal()
    stage.axes["x"].pulse(5000, rate=50_000)  # more edges than the engine has room to note
    assert journal.replay_waveforms().edges["net"][-1] == 5000
    assert len(journal.entries) == 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"count": -1}, "count=-1"), ({"count": 1.5}, "count=1.5"), ({"rate": 0}, "rate=0"), ({"high": 0}, "high=0"),
     ({"rate": 1000, "high": 1e-3}, "less than a period"), ({"rate": float("nan")}, "rate=nan")],
)  # fmt: skip
def test_pulses_that_cannot_be_are_refused(stage, arguments, message):
    before = stage.now
    with pytest.raises(ArgumentError, match=message):
        stage.axes["x"].pulse(**{"count": 1} | arguments)
    assert stage.now == before


def test_an_axis_without_a_step_line_is_refused():
    with pytest.raises(ArgumentError, match="axis x has a PCL240K, which has no STEP line"):
        Stage("xy").axes["x"].pulse(1)


def test_edges_out_of_order_or_of_no_axis_are_refused(stage):
    edges = np.zeros(2, PIN_EDGE)
    edges["time"] = [2, 1]
    with pytest.raises(ArgumentError, match="their times go back"):
        play_pin_edges(stage, edges, 10)
    edges["time"], edges["axis"] = [1, 2], [0, 2]
    with pytest.raises(ArgumentError, match="axes are given by their index, 0 to 1"):
        play_pin_edges(stage, edges, 10)


def test_an_edge_whose_time_has_passed_comes_at_once(stage):
    stage = copy.deepcopy(stage)
    stage.run(1e-3)
    edges = np.zeros(1, PIN_EDGE)
    edges["pins"] = edges["levels"] = STEPDIR.INPUTS["step"]
    play_pin_edges(stage, edges, stage.now)
    assert (stage.axes["x"].chip.net(), stage.now) == (1, 1_000_000)


@pytest.mark.parametrize("level", ["minus", None, -1, 2, [1]])
def test_a_line_takes_true_or_false_alone(level):
    chip = Stage("xy", chips="stepdir").axes["x"].chip
    with pytest.raises(ArgumentError, match="give True or False"):
        chip.dir = level
    chip.dir = 1
    assert chip.dir is True


def test_pulses_are_refused_while_step_is_high():
    x = Stage("xy", chips="stepdir").axes["x"]
    x.chip.step = True
    with pytest.raises(ArgumentError, match=r"chip\.step = False"):
        x.pulse(10)
    x.chip.step = False
    x.pulse(10)
    assert x.chip.net() == 11
