"""Wires between chips of one kind, compiled: the chips run from one change of the wires to the next.

The outputs of all chips are combined into one word of 63 bits. Its *levels* are on if any chip drives them; bit 0 is always on
and means that there are wires. Its *number* is the largest that any chip drives. Its count of *pulses* is the sum of the counts
of all chips. `read_wire_output` returns the output of one chip, `read_wire_word` the last word that the chip has received.
`set_wire_word` brings the chip a new word, and its journal records that.

Signals on the wires take no time: the other chips receive them at the same clock, after their own pulses of that clock.
"""

from __future__ import annotations

from stage.chips import cores
from stage.chips.journal_entries import WIRES
from stage.native import greatest, hot, least

LEVEL_BITS = 3
"""Number of bits that are levels; the lowest means that there are wires."""
NUMBER_SHIFT, PULSES_SHIFT = LEVEL_BITS, 33
"""Lowest bits of the number and of the count of pulses; both have 30 bits."""
LINKED = 1
_ALL = (1 << 30) - 1
MAX_ROUNDS = 8  # of exchanges at one clock


@hot
def read_number(word):
    """Return the number that a word on the wires contains."""
    return word >> NUMBER_SHIFT & _ALL


@hot
def count_new_pulses(word, old):
    """Return the number of pulses that were driven between an older word on the wires and a newer one."""
    return (word >> PULSES_SHIFT) - (old >> PULSES_SHIFT) & _ALL


@hot
def pack_word(levels, number, pulses):
    """Pack the levels, the number and the pulse count that a chip drives into one word for the wires.

    Args:
        levels: Levels that it drives.
        number: Its number.
        pulses: Pulses that it has driven since power-up.
    """
    return levels | number << NUMBER_SHIFT | (pulses & _ALL) << PULSES_SHIFT


@hot
def _combine_outputs(chips, link_number):
    """Combine the outputs of all chips on the wires into one word: any level, the largest number, the sum of the pulses."""
    levels, maximum, pulses = LINKED, 0, 0
    for i in range(len(chips)):
        if chips[i].link == link_number:
            share_of_chip = cores.read_wire_output(chips[i])
            levels |= share_of_chip & (1 << LEVEL_BITS) - 1
            maximum = greatest(maximum, read_number(share_of_chip))
            pulses += share_of_chip >> PULSES_SHIFT
    return pack_word(levels, maximum, pulses)


@hot
def exchange_words(chips, link_number, now, edges, n_edges):
    """Bring every linked chip the combined word of the wires, and repeat that until no chip changes its output.

    Args:
        chips: CHIP records.
        link_number: Number of the link.
        now: Time of the stage, ns.
        edges: Records for the journals.
        n_edges: Number of them so far.

    Returns:
        The number of records.
    """
    for _ in range(MAX_ROUNDS):
        word, quiet = _combine_outputs(chips, link_number), True
        for i in range(len(chips)):
            chip = chips[i]
            if chip.link != link_number or cores.read_wire_word(chip) == word:
                continue
            quiet = False
            cores.set_wire_word(chip, word)
            if n_edges < len(edges):
                e = edges[n_edges]
                e.now, e.clock, e.axis, e.kind, e.a = (
                    now,
                    cores.read_clock(chip),
                    cores.find_stage_axis(chip, 0),
                    WIRES,
                    word,
                )
                n_edges += 1
        if quiet:
            break
    return n_edges


@hot
def run_linked_chips(chips, link_number, until, now, edges, n_edges):
    """Let the clocks of linked chips run up to a clock.

    Args:
        chips: CHIP records.
        link_number: Number of the link.
        until: Clock at the end.
        now: Time of the stage, ns.
        edges: Records for the journals.
        n_edges: Number of them so far.

    Returns:
        The number of records.
    """
    n_edges = exchange_words(chips, link_number, now, edges, n_edges)
    while True:
        at, earliest = until, until
        for i in range(len(chips)):
            if chips[i].link == link_number:
                earliest = least(earliest, cores.read_clock(chips[i]))
                at = least(at, cores.find_wire_output_end(chips[i]))
        if earliest >= until:
            return n_edges
        at = greatest(at, earliest + 1)
        for i in range(len(chips)):
            if chips[i].link == link_number:
                cores.run(chips[i], at)
        n_edges = exchange_words(chips, link_number, now, edges, n_edges)
