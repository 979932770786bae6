"""`chip_conformance`: every shipped chip passes it, and each of many planted defects of a toy chip is found, by its promise."""

import os
import re
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.examples import EXAMPLES, FIXED, SEED, scaled
from toy import TOY, TOY8, defects

from stage.chips import CHIPS, PCL240K
from stage.errors import ArgumentError, NativeError, StageError
from stage.testing import chip_actions, chip_conformance, conformance, promises
from stage.testing.bounded_child_process import TIME_LIMIT_MESSAGE, BoundedChildProcess
from stage.testing.conformance import ConformanceError
from stage.testing.promise_trial import describe_difference

DEFECTS = defects.DEFECTS
MANY = scaled(1) if not FIXED else 1


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_every_chip_of_ours_passes(name):
    chip_conformance(name, seed=SEED, programs=MANY)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHIPS.built_in)
def test_every_chip_of_ours_passes_in_many_programs(name):
    chip_conformance(name, programs=max(60, EXAMPLES))


@pytest.mark.slow
@pytest.mark.parametrize("chip", [TOY, TOY8, *CHIPS.built_in])
def test_uncompiled_code_gives_the_same_bits(chip):
    chip_conformance(chip, seed=SEED, programs=2, promises=["pins_by_name"], uncompiled=True)


@pytest.mark.slow
def test_a_chip_that_differs_uncompiled_is_detected():
    with pytest.raises(
        ConformanceError, match=r"compiled = uncompiled\n    but: in program 0, act 0, compiled code leaves"
    ):
        chip_conformance(
            defects.UncompiledClockDiffers, seed=SEED, programs=1, promises=["pins_by_name"], uncompiled=True
        )


test_toy = chip_conformance.tests(TOY, seed=SEED, programs=2)


def test_a_chip_of_eight_axes_passes():
    chip_conformance(TOY8, seed=SEED, programs=1)


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_planted_defect_is_detected_and_its_promise_named(defect):
    chip, promise, words = DEFECTS[defect]
    with pytest.raises(ConformanceError, match=r"TOY|seed=") as error:
        chip_conformance(chip, seed=SEED, programs=4, promises=[promise])
    assert error.value.broken.keys() == {promise}
    assert re.search(words, error.value.broken[promise]), error.value
    assert f"seed={SEED}" in str(error.value)


def test_a_promise_that_is_none_is_refused_with_those_that_are():
    with pytest.raises(ArgumentError, match=r"unknown promise 'snapshot'. Did you mean 'snapshots'"):
        chip_conformance(TOY, promises=["snapshot"])


def test_another_seed_each_time_is_printed(capsys):
    for _ in range(2):
        chip_conformance(TOY, promises=["pins_by_name"])
    assert len(set(capsys.readouterr().out.splitlines())) == 2


def test_only_a_pin_that_something_else_drives_is_left_out_of_harmless_acts():
    """harmless([Act("write", ...)], chip) of a chip whose write raises: that is the chip's mistake"""

    class RefusingPins:
        def __setattr__(self, name, value):
            raise StageError("an encoder drives it")

    def write(address, value):
        raise StageError("broken")

    chip = SimpleNamespace(
        write=write, axes=[SimpleNamespace(pins=RefusingPins())], INPUTS={"org": 1}, read=lambda address: 0
    )
    assert chip_actions.limit_pulses([chip_actions.Act("pin", 0, 0, 1), chip_actions.Act("read", 1)], chip) == [
        chip_actions.Act("read", 1)
    ]
    with pytest.raises(StageError, match="broken"):
        chip_actions.limit_pulses([chip_actions.Act("write", 0, 1)], chip)


def test_a_move_of_a_test_has_no_more_pulses_than_its_register_holds(monkeypatch):
    chip = PCL240K()
    small = replace(
        PCL240K.MAP, registers=tuple(replace(r, legal=(0, 70)) if r.name == "R0" else r for r in PCL240K.MAP.registers)
    )
    monkeypatch.setattr(PCL240K, "MAP", small)
    created = {chip_actions.draw_move(chip, 0, np.random.default_rng(seed))[1] for seed in range(6)}
    assert max(created) == 70


def test_a_core_that_never_answers_is_a_broken_promise_and_the_others_are_tried():
    """chip_conformance(EndlessRead, limit=0.5), where reads of one address never return"""
    began = time.monotonic()
    with pytest.raises(ConformanceError, match=r"TOY|seed=") as error:
        chip_conformance(defects.EndlessRead, seed=SEED, programs=1, promises=["reads", "pins_by_name"], limit=0.5)
    assert error.value.broken.keys() == {"reads"}
    assert error.value.broken["reads"].startswith("it has not ended after 0.5 s: does the core loop without end?")
    assert time.monotonic() - began < 20


def test_a_core_that_ends_its_process_is_a_broken_promise():
    with pytest.raises(ConformanceError) as error:
        chip_conformance(defects.CrashingRead, seed=SEED, programs=1, promises=["reads", "pins_by_name"])
    assert error.value.broken.keys() == {"reads"}
    assert (
        "its process was ended by SIGSEGV: does the core write or read beyond an array?" in error.value.broken["reads"]
    )


def test_after_a_promise_that_does_not_finish_the_others_have_less_time(monkeypatch):
    monkeypatch.setattr(conformance, "SHORT_TIME_LIMIT_S", 0.5)
    argument = []
    monkeypatch.setattr(
        BoundedChildProcess,
        "run_next",
        lambda self, limit: argument.append(limit) or f"{TIME_LIMIT_MESSAGE} {limit:g} s",
    )
    with pytest.raises(ConformanceError):
        chip_conformance(TOY, promises=["reads", "pins_by_name"], limit=30)
    tests = chip_conformance.tests(TOY, limit=20)
    for promise in ("reads", "pins_by_name"):
        with pytest.raises(ConformanceError):
            tests(promise)
    assert argument == [30, 0.5, 20, 0.5]


def test_a_core_that_cannot_be_compiled_is_reported_once():
    """A function of the core writes to an array of its module"""

    class FailingAnswer:
        @property
        def c(self):
            raise NativeError("core.py, line 5: what changes is a field of the record")

    broken = type("TOY", (TOY,), {"CORE": defects.build_core(power_up=FailingAnswer())})
    with pytest.raises(ConformanceError, match=r"TOY: core\.py, line 5") as error:
        chip_conformance(broken)
    assert list(error.value.broken) == ["has_what_every_chip_has"]


def test_a_failure_of_uncompiled_code_is_reported_with_its_place():
    with pytest.raises(
        ConformanceError, match=r"as plain Python it fails: IndexError: beyond \(File \".*defects.py\", line \d+, in "
    ):
        chip_conformance(
            defects.UncompiledIndexError, seed=SEED, programs=1, promises=["pins_by_name"], uncompiled=True
        )


def test_a_driver_that_reads_the_wiring_of_its_axis_gets_the_default():
    """write_move(...) sets polarities by self.axis.wiring: '_BareAxis' object has no attribute 'wiring'"""
    chip_conformance(defects.ChecksWiring, seed=SEED, programs=1, promises=["courses"])


def test_a_limit_is_a_time_or_none():
    for limit in (0, -1.0, float("nan")):
        with pytest.raises(ArgumentError, match=r"limit=.*: seconds above 0, or None for no limit"):
            chip_conformance(TOY, limit=limit)
    chip_conformance(TOY, seed=SEED, programs=1, promises=["pins_by_name"], limit=None)
    with pytest.raises(ZeroDivisionError):
        BoundedChildProcess([lambda: str(1 // 0)]).run_next(None)


def test_the_text_of_a_promise_arrives_complete_and_a_silent_process_is_reported():
    words = "it answers " + "x" * 200_000
    child = BoundedChildProcess([lambda: words, lambda: os._exit(3), lambda: words])
    assert child.run_next(20) == words
    assert child.run_next(20) == "its process ended with status 3 and no word"
    assert child.run_next(20) == words


def test_promises_run_in_one_process_until_one_hangs():
    get_process = lambda: str(os.getpid())  # noqa: E731
    child = BoundedChildProcess([get_process, get_process, lambda: time.sleep(60) or "", get_process])
    first, second = child.run_next(60), child.run_next(60)
    assert first == second != str(os.getpid())
    assert child.run_next(0.01).startswith(f"{TIME_LIMIT_MESSAGE} 0.01 s")
    assert child.run_next(60) not in (first, str(os.getpid()))
    child.close()


def test_moves_of_a_driver_are_tried_in_both_directions():
    directions = {np.sign(chip_actions.draw_move(PCL240K(), 0, np.random.default_rng(seed))[1]) for seed in range(8)}
    assert directions == {-1, 1}


@pytest.mark.parametrize("address", range(4))
def test_a_peek_that_changes_something_is_detected_also_where_reading_acts(address):
    """A chip whose `peek` clears a latch at an address of READING_ACTS, as its `read` does"""

    class Looks(Exception):
        pass

    def peek(pointer, at):
        state[0] += at == address

    def require_same_bits(before, now, when):
        if before != now:
            raise Looks(when)

    state = np.zeros(1, np.int64)
    chip = SimpleNamespace(
        AXES=1, ADDRESSES=4, DATA_MASK=255, READING_ACTS={3}, CORE=SimpleNamespace(peek=SimpleNamespace(with_gil=peek)),
        state=state,
        pointer=0, output_word=lambda axis: 0, read=lambda at: 0,
    )  # fmt: skip
    with pytest.raises(Looks, match=f"^after peek\\({address}h\\)$"):
        promises.bus._check_peeks_and_reads(SimpleNamespace(kind=None, require_same_bits=require_same_bits), chip)


def test_a_difference_at_the_pins_alone_is_described():
    one, other = (({"R1": 5}, [outputs], [0]) for outputs in (1, 3))
    assert describe_difference(one, other) == "pins ([1], [0]), and after power-up ([3], [0])"
