"""Whatever a host does to a chip, the named invariants of chip_machine.py and of its family hold."""

import pytest
from hypothesis.stateful import run_state_machine_as_test
from support.examples import scaled
from support.machines.chip_machine import machine_of
from support.machines.machine_profile import everyday, long

from stage.chips import CHIPS


@pytest.mark.parametrize("name", CHIPS.built_in)
def test_whatever_a_host_does_the_invariants_of_a_chip_hold(name):
    run_state_machine_as_test(machine_of(CHIPS[name]), settings=everyday(scaled(6)))


@pytest.mark.slow
@pytest.mark.parametrize("name", CHIPS.built_in)
def test_whatever_a_host_does_for_minutes_the_invariants_of_a_chip_hold(name):
    run_state_machine_as_test(machine_of(CHIPS[name]), settings=long(3000))
