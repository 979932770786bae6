"""Which programs each chip plays, and what they record: a line a program, a digest a checkpoint."""

from functools import partial

from recorded import hctl_stories, nova_stories, pcl_stories
from recorded.player import Draw, Player, say, with_checks

from stage.chips import HCTL1100, MCX302, MCX304, MCX312, MCX514, PCL240K, PCL240MK, PCL240MS
from stage.native import COMPILED

ROUNDS = {PCL240K: 8, PCL240MK: 8, PCL240MS: 14, MCX514: 14, MCX304: 8, MCX302: 8, MCX312: 12, HCTL1100: 12}
"""How often a chip plays each of its stories, times the story's own weight."""
CHECKS = 3


def stories(chip):
    if chip is HCTL1100:
        return hctl_stories.STORIES
    return pcl_stories.STORIES if chip.__name__.startswith("PCL") else nova_stories.stories_of(chip)


def programs(chip):
    """Names of all programs: story and number."""
    return [f"{story}-{k}" for story, weight in stories(chip).items() for k in range(weight * ROUNDS[chip])]


def made(chip, name):
    """The chip, and the program of this name."""
    draw = Draw(f"{chip.__name__} {name}")
    story = name.rpartition("-")[0]
    if chip is HCTL1100:
        ops = hctl_stories.program(story, draw)
    elif chip.__name__.startswith("PCL"):
        ops = pcl_stories.program(chip.__name__, story, draw)
    else:
        ops = nova_stories.program(chip, story, draw)
    options = {"errata": draw.chance(0.7)} if chip in (MCX302, MCX304, MCX312) else {}
    return chip(**options), with_checks(ops, max(len(ops) // CHECKS, 4))


def digests(chip, name):
    one, program = made(chip, name)
    return " ".join(Player(one, int(name.rpartition("-")[2]) % chip.AXES).play(program))


def scene(chip, story):
    """All programs of a story. Uncompiled the first one only: it takes a hundred times as long."""
    names = [name for name in programs(chip) if name.startswith(f"{story}-")]
    return {name: digests(chip, name) for name in (names if COMPILED else names[:1])}


FILES = {f"chips_{chip.__name__}": {story: partial(scene, chip, story) for story in stories(chip)} for chip in ROUNDS}


def explain(file, kept, now):
    """What a chip did up to the first checkpoint that differs."""
    chip = next(c for c in ROUNDS if file == f"chips_{c.__name__}")
    name = next((k for k in now if now[k] != kept.get(k)), "")
    old, new = (str(some.get(name, "")).split() for some in (kept, now))
    number = next((k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), 0)
    return f"{name}, up to checkpoint {number + 1}, the first one that differs:\n{story_of(chip, name, number)}"


def story_of(chip, name, number):
    """The operations up to a checkpoint, and what the chip shows there."""
    one, ops = made(chip, name)
    player, checks, lines = Player(one), 0, []
    for op in ops:
        player.do(*op)
        if op == ("check",):
            checks += 1
            lines.append(f"{one.clock:>9}  --- checkpoint {checks}")
            if checks > number:
                break
        else:
            lines.append(f"{one.clock:>9}  {say(op)}")
    return "\n".join([*lines, *(f"{k} = {v}" for k, v in player.seen().items())])
