"""Wires between chips of one kind, as multichip interpolation uses them; compiled.

The outputs of all chips are combined into one word of 63 bits. Its *levels* are on if any chip drives them; bit 0 is always on
and means that there are wires. Its *number* is the largest that any chip drives. Its count of *pulses* is the sum of the counts
of all chips. `read_wire_output` returns the output of one chip, `read_wire_word` the last word that the chip has received.
`set_wire_word` passes the chip a new word, which the chip's journal records. The chips run from one change of the word to the next.

Signals on the wires take no time: the other chips receive them at the same clock, after their own pulses of that clock.
"""

from __future__ import annotations

from stage.chips import core_interface
from stage.chips.journal_entries import WIRES
from stage.native import greatest, hot, least

LEVEL_BITS = 3
"""Number of bits of a word that are levels; the lowest level is 1 if the chips are wired."""
NUMBER_SHIFT, PULSES_SHIFT = LEVEL_BITS, 33
"""Lowest bits of the number and of the count of pulses; both have 30 bits."""
LINKED = 1
_FIELD_MASK = (1 << 30) - 1
MAX_ROUNDS = 8  # of exchanges at one clock


@hot
def read_wire_number(word):
    """Return the number field of a wire word, the word that linked chips drive onto their common wires."""
    return word >> NUMBER_SHIFT & _FIELD_MASK


@hot
def count_new_pulses(new_word, old_word):
    """Return the number of pulses that linked chips made between an older and a newer wire word (see `pack_wire_word`)."""
    return (new_word >> PULSES_SHIFT) - (old_word >> PULSES_SHIFT) & _FIELD_MASK


@hot
def pack_wire_word(levels, number, pulses):
    """Pack the levels, the number and the pulse count that a linked chip drives into one word for the wires between chips.

    Args:
        levels: Levels that the chip drives, as bits.
        number: Number that the chip drives.
        pulses: Pulses that the chip has made since power-up.
    """
    return levels | number << NUMBER_SHIFT | (pulses & _FIELD_MASK) << PULSES_SHIFT


@hot
def _combine_outputs(chips, link_number):
    """Combine the words of all chips of a link into one wire word: all their levels, the largest number, the sum of the pulses."""
    levels, maximum, pulses = LINKED, 0, 0
    for i in range(len(chips)):
        if chips[i].link == link_number:
            share_of_chip = core_interface.read_wire_output(chips[i])
            levels |= share_of_chip & (1 << LEVEL_BITS) - 1
            maximum = greatest(maximum, read_wire_number(share_of_chip))
            pulses += share_of_chip >> PULSES_SHIFT
    return pack_wire_word(levels, maximum, pulses)


@hot
def exchange_wire_words(chips, link_number, now_ns, edges, edge_count):
    """Pass every linked chip the combined word of the wires, and repeat that until no chip changes its output.

    Args:
        chips: CHIP records.
        link_number: Number of the link.
        now_ns: Time of the stage, ns.
        edges: EDGE records for the journals of the chips.
        edge_count: Number of records that are filled.

    Returns:
        The new number of records that are filled.
    """
    for _ in range(MAX_ROUNDS):
        word, quiet = _combine_outputs(chips, link_number), True
        for i in range(len(chips)):
            chip = chips[i]
            if chip.link != link_number or core_interface.read_wire_word(chip) == word:
                continue
            quiet = False
            core_interface.set_wire_word(chip, word)
            if edge_count < len(edges):
                e = edges[edge_count]
                e.now = now_ns
                e.clock = core_interface.read_clock(chip)
                e.axis = core_interface.find_stage_axis(chip, 0)
                e.kind = WIRES
                e.a = word
                edge_count += 1
        if quiet:
            break
    return edge_count


@hot
def run_linked_chips(chips, link_number, until, now_ns, edges, edge_count):
    """Let the clocks of chips that are linked by wires run up to a clock.

    Args:
        chips: CHIP records.
        link_number: Number of the link.
        until: Clock at the end.
        now_ns: Time of the stage, ns.
        edges: EDGE records for the journals of the chips.
        edge_count: Number of records that are filled.

    Returns:
        The new number of records that are filled.
    """
    edge_count = exchange_wire_words(chips, link_number, now_ns, edges, edge_count)
    while True:
        at, earliest = until, until
        for i in range(len(chips)):
            if chips[i].link == link_number:
                earliest = least(earliest, core_interface.read_clock(chips[i]))
                at = least(at, core_interface.find_wire_output_end(chips[i]))
        if earliest >= until:
            return edge_count
        at = greatest(at, earliest + 1)
        for i in range(len(chips)):
            if chips[i].link == link_number:
                core_interface.run(chips[i], at)
        edge_count = exchange_wire_words(chips, link_number, now_ns, edges, edge_count)
