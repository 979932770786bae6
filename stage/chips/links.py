"""Wires between chips of one kind, compiled: chips that are linked run together, from one change on the wires to the next.

What all of them drive makes one word, of 63 bits: *levels*, which are on where any chip drives them (bit 0 is always on: there are
wires); a *number*, the largest that any chip gives; and a count of *pulses*, those of all chips together. A chip's own share is
its answer to `says`; `heard` is the word that it heard last, and `hear_wires` lets it hear another one, which its journal notes.

Nothing on the wires takes time: what a chip drives at a clock the others hear at that clock, after their own pulses of it.
"""

from __future__ import annotations

from stage.chips import cores
from stage.chips.entries import WIRES
from stage.native import greatest, hot, least

LEVELS = 3
"""Bits of the word that are levels; the lowest says that there are wires."""
NUMBER, PULSES = LEVELS, 33
"""Where the number and the count of pulses begin; both have 30 bits."""
LINKED = 1
_ALL = (1 << 30) - 1
ROUNDS = 8  # of answers at one clock


@hot
def number(word):
    """Return the number in a word."""
    return word >> NUMBER & _ALL


@hot
def pulses_since(word, old):
    """Return the pulses that are in a word and not in an older one."""
    return (word >> PULSES) - (old >> PULSES) & _ALL


@hot
def share(levels, number, pulses):
    """Put together what a chip drives: levels, with LINKED or without; a number; pulses that it has ever driven."""
    return levels | number << NUMBER | (pulses & _ALL) << PULSES


@hot
def _word(chips, link):
    """Put together what all chips drive onto the wires."""
    levels, maximum, pulses = LINKED, 0, 0
    for i in range(len(chips)):
        if chips[i].link == link:
            share_of_chip = cores.says(chips[i])
            levels |= share_of_chip & (1 << LEVELS) - 1
            maximum = greatest(maximum, number(share_of_chip))
            pulses += share_of_chip >> PULSES
    return share(levels, maximum, pulses)


@hot
def exchange(chips, link, now, edges, n_edges):
    """Bring every linked chip what is on the wires, until no chip drives anything new.

    Args:
        chips: CHIP records.
        link: Number of the link.
        now: Time of the stage, ns.
        edges: Records for the journals.
        n_edges: Number of them so far.

    Returns:
        The number of edges.
    """
    for _ in range(ROUNDS):
        word, quiet = _word(chips, link), True
        for i in range(len(chips)):
            c = chips[i]
            if c.link != link or cores.heard(c) == word:
                continue
            quiet = False
            cores.hear_wires(c, word)
            if n_edges < len(edges):
                e = edges[n_edges]
                e.now, e.clock, e.axis, e.kind, e.a = now, cores.clock(c), cores.axis_of(c, 0), WIRES, word
                n_edges += 1
        if quiet:
            break
    return n_edges


@hot
def run(chips, link, until, now, edges, n_edges):
    """Let the clocks of linked chips run up to a clock.

    Args:
        chips: CHIP records.
        link: Number of the link.
        until: Clock at the end.
        now: Time of the stage, ns.
        edges: Records for the journals.
        n_edges: Number of them so far.

    Returns:
        The number of edges.
    """
    n_edges = exchange(chips, link, now, edges, n_edges)
    while True:
        at, earliest = until, until
        for i in range(len(chips)):
            if chips[i].link == link:
                earliest = least(earliest, cores.clock(chips[i]))
                at = least(at, cores.silent(chips[i]))
        if earliest >= until:
            return n_edges
        at = greatest(at, earliest + 1)
        for i in range(len(chips)):
            if chips[i].link == link:
                cores.run(chips[i], at)
        n_edges = exchange(chips, link, now, edges, n_edges)
