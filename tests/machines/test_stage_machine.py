"""Whatever happens to a stage, whichever chips move it, the named invariants of stage_machine.py hold."""

import pytest
from hypothesis.stateful import run_state_machine_as_test
from support.examples import scaled
from support.machines.machine_profile import everyday, long
from support.machines.stage_machine import ARRANGEMENTS, stage_machine_of


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_whatever_happens_to_a_stage_its_invariants_hold(arrangement):
    run_state_machine_as_test(stage_machine_of(arrangement), settings=everyday(scaled(5), 15))


@pytest.mark.slow
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_whatever_happens_to_a_stage_for_minutes_its_invariants_hold(arrangement):
    run_state_machine_as_test(stage_machine_of(arrangement), settings=long(400, 40))
