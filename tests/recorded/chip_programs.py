"""Random bus programs of every chip: one entry a program."""

from functools import partial

from recorded import hctl1100_programs, nova_programs, pcl240_programs
from recorded.bus_player import BusPlayer, Draw, add_checkpoints

from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX314AS, MCX501, MCX512, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.native import COMPILED

ROUNDS = {PCL240K: 8, PCL240MK: 8, PCL240MS: 14, MCX514: 14, MCX304: 8, MCX302: 8, MCX312: 12, HCTL1100: 12}
"""How often a chip plays each of its stories, times the story's own weight."""
KIN = (MCX512, MCX501, MCX314AS)
"""Chips that are like the MCX514 or the MCX304 and lack some of it."""
KIN_ROUNDS = 4


def weigh_stories(chip):
    """Return a chip's stories, and how many programs of each it plays in a round."""
    if chip is HCTL1100:
        return hctl1100_programs.STORIES
    return pcl240_programs.STORIES if chip.__name__.startswith("PCL") else nova_programs.weigh_stories(chip)


def draw_program(chip, name):
    """Return a new chip and the program of this name: story and number."""
    draw = Draw(f"{chip.__name__} {name}")
    story = name.rpartition("-")[0]
    if chip is HCTL1100:
        program = hctl1100_programs.draw_program(story, draw)
    elif chip.__name__.startswith("PCL"):
        program = pcl240_programs.draw_program(chip, story, draw)
    else:
        kind = nova_programs.KinPrograms if chip in KIN or story == "fed" else nova_programs.NovaPrograms
        program = kind(chip, draw).draw_program(story)
    options = {"errata": draw.chance(0.7)} if chip in (MCX302, MCX304, MCX312) and story != "fed" else {}
    return chip(**options), add_checkpoints(program)


def play_programs(chip, story, number):
    """Play a story's programs. Uncompiled only the first: it takes a hundred times as long."""
    results = {}
    for k in range(number if COMPILED else 1):
        one, program = draw_program(chip, f"{story}-{k}")
        results[f"{story}-{k}"] = BusPlayer(one, k % chip.AXES).play(program)
    return results


FILES = {
    f"chips_{chip.__name__}": {
        story: partial(play_programs, chip, story, weight * rounds) for story, weight in weigh_stories(chip).items()
    }
    for chip, rounds in ROUNDS.items()
} | {
    f"chips_{chip.__name__}": {
        story: partial(play_programs, chip, story, nova_programs.KIN_PROGRAMS.get(story, KIN_ROUNDS))
        for story in nova_programs.list_kin_stories(chip)
    }
    for chip in KIN
}  # fmt: skip
for _chip in (MCX514, MCX304, MCX312):
    FILES[f"chips_{_chip.__name__}"]["fed"] = partial(play_programs, _chip, "fed", nova_programs.KIN_PROGRAMS["fed"])
