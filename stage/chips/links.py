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
    return word >> NUMBER & _ALL


@hot
def pulses_since(word, old):
    """Pulses that are in a word and not in an older one."""
    return (word >> PULSES) - (old >> PULSES) & _ALL


@hot
def share(levels, number, pulses):
    """What a chip says: levels, with LINKED or without; a number; pulses that it has ever driven."""
    return levels | number << NUMBER | (pulses & _ALL) << PULSES


@hot
def _word(chips, link):
    """What is on the wires."""
    levels, most, pulses = LINKED, 0, 0
    for i in range(len(chips)):
        if chips[i].link == link:
            own = cores.says(chips[i])
            levels |= own & (1 << LEVELS) - 1
            most = greatest(most, number(own))
            pulses += own >> PULSES
    return share(levels, most, pulses)


@hot
def exchange(chips, link, now, edges, n_edges):
    """All hear what is on the wires, and what comes of it. Returns how many edges are noted by now, at `now` ns."""
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
    """Let the clocks of linked chips run up to `until`. Returns how many edges are noted by now, at `now` ns."""
    n_edges = exchange(chips, link, now, edges, n_edges)
    while True:
        at, here = until, until
        for i in range(len(chips)):
            if chips[i].link == link:
                here = least(here, cores.clock(chips[i]))
                at = least(at, cores.silent(chips[i]))
        if here >= until:
            return n_edges
        at = greatest(at, here + 1)
        for i in range(len(chips)):
            if chips[i].link == link:
                cores.run(chips[i], at)
        n_edges = exchange(chips, link, now, edges, n_edges)
