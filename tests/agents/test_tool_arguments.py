"""What agents write as arguments: what is understood, and how the rest is refused."""

import math

import pytest

from stage.agents.fields import BYTES, FLAG, LENGTH, LENGTHS, MANY, NUMBER, TEXT, WHOLE, Field
from stage.errors import ArgumentError

VALUE = Field("value", WHOLE, "of a register", True, low=0, high=65535)


@pytest.mark.parametrize(
    ("given", "value"),
    [
        (31, 31),
        (31.0, 31),
        ("31", 31),
        (" 31 ", 31),
        ("1Fh", 31),
        ("1fH", 31),
        ("0x1F", 31),
        ("0X1f", 31),
        ("0b11111", 31),
    ],
)
def test_whole_numbers_as_agents_write_them(given, value):
    assert VALUE.read(given) == value


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("1F", 'Did you mean "1Fh" (31)?'),
        # write R2 ²
        ("²", 'Did you mean "2"?'),
        ("٣١", 'Did you mean "31"?'),
        ("3.5", "is not a whole number"),
        (3.5, "is not a whole number"),
        (True, "true is not a whole number"),
        (None, "null is not a whole number"),
        (math.nan, "nan is not a whole number"),
        (math.inf, "is not a whole number"),
        ([1], "is not a whole number"),
        (-1, "from 0 to 65535"),
        (65536, "from 0 to 65535"),
        ("9" * 81, "no register is so wide"),
        (1 << 63, "is out of range: give a number from -9223372036854775807 to 9223372036854775807"),
    ],
)
def test_what_is_no_whole_number_is_refused_in_words(given, said):
    with pytest.raises(ArgumentError) as refused:
        VALUE.read(given)
    assert said in str(refused.value)
    assert str(refused.value).startswith("value: ")


@pytest.mark.parametrize(
    ("given", "metres"), [(0.01, 0.01), ("10mm", 0.01), ("-10 mm", -0.01), ("1e-2", 0.01), ("250um", 250e-6)]
)
def test_lengths_take_their_unit_along(given, metres):
    assert Field("distance", LENGTH, "").read(given) == pytest.approx(metres)


@pytest.mark.parametrize("given", ["10 parsecs", "mm", "", True, math.nan, "NaN", "1e999", {}])
def test_what_is_no_length_is_refused(given):
    with pytest.raises(ArgumentError, match=r"^distance: "):
        Field("distance", LENGTH, "").read(given)


def test_names_are_known_in_any_case_and_near_misses_are_told():
    axis = Field("axis", TEXT, "", choices=("x", "carriage"))
    assert axis.read("X") == "x"
    with pytest.raises(ArgumentError, match="Did you mean 'carriage'\\? Known: x, carriage\\."):
        axis.read("cariage")


WRONG = [
    (FLAG, 1), (FLAG, "yes"), (NUMBER, "fast"), (NUMBER, True), (TEXT, 3), (BYTES, []), (BYTES, "x"), (BYTES, [1] * 300),
    (LENGTHS, []), (LENGTHS, {"q": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "given"), WRONG)
def test_wrong_types_say_what_is_allowed(kind, given):
    with pytest.raises(ArgumentError, match=r"^a: "):
        Field("a", kind, "", choices=("x", "y") if kind in (TEXT, LENGTHS) else ()).read(given)


def test_both_ends_of_a_span_hold():
    open_ = Field("speed", NUMBER, "", low=0.0, above=True, high=2.0, unit="m/s")
    assert open_.read(2) == 2.0
    with pytest.raises(ArgumentError, match="out of range: give a number above 0, up to 2 m/s"):
        open_.read(0)
    with pytest.raises(ArgumentError, match="out of range: give a number above 0, up to 2 m/s"):
        open_.read("2.1")


def test_a_list_may_be_as_long_as_its_schema_says():
    values = Field("values", BYTES, "", low=0, high=255)
    most = values.schema()["maxItems"]
    assert most == MANY
    assert values.read([1] * most) == [1] * most
    with pytest.raises(ArgumentError, match=f"a list of {most + 1}; up to {most} at a time"):
        values.read([1] * (most + 1))


@pytest.mark.parametrize(
    ("given", "value"),
    [("-31", -31), ("-1Fh", -31), ("+0x1F", 31), ("-0b11", -3), ("1_000", 1000), (2**63 - 1, 2**63 - 1), ("-9", -9)],
)
def test_a_whole_number_has_its_sign_and_up_to_64_bits(given, value):
    whole = Field("n", WHOLE, "")
    assert whole.read(given) == value
    for much in (2**63, -(2**63), str(2**63)):
        with pytest.raises(ArgumentError, match="no register is so wide"):
            whole.read(much)


def test_the_ends_of_a_number_are_allowed_or_not_as_its_schema_says():
    closed, open_ = (Field("s", NUMBER, "", low=0.5, high=2.0, above=above) for above in (False, True))
    assert closed.schema().items() >= {"minimum": 0.5, "maximum": 2.0}.items()
    assert open_.schema().items() >= {"exclusiveMinimum": 0.5, "maximum": 2.0}.items()
    assert (closed.read(0.5), closed.read(2.0), open_.read(0.500001)) == (0.5, 2.0, 0.500001)
    with pytest.raises(ArgumentError, match=r"s: 0\.5 is out of range: give a number above 0\.5, up to 2"):
        open_.read(0.5)
    with pytest.raises(ArgumentError, match=r"from 0\.5 to 2"):
        closed.read(0.499)


@pytest.mark.parametrize(("given", "meant"), [("10 \u00b5m", "10 um"), ("10 \u03bcm", "10 um"), ("\u22125mm", "-5mm")])
def test_signs_of_other_keyboards_are_told_as_what_was_meant(given, meant):
    with pytest.raises(ArgumentError, match=f'Did you mean "{meant}"'):
        Field("distance", LENGTH, "").read(given)


@pytest.mark.parametrize("given", [1000.1, -1000.1, "-1001m", "2000m"])
def test_a_length_is_no_longer_than_a_kilometre_either_way(given):
    with pytest.raises(ArgumentError, match="a length up to 1000 m"):
        Field("distance", LENGTH, "").read(given)
    assert Field("distance", LENGTH, "").read(-1000) == -1000


def test_two_names_alike_but_for_their_case_are_not_guessed():
    both = Field("axis", TEXT, "", choices=("a", "A"))
    assert (both.read("a"), both.read("A")) == ("a", "A")
    with pytest.raises(ArgumentError, match="is not known"):
        Field("axis", TEXT, "", choices=("ab", "AB")).read("Ab")


def test_a_mapping_names_each_once():
    both = Field("distances", LENGTHS, "", choices=("x", "y"))
    assert both.read({"x": "1mm", "Y": 0.002}) == {"x": pytest.approx(1e-3), "y": 0.002}
    with pytest.raises(ArgumentError, match="x is given twice"):
        both.read({"x": 1, "X": 2})


def test_a_number_of_thousands_of_digits_is_no_trouble():
    for much in (10**5000, 10**400, 1e308, "9" * 40, "F" * 40 + "h"):
        with pytest.raises(ArgumentError, match="no register is so wide"):
            VALUE.read(much)
    with pytest.raises(ArgumentError, match="finite"):
        Field("seconds", NUMBER, "").read(10**5000)
