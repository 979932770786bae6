"""Whoever gives a public function what it cannot take is told so in an error of ours, whatever it was."""

import math
from contextlib import suppress
from decimal import Decimal

import pytest

from stage import ArgumentError, Fleet, Snapshot, Stage, StageError, faults, firmware
from stage.chips import CHIPS, PCL240K, chip_class
from stage.drives.dc_motors import Servo
from stage.errors import UnknownKey
from stage.firmware import Profile
from stage.support.argument_checks import WrongType, check_integer, explain_arguments
from stage.tune import Task, tune

WRONG = ("1", None, math.nan, math.inf, -1, -1.5, [], {}, object(), b"x", "nosuch", 3.5, True, ["q"], Decimal("NaN"))


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", visuals=False)


@pytest.fixture(scope="module")
def recording(stage):
    with stage.record() as recording:
        stage.run(0.002)
    return recording


CALLS = {
    "start rate": lambda v: Profile.of(fl=v),
    "high rate": lambda v: Profile.of(fh1=v),
    "ramp": lambda v: Profile.of(accel=v),
    "chip of a profile": lambda v: Profile.of(chip=v),
    "name of a chip": chip_class,
    "clock of a chip": PCL240K,
    "address of a chip": lambda v: PCL240K().write(v, 1),
}
"""Public calls that tests/test_public_arguments.py does not make."""


@pytest.mark.parametrize("name", CALLS)
def test_an_argument_of_a_wrong_type_raises_only_errors_of_the_stage(name):
    for value in WRONG:
        with suppress(StageError):
            CALLS[name](value)


def test_an_error_names_the_wrong_argument_and_what_is_allowed(stage, recording):
    """stage.run("1"); Stage(chip=...); Profile.of(fh=8000); recording.columns["x/pos"]; recording.to_pandas("x/position")"""
    for call, kind, message in (
        (lambda: stage.run("1"), TypeError, "seconds='1': a number."),
        (lambda: Stage("xy", chip=PCL240K), TypeError, "Stage has no argument 'chip'. Did you mean 'chips'"),
        (lambda: Profile.of(fh=8000), TypeError, "Profile.of has no argument 'fh'. Did you mean "),
        (lambda: recording.columns["x/posit"], KeyError, "unknown column 'x/posit'. Did you mean 'x/position'"),
        (lambda: CHIPS["PCL241"], KeyError, "unknown chip 'PCL241'. Did you mean "),
        (lambda: firmware.home("x"), ArgumentError, "'x' is no axis with a chip: give stage.axes['x']"),
        (lambda: faults.bounce(stage.axes["x"], "org", "1"), TypeError, "seconds='1': a number."),
        (lambda: Fleet(["xy"]), TypeError, "stages=['xy']: a list, of each a stage."),
        (lambda: Snapshot.load(3), ArgumentError, "3 is no path: give a text, or a pathlib.Path."),
    ):
        with pytest.raises(StageError) as caught:
            call()
        assert isinstance(caught.value, kind)
        assert str(caught.value).startswith(message), str(caught.value)
    assert list(recording.to_pandas("x/position")) == ["x/position"]
    assert issubclass(UnknownKey, KeyError)
    assert stage.axes.get("q") is None
    assert "q" not in stage.axes
    with pytest.raises(KeyError):
        stage.axes["q"]


def test_an_error_in_user_code_is_not_replaced(stage):
    """A condition of one's own with a slip in it"""

    def condition():
        return "a" < 1

    with pytest.raises(TypeError) as caught:
        stage.run_until(condition, timeout=1e-3)
    assert not isinstance(caught.value, WrongType)

    @explain_arguments
    def add(a: "int", b: "object") -> "object":
        return a + b

    assert add(1, 2) == 3
    with pytest.raises(TypeError, match="unsupported operand"):
        add(1, "x")
    with pytest.raises(WrongType, match="a='x': a whole number"):
        add("x", 1)
    with pytest.raises(TypeError, match="missing 1 required"):
        add(1)


@explain_arguments
def raise_type_error(
    flag: "bool" = True,
    number: "float | None" = None,
    many: "Sequence[int]" = (),  # noqa: F821
    table: "Mapping[str, int | None] | None" = None,  # noqa: F821
    **places: "float",
) -> None:
    """Python's own error, whatever it is given."""
    raise TypeError("as Python says it")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"flag": 0.5}, "flag=0.5: True or False."),
        ({"flag": "yes"}, "flag='yes': True or False."),
        ({"number": "1"}, "number='1': a number or None."),
        ({"number": math.inf}, "number=inf: a number or None."),
        ({"many": [1, 2.5]}, "many=[1, 2.5]: a list, of each a whole number."),
        ({"many": "12"}, "many='12': a list, of each a whole number."),
        ({"table": 3}, "table=3: a mapping, as {'x': ...} or None."),
        ({"x": 1.0, "y": "far"}, "y='far': a number."),
    ],
)
def test_the_argument_that_does_not_fit_is_named_with_what_it_may_be(arguments, message):
    with pytest.raises(WrongType) as caught:
        raise_type_error(**arguments)
    assert str(caught.value) == message
    assert str(caught.value.__cause__) == "as Python says it"


@pytest.mark.parametrize(
    "arguments", [{}, {"flag": 1, "number": 2}, {"many": [1, 2.0]}, {"table": {}, "number": None}, {"x": 1, "y": 2.5}]
)
def test_where_all_arguments_fit_the_error_is_pythons(arguments):
    with pytest.raises(TypeError, match="as Python says it") as caught:
        raise_type_error(**arguments)
    assert not isinstance(caught.value, WrongType)


def test_of_values_that_follow_each_other_the_one_that_does_not_fit_is_named():
    @explain_arguments
    def add(*numbers: "float") -> "float":
        return sum(numbers)

    assert add() == 0
    assert add(1, 2.5) == 3.5
    with pytest.raises(WrongType, match="numbers='3': a number"):
        add(1, 2, "3")


@pytest.mark.parametrize("counts", [float("nan"), float("inf"), "a", None, 2000.5, True, 3])
def test_impossible_encoder_counts_are_refused(counts):
    """Servo(counts=float("nan")): a bare ValueError"""
    with pytest.raises(ArgumentError, match=r"counts=.*: an encoder has a whole number of counts a turn"):
        Servo(counts=counts)


def test_a_servo_says_which_arguments_it_has():
    """Servo(foo=3), Servo(motor=["14201S003"]): bare TypeErrors"""
    with pytest.raises(ArgumentError, match=r"Servo has no argument 'foo'"):
        Servo(foo=3)
    with pytest.raises(ArgumentError, match=r"unknown DC motor .* Known: 14201S003"):
        Servo(motor=["14201S003"])


def test_a_payload_of_something_that_is_no_body_is_refused():
    """stage.payload(3): a page of MuJoCo's"""
    with pytest.raises(ArgumentError, match=r"body=3: a text or None"):
        Stage("xy", visuals=False).payload(3)


@pytest.mark.parametrize(("name", "value"), [("seed", -1), ("seed", "a"), ("seed", 1.5), ("workers", 0)])
def test_a_tuning_with_a_number_out_of_range_is_refused_by_its_name(name, value):
    """tune(task, seed=-1): a ValueError of NumPy; workers=0: "threads=0" """
    with pytest.raises(ArgumentError, match=rf"^{name}={value!r}: a whole number"):
        tune(Task(Stage("xy", visuals=False), "x", 1000), **{name: value})


@pytest.mark.parametrize("value", [True, False, 2.0, -1, 2, "3", None])
def test_check_whole_number_takes_integers_from_the_lower_bound(value):
    with pytest.raises(ArgumentError, match=r"^n=.*: a whole number, 3 or more\.$"):
        check_integer("n", value, 3)
    with pytest.raises(ArgumentError):
        check_integer("n", True, 0)
    check_integer("n", 3, 3)


@pytest.mark.parametrize("name", ["x\0", "x\0y", "\0", "\ud800", "x\ud800"])
def test_a_name_of_a_body_with_a_nul_or_a_surrogate_is_the_name_of_no_body(name):
    """MuJoCo's own search ends a name at a NUL: "x", with a NUL and more, was the body x."""
    stage = Stage("xy", visuals=False)
    for call in (
        stage.payload,
        lambda body: stage.set_payload(1.0, body),
        lambda body: faults.payload(stage, 2.0, body),
    ):
        with pytest.raises(ArgumentError, match="unknown body"):
            call(name)
    assert stage.payload("x") == 0.0
