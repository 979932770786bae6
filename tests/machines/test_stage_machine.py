"""Whatever happens to a stage of three kinds of chips, the named invariants of stage_machine.py hold."""

import pytest
from hypothesis.stateful import run_state_machine_as_test
from machine_profile import everyday, long
from stage_machine import StageMachine


def test_whatever_happens_to_a_stage_its_invariants_hold():
    run_state_machine_as_test(StageMachine, settings=everyday(40, 15))


@pytest.mark.slow
def test_whatever_happens_to_a_stage_for_minutes_its_invariants_hold():
    run_state_machine_as_test(StageMachine, settings=long(400, 40))
