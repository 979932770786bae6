"""Diagnostics of every family: a rule has one key and one section, and a write has a diagnostic of each rule that it breaks."""

import copy
import importlib.util
import inspect
import re
from pathlib import Path

import pytest

from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.chips.hctl1100 import lint as hctl1100_lint
from stage.chips.nova import lint as nova_lint
from stage.chips.pcl240 import lint as pcl240_lint
from stage.chips.stepdir import lint as stepdir_lint
from stage.chips.write_diagnostics import MAX_DIAGNOSTICS, Rule, list_rules

LINTS = pytest.mark.parametrize(
    "lint", [pcl240_lint, nova_lint, hctl1100_lint, stepdir_lint], ids=lambda m: m.__name__.split(".")[2]
)
ROOT = Path(__file__).parents[2]


def find_keys(chip, *writes):
    """Return the keys of the diagnostics of the last of these writes."""
    for address, value in writes:
        chip.diagnostics.clear()
        chip.write(address, value)
    return [d.key for d in chip.diagnostics]


def test_a_start_that_lacks_everything_has_a_diagnostic_of_each_thing():
    """PCL-240K after power-up, with EL+ asserted: R0, R7, R1 and R2 are 0, and so are the rates of a high-speed start."""
    chip = PCL240K()
    chip.pins.el_plus = True
    keys = find_keys(chip, (0, 0x44), (0, 0x15))
    assert keys == ["no-pulses-left", "limit-ahead", "no-multiplier", "fl-is-0", "rate-below-2"]


def test_a_start_that_is_ignored_still_has_the_diagnostics_of_its_registers():
    chip = PCL240MS()
    for name, value in {"R1": 100, "R2": 400, "R4": 1, "R5": 30, "R7": 20}.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    assert find_keys(chip, (0, 0x40), (0, 0x10), (0, 0x18), (0, 0x15)) == ["no-reset-command", "rate-below-2"]


def test_predictions_about_ramps_are_left_out_where_no_pulse_comes():
    """R6 = 0: the move would stop without ramping down, if it moved."""
    chip = PCL240K()
    for name, value in {"R0": 5000, "R1": 100, "R2": 400, "R4": 30, "R5": 30, "R7": 20}.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    chip.pins.el_plus = True
    assert find_keys(chip, (0, 0x44), (0, 0x15)) == ["limit-ahead"]
    chip.pins.el_plus = False
    assert find_keys(chip, (0, 0x08), (0, 0x44), (0, 0x15)) == ["no-ramp-down-point"]


def test_a_byte_to_a_register_has_a_diagnostic_of_each_rule_that_it_breaks():
    """FFh into the high bits of R14 of an MK, which has 16 bits and no S-curves."""
    chip = PCL240MS()
    assert find_keys(chip, (0, 0x90 | 4), (3, 0xFF)) == ["bits-lost"]
    chip.write(0, 0xA0 | 0x10 | 7)
    assert find_keys(chip, (3, 0xFF), (2, 0xFF), (1, 0xFF)) == ["read-only-bits"]


def test_a_servo_that_begins_without_rates_has_a_diagnostic_of_each():
    """HCTL-1100: F0 selects the trapezoid; acceleration and maximum velocity are 0, and T is below 0Fh."""
    chip = HCTL1100()
    keys = find_keys(chip, (0x05, 0x01), (0x0F, 0x05), (0x26, 0), (0x27, 0), (0x28, 0), (0x00, 0x08), (0x05, 0x03))
    assert keys == ["no-acceleration", "no-max-velocity", "sample-too-short"]


def test_a_drive_command_has_a_diagnostic_of_each_axis_bit_and_each_reason():
    """MCX514: bit 15 is reserved only with other bits, an axis that drives, a number of pulses out of range."""
    chip = MCX514()
    for cycle in chip.register_cycles("TP", -2_147_483_648):
        chip.write(*cycle)
    assert find_keys(chip, (0, 0x0152), (0, 0x1150)) == ["reserved-bits", "already-driving", "pulse-number"]


def test_a_rule_that_is_reported_once_is_limited_by_its_key():
    chip = PCL240K()
    slow, fast, every = Rule("slow", "a", once=True), Rule("fast", "a", once=True), Rule("every", "a")
    for k, rule in enumerate((slow, slow, fast, every, slow.with_source("b"), every)):
        chip.diagnose(k, 0, 0, [(rule, f"the same words: {k}")])
    assert [(d.clock, d.key) for d in chip.diagnostics] == [(0, "slow"), (2, "fast"), (3, "every"), (5, "every")]
    chip.diagnose(6, 0, 0, [(slow, ""), (every, "")])
    assert [d.key for d in chip.diagnostics[4:]] == ["every"]


def test_the_last_thousand_diagnostics_are_kept():
    chip = PCL240K()
    for value in range(MAX_DIAGNOSTICS + 1):
        chip.write(0, 0xB8 | value & 7)
    assert [d.value for d in chip.diagnostics] == [0xB8 | value & 7 for value in range(1, MAX_DIAGNOSTICS + 1)]


@pytest.mark.parametrize(
    ("kind", "minimum", "maximum"),
    [(PCL240K, 1, 8_064_516), (PCL240MK, 1, 8_064_516), (PCL240MS, 1, 8_064_516), (HCTL1100, 100_000, 2_000_000)]
    + [(kind, 1, 16_000_000) for kind in (MCX302, MCX304, MCX312)] + [(MCX514, 1, 20_000_000)],
    ids=lambda value: value.__name__ if isinstance(value, type) else str(value),
)  # fmt: skip
def test_a_reference_clock_beyond_the_silicon_has_one_diagnostic(kind, minimum, maximum):
    assert kind(minimum).diagnostics == kind(maximum).diagnostics == []
    for hz in {maximum + 1, max(minimum - 1, 1)} - {1}:
        chip = kind(hz)
        chip.reset()
        (d,) = copy.copy(chip).diagnostics
        assert (d.key, d.clock) == ("clock-range", 0)
        assert f"{hz:,} Hz" in d.message
        assert f"{minimum:,} to {maximum:,} Hz" in d.message


@pytest.mark.parametrize("kind", [PCL240K, PCL240MK, PCL240MS, MCX304, MCX514, HCTL1100], ids=lambda k: k.__name__)
@pytest.mark.parametrize(
    ("address", "value", "what"),
    [
        (0, 1 << 20 | 0x15, "value 100015h acts as 15h"),
        (1 << 10 | 1, 8, "address 401h acts as 01h"),
        (1, 3.7, "value 3.7 acts as 03h"),
    ],
)
def test_a_write_that_does_not_fit_the_bus_has_a_diagnostic_of_what_the_chip_sees(kind, address, value, what):
    chip = kind()
    chip.write(address, value)
    result = [d for d in chip.diagnostics if d.key == "bus-width"]
    assert [d.message.split(":")[0] for d in result] == [what]
    assert (result[0].address, result[0].value) == (address & kind.ADDRESS_MASK & 63, int(value) & kind.DATA_MASK)


def test_an_address_and_a_value_that_both_do_not_fit_have_one_diagnostic():
    chip = PCL240K()
    chip.write(5, -1)
    (d,) = (d for d in chip.diagnostics if d.key == "bus-width")
    assert d.message.split(":")[0] == "address 05h acts as 01h and value -1 acts as FFh"


@LINTS
def test_every_rule_has_a_unique_key_a_section_and_a_place_that_yields_it(lint):
    rules, source = list_rules(lint), inspect.getsource(lint)
    assert len({rule.key for rule in rules}) == len(rules) > 0
    assert all(re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", rule.key) and rule.source for rule in rules)
    names = [name for name, value in vars(lint).items() if isinstance(value, Rule)]
    assert [name for name in names if len(re.findall(rf"\b{name}\b", source)) < 2] == []


def test_the_page_of_cited_sections_is_up_to_date():
    path = ROOT / "scripts" / "diagnostics_table.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    page = script.PAGE.read_text()
    assert script.renew_tables(page) == page, "run python scripts/diagnostics_table.py"
    assert "| section 5 f | `starts-on-org` |" in page
