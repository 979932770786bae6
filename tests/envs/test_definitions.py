"""The numbers of "Definitions" in docs/envs_tasks.md match the code, and no weight of a reward is missing."""

import re
from ast import literal_eval
from dataclasses import fields
from pathlib import Path

import pytest

from stage.envs import bus_macros, drifting_home, few_shot, macro_programs, one_shot, synchronized_line
from stage.firmware.driver import Speeds

PAGE = (Path(__file__).parents[2] / "docs" / "envs_tasks.md").read_text()
DEFINITIONS = PAGE.partition("## Definitions\n")[2].partition("\n## Splits")[0]
COMMON, *PARTS = re.split(r"^### ", DEFINITIONS, flags=re.M)
SECTIONS = {part.partition("\n")[0].rpartition(" ")[2]: part for part in PARTS}
CODE = {
    "FewShotTuning": [few_shot.Config(), few_shot.ACTION_RANGES, {"error": one_shot.Config().error}],
    "DriftingHome": [drifting_home.Config(), drifting_home.ACTION_RANGES, vars(drifting_home)],
    "SynchronizedLine": [synchronized_line.Config()],
    "BusMacros": [bus_macros.Config(), macro_programs.RATES, vars(bus_macros)],
}


def parse_assignments(text):
    """List (name, value) of each `name=value` in the text."""
    return [(name, literal_eval(value)) for name, value in re.findall(r"`(\w+)=([^`]+)`", text)]


def get_code_value(name, places):
    for place in places:
        values = place if isinstance(place, dict) else vars(place)
        if name in values:
            return values[name]
    raise AssertionError(f"{name} is nowhere in the code")


def test_the_page_defines_each_task():
    assert SECTIONS.keys() == CODE.keys()


@pytest.mark.parametrize("task", CODE)
def test_numbers_of_a_definition_are_the_code_s_defaults(task):
    two = ("memory", "answer")  # both values are told
    results = [
        (name, value, get_code_value(name, CODE[task]))
        for name, value in parse_assignments(SECTIONS[task])
        if name not in two
    ]
    assert len(results) > 8
    assert [row for row in results if row[1] != row[2]] == []


@pytest.mark.parametrize("task", CODE)
def test_no_weight_of_a_reward_is_missing_in_a_definition(task):
    config = CODE[task][0]
    custom = {f.name for f in fields(config)} & set(type(config).__annotations__)
    weights = {name for name in custom if name.endswith("_weight")}
    assert weights <= dict(parse_assignments(SECTIONS[task])).keys()


def test_the_reference_time_of_the_page_follows_from_the_driver_speeds():
    assert dict(parse_assignments(COMMON)) == {"start": Speeds().start, "drive": Speeds().drive, "up": Speeds().up}


def test_derived_figures_of_the_page_are_correct():
    c, b = drifting_home.Config(), bus_macros.Config()
    worst = (
        4 * c.limit * c.time_weight
        + drifting_home.MAX_ERROR_PULSES * c.error_weight
        + c.missed_weight
        + 2 * c.damage_weight
    )
    assert f"which is {worst:.4g} for each" in SECTIONS["DriftingHome"]
    assert f"up to {b.max_target_pulses} (twice the sum" in SECTIONS["BusMacros"]
    assert f"1 to {b.max_target_pulses // b.grid[0]} times {b.grid[0]} pulses" in SECTIONS["BusMacros"]
    assert "one of 14 macros" in SECTIONS["BusMacros"]
    assert len(macro_programs.RATES) + len(b.grid) + len(macro_programs.MACROS_WITHOUT_VALUES) + len(b.axes) == 14
