"""Pins as a recording shows them: what the wires settle on, where they change, which switch is on, which phase and direction."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from stage.chips import HCTL1100, PCL240K
from stage.chips.journal_entries import RESET, WRITE
from stage.recording import pin_signals

EDGE = [("clock", "i8"), ("inputs", "i8"), ("outputs", "i8"), ("rate", "f8")]


def edges(*rows):
    """(clock, inputs, outputs)"""
    return np.array([(*row, 0.0) for row in rows], EDGE)


def test_of_several_edges_at_one_clock_the_last_counts_in_one_piece_and_across_two():
    """clocks 1 1 2 | 2 2 | 3 | 3: what is kept of 1, 2 and 3 is what came last"""
    pieces = [edges((1, 1, 0), (1, 2, 0), (2, 3, 0)), edges((2, 4, 0), (2, 5, 0)), edges((3, 6, 0)), edges((3, 7, 0))]
    expected = [(int(e["clock"]), int(e["inputs"])) for piece in pin_signals.settle_edges(pieces) for e in piece]
    assert expected == [(1, 2), (2, 5), (3, 7)]
    assert list(pin_signals.settle_edges([])) == []
    assert [len(p) for p in pin_signals.settle_edges([edges((9, 0, 0))])] == [1]


def test_edges_are_those_at_which_a_pin_changes_and_the_first():
    """pieces that begin as the one before has ended: no edge; an output alone that changes is one"""
    pieces = [edges((1, 1, 0), (2, 1, 0), (3, 1, 4)), edges((4, 1, 4), (5, 0, 4), (6, 0, 4))]
    journal = SimpleNamespace(replay_in_pieces=lambda: iter(pieces))
    assert pin_signals.list_pin_edges(journal)["clock"].tolist() == [1, 3, 5]
    begins = SimpleNamespace(replay_in_pieces=lambda: iter([edges((1, 1, 0)), edges((2, 0, 0))]))
    assert pin_signals.list_pin_edges(begins)["clock"].tolist() == [1, 2]


def test_changes_begin_with_the_first_value():
    clocks, values = pin_signals.find_changes(edges((1, 0, 0), (2, 0, 0), (4, 0, 0), (5, 0, 0)), np.array([0, 0, 1, 0]))
    assert (clocks.tolist(), values.tolist()) == ([1, 4, 5], [0, 1, 0])


def test_a_chip_is_at_rest_where_no_pin_says_a_phase():
    """a PCL-240K with FUP, FKEEP, FDOWN and HOLD; an HCTL-1100 with PROF and INIT"""
    for chip in (PCL240K, HCTL1100):
        pins = list(chip.PHASES)
        rows = [(k, 0, chip.OUTPUTS[pin]) for k, pin in enumerate(pins)] + [(len(pins), 0, 0)]
        rest = "control" if chip.SERVO else "hold"
        assert pin_signals.find_motion_phases(chip(), edges(*rows)).tolist() == [*chip.PHASES.values(), rest]
        known = pin_signals.list_motion_phases(chip())
        assert known[-1] == rest
        assert sorted(known) == sorted({*chip.PHASES.values(), rest})


class Wired:
    """A chip whose pin BOTH has two switches, and EL+ one of its own."""

    def __init__(self):
        self.WIRING = {"el_minus": "both", "org": "both"}
        self.OUTPUTS = {"pout": 64}

    def find_switch_input(self, pin):
        return {"el_minus": 1, "org": 1, "el_plus": 2, "both": 1, "in": 1}.get(pin, 0)


def test_switches_on_one_pin_are_one_lane_by_the_name_of_the_pin():
    switches = SimpleNamespace(as_dict=lambda: {"el_minus": 0, "org": 0, "el_plus": 0, "sd_plus": 0})
    axis = SimpleNamespace(chip=Wired(), switches=switches)
    assert list(pin_signals.list_switches(axis)) == [("both", "EL", "el"), ("el_plus", "EL+", "el")]
    alone = SimpleNamespace(chip=Wired(), switches=SimpleNamespace(as_dict=lambda: {"org": 0}))
    assert list(pin_signals.list_switches(alone)) == [("org", "ORG", "org")]


def test_a_switch_follows_its_pin_or_the_inverse_with_positive_logic():
    """wiring: a switch that opens; another on the same pin is turned round with it, one on another pin is not"""
    observed = edges((1, 0, 0), (2, 1, 0), (3, 3, 0))
    usual = SimpleNamespace(chip=Wired())
    rotated = SimpleNamespace(chip=Wired(), wiring={"org": "positive"})
    assert pin_signals.is_switch_on(usual, observed, "el_minus").tolist() == [False, True, True]
    assert pin_signals.is_switch_on(rotated, observed, "el_minus").tolist() == [True, False, False]
    assert pin_signals.is_switch_on(rotated, observed, "org").tolist() == [True, False, False]
    assert pin_signals.is_switch_on(rotated, observed, "el_plus").tolist() == [False, False, True]
    assert pin_signals.is_asserted(Wired(), edges((1, 0, 64), (2, 64, 0)), "pout").tolist() == [True, False]


def test_a_status_bit_is_of_the_pin_of_its_direction_and_of_what_the_chip_sees():
    """fields with one pin, with one a direction, with an opposite, with none; and a chip with polarity bits"""
    fields = [
        SimpleNamespace(name="end", pins=("el_plus", "el_minus")), SimpleNamespace(name="off", pins=("/org",)),
        SimpleNamespace(name="pulse", pins=("pout",)), SimpleNamespace(name="none", pins=()),
    ]  # fmt: skip
    chip = Wired()
    chip.MAP = SimpleNamespace(words=[SimpleNamespace(name="other"), SimpleNamespace(name="status", fields=fields)])
    rows = edges((1, 2, 64), (2, 1, 0), (3, 1, 0))
    message = {
        name: v.tolist() for name, v in pin_signals.decode_status(chip, rows, np.array([False, False, True])).items()
    }
    assert message == {"end": [True, False, True], "off": [True, False, False], "pulse": [True, False, False]}
    observed = np.zeros(3, [*EDGE, ("seen", "i8")])
    observed["inputs"], observed["seen"], observed["outputs"] = [2, 1, 1], [0, 3, 2], [64, 0, 0]
    message = {
        name: v.tolist()
        for name, v in pin_signals.decode_status(chip, observed, np.array([False, False, False])).items()
    }
    assert message == {"end": [False, True, True], "off": [True, False, True], "pulse": [True, False, False]}
    chip.MAP = SimpleNamespace(words=[SimpleNamespace(name="other")])
    assert pin_signals.decode_status(chip, rows, np.zeros(3, bool)) == {}


def test_the_direction_is_that_of_the_last_write_and_plus_after_the_reset_pin():
    """minus at the start; a write that does not turn it; plus, minus, a reset"""
    start = np.array([(100, 1)], [("clock", "i8"), ("minus", "i8")])[0]
    turns = {1: None, 2: False, 3: True}
    chip = SimpleNamespace(find_selected_direction=lambda a, b: turns[b])
    entries = [
        SimpleNamespace(kind=kind, clock=clock, a=0, b=b)
        for kind, clock, b in ((WRITE, 110, 1), (WRITE, 120, 2), (WRITE, 130, 3), (RESET, 140, 3), (WRITE, 150, 3))
    ]
    clocks, minus = pin_signals.list_directions(chip, SimpleNamespace(start_state=start, entries=entries))
    assert clocks.tolist() == [100, 120, 130, 140, 150]
    assert minus.tolist() == [True, False, True, False, True]
    unmodified = np.array([(7, 1)], [("clock", "i8"), ("other", "i8")])[0]
    clocks, minus = pin_signals.list_directions(chip, SimpleNamespace(start_state=unmodified, entries=entries))
    assert (clocks.tolist(), minus.tolist()) == ([7], [False])


def test_a_rate_is_in_pulses_a_second():
    rows = edges((1, 0, 0), (2, 0, 0))
    rows["rate"] = [0.001, 0.25]
    assert pin_signals.to_pulse_rates(rows, 4000).tolist() == [4.0, 1000.0]
