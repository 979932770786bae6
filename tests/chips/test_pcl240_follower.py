"""PCL-240 family: a chip whose SYNI is connected to another's SYNO agrees with its reference to the clock on any program."""

import random

import pytest
from support.examples import EXAMPLES, SEED
from support.pcl240k_programs import Pair
from support.pcl240ms_programs import ANY_REAL_PROGRAM, CHAOTIC_PROGRAM, PAIRS, draw, register

from stage.chips import PCL240K
from stage.errors import ArgumentError


class Followers(Pair):
    """Product and reference behind a leader each, whose R7 changes between the operations of a program."""

    def __init__(self, name, rng):
        super().__init__(rng.random() < 0.5, *PAIRS[name])
        chip, model = PAIRS[name]
        self.leaders, self.rng = (chip(), model()), rng
        self.chip.syni, self.model.leader = self.leaders

    def do(self, operation):
        if operation[0] in ("advance", "trace") and self.rng.random() < 0.4:
            for _, address, value in register(7, self.rng.choice([0, 1, 2, 2, 3, 4, 6, 1023])):
                for leader in self.leaders:
                    leader.write(address, value)
            self.log.append(f"          leader R7 = {self.leaders[1].registers[7]}")
        super().do(operation)


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("kind", [ANY_REAL_PROGRAM, CHAOTIC_PROGRAM], ids=["real", "any"])
def test_a_follower_agrees_to_the_clock_while_its_leaders_r7_changes(name, kind):
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED)
    for _ in range(max(EXAMPLES // 4, 5)):
        Followers(name, rng).play(draw(rng, kind))


def test_a_follower_is_connected_by_its_syni_and_to_a_chip_of_its_family_and_clock():
    leader, follower = PCL240K(), PCL240K()
    follower.syni = leader
    assert follower.syni is leader
    follower.syni = None
    assert follower.syni is None
    for wrong in (follower, PCL240K(4_000_000), "x"):
        with pytest.raises(ArgumentError, match="another chip of the PCL-240 family"):
            follower.syni = wrong
