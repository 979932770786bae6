"""Axes of any name on the command line: AXIS=VALUE, AXIS.SENSOR=LOGIC and lists of them."""

import json

import pytest
from support.odd_names import odd_model

from stage import ArgumentError
from stage.cli import main
from stage.cli.export import split_columns
from stage.support.axis_value_parsing import parse_chips, parse_syni, parse_wiring

NAMES = ("a=b", "a,b", "a.b", "x")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("names") / "names.xml"
    path.write_text(odd_model(NAMES).to_xml(), encoding="utf-8")
    return str(path)


def test_a_line_names_axes_with_equals_signs_commas_and_dots(model, capsys):
    assert main(["sync", "a=b=400", "a,b=-300", "a.b=200", "x=100", "--model", model, "--json"]) == 0
    reports = json.loads(capsys.readouterr().out)["reports"]
    assert {report["axis"]: report["pulses"] for report in reports} == {"a=b": 400, "a,b": -300, "a.b": 200, "x": 100}


@pytest.mark.parametrize("name", NAMES)
def test_an_axis_of_any_name_takes_a_chip(model, name, capsys):
    assert main(["move", name, "100", "--model", model, "--chips", f"{name}=pcl240ms", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reports"][0]["pulses"] == 100


def test_chips_followers_and_wires_split_at_their_last_sign():
    assert parse_chips("a,b=pcl240k, c=d = mcx304,x=mcx514") == {"a,b": "pcl240k", "c=d": "mcx304", "x": "mcx514"}
    assert parse_syni(["a,b=x,c=d=x", "y=x"]) == {"a,b": "x", "c=d": "x", "y": "x"}
    assert parse_wiring(["a.b.org=positive", "c=d.ez=negative"]) == {
        "a.b": {"org": "positive"},
        "c=d": {"ez": "negative"},
    }


@pytest.mark.parametrize(
    "text", ["", "x", "x=", "=pcl240k", "x=pcl240k,", "x=pcl240k,y", ",", "x=pcl240k,,", "x=pcl240k,=mcx304"]
)
def test_half_a_pair_is_refused(text):
    with pytest.raises(ArgumentError, match="AXIS=CHIP"):
        parse_chips(text)
    with pytest.raises(ArgumentError, match="FOLLOWER=LEADER"):
        parse_syni([text])


def test_a_column_may_have_commas_in_its_name():
    known = ("time", "a,b/position", "a/position", "b/position")
    assert split_columns("a,b/position, time,b/position", known) == ["a,b/position", "time", "b/position"]
    assert split_columns("a/position,b/position", known) == ["a/position", "b/position"]
    assert split_columns("a,c/position", known) == ["a", "c/position"], "each is told to be unknown"
