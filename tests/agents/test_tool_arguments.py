"""What agents write as arguments: what the tools understand, and how they refuse the rest."""

import math

import pytest

from stage.agents.tool import Tool
from stage.agents.tool_arguments import (
    MAX_LIST_ITEMS,
    Flag,
    Length,
    Text,
    argument,
    choice,
    integer,
    list_of,
    make_length_mapping_type,
    number,
)
from stage.errors import ArgumentError

REGISTER = integer(0, 65535)


def parse(kind, value):
    """Parse the argument `a` of this type as a tool does."""
    return Tool("tool", "", dict, {"a": argument(kind, "")}).parse({"a": value})["a"]


def make_schema(kind):
    return Tool("tool", "", dict, {"a": argument(kind, "")}).schema()["properties"]["a"]


def refuse(kind, value):
    """Return the sentence that refuses this value."""
    with pytest.raises(ArgumentError) as refused:
        parse(kind, value)
    assert str(refused.value).startswith("a")
    return str(refused.value)


SPELLINGS_OF_31 = [(n, 31) for n in (31, 31.0, "31", " 31 ", "1Fh", "1fH", "0x1F", "0X1f", "0b11111", "+0x1F")]
SPELLINGS_OF_31 += [("-31", -31), ("-1Fh", -31), ("-0b11", -3), ("1_000", 1000), (2**63 - 1, 2**63 - 1)]


@pytest.mark.parametrize(("written", "value"), SPELLINGS_OF_31)
def test_integers_are_understood_as_agents_write_them(written, value):
    assert parse(integer(), written) == value


INVALID_INTEGERS = [
    ("1F", "Did you mean '1Fh' (31)?"), ("²", "Did you mean '2'?"), ("٣١", "Did you mean '31'?"), ("3.5", "is not a whole number"),
    (3.5, "should be a valid integer"), (True, "true is not a number"), (math.nan, "finite number"), (math.inf, "finite number"),
    ([1], "should be a valid integer"), (-1, "greater than or equal to 0"), (65536, "less than or equal to 65535"),
    ("9" * 81, "is not a whole number"),
    pytest.param(10**5000, "less than or equal to 65535", id="huge"), ("F" * 40 + "h", "less than or equal to 65535"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "sentence"), INVALID_INTEGERS)
def test_what_is_no_integer_of_the_range_is_refused_in_words(written, sentence):
    assert sentence in refuse(REGISTER, written)


@pytest.mark.parametrize("much", [2**63, -(2**63), str(2**63)])
def test_an_integer_beyond_64_bits_is_refused(much):
    assert "9223372036854775807" in refuse(integer(), much)


LENGTHS = [(0.01, 0.01), ("10mm", 0.01), ("-10 mm", -0.01), ("1e-2", 0.01), ("250um", 250e-6), (-1000, -1000)]
LENGTHS += [("180deg", math.pi)]


@pytest.mark.parametrize(("written", "meters"), LENGTHS)
def test_lengths_carry_their_unit(written, meters):
    assert parse(Length, written) == pytest.approx(meters)


@pytest.mark.parametrize("written", ["10 parsecs", "mm", "", True, math.nan, "NaN", "1e999", {}, 1000.1, "-1001m"])
def test_what_is_no_length_up_to_a_kilometer_is_refused(written):
    assert refuse(Length, written)


@pytest.mark.parametrize(
    ("written", "suggestion"), [("10 \u00b5m", "10 um"), ("10 \u03bcm", "10 um"), ("\u22125mm", "-5mm")]
)
def test_unicode_signs_are_answered_with_their_ascii_spelling(written, suggestion):
    assert f"Did you mean '{suggestion}'" in refuse(Length, written)


def test_names_are_known_in_any_case_and_similar_names_are_listed():
    axis = choice(("x", "carriage"))
    assert parse(axis, "X") == "x"
    assert "Did you mean 'carriage'? Known: x, carriage." in refuse(axis, "cariage")
    assert (parse(choice(("a", "A")), "a"), parse(choice(("a", "A")), "A")) == ("a", "A")
    assert "is not known" in refuse(choice(("ab", "AB")), "Ab")


WRONG_TYPES = [
    (Flag, 1), (Flag, "yes"), (number(), "fast"), (number(), True), pytest.param(number(), 10**5000, id="huge"),
    (number(), "nan"), (Text, 3),
    (list_of(REGISTER), []), (list_of(REGISTER), "x"), (list_of(REGISTER), {}), (choice(("x", "y")), 3),
    (make_length_mapping_type(("x", "y")), []), (make_length_mapping_type(("x", "y")), {}),
    (make_length_mapping_type(("x", "y")), {"q": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "written"), WRONG_TYPES)
def test_a_value_of_another_type_is_refused(kind, written):
    assert refuse(kind, written)


@pytest.mark.parametrize(("written", "value"), [(True, True), ("TRUE", True), ("false", False)])
def test_a_flag_may_be_written_as_text(written, value):
    assert parse(Flag, written) is value


def test_the_ends_of_a_range_are_allowed_as_the_schema_says():
    closed, above = number(ge=0.5, le=2.0), number(gt=0.5, le=2.0)
    assert make_schema(closed)["minimum"] == make_schema(above)["exclusiveMinimum"] == 0.5
    assert make_schema(closed)["maximum"] == make_schema(above)["maximum"] == 2.0
    assert (parse(closed, 0.5), parse(closed, "2"), parse(above, 0.500001)) == (0.5, 2, 0.500001)
    assert "a: 0.5 should be greater than 0.5." in refuse(above, 0.5)
    assert "a: 0.499 should be greater than or equal to 0.5." in refuse(closed, 0.499)
    assert "a: '2.1' should be less than or equal to 2." in refuse(closed, "2.1")


def test_a_list_has_as_many_items_as_its_schema_says_and_one_value_is_a_list():
    values = list_of(integer(0, 255))
    assert make_schema(values)["maxItems"] == MAX_LIST_ITEMS
    assert parse(values, [1] * MAX_LIST_ITEMS) == [1] * MAX_LIST_ITEMS
    assert f"at most {MAX_LIST_ITEMS} items" in refuse(values, [1] * (MAX_LIST_ITEMS + 1))
    assert parse(values, "15h") == [0x15]
    assert refuse(values, [1, 256]).startswith("a[1]: 256 should be less")


def test_a_mapping_names_each_axis_once():
    both = make_length_mapping_type(("x", "y"))
    assert parse(both, {"x": "1mm", "Y": "2 mm"}) == {"x": pytest.approx(1e-3), "y": pytest.approx(0.002)}
    assert "each name may be given once" in refuse(both, {"x": 1, "X": 2})
