"""Export of a plan as a self-contained C header with the bus bytes and a function that writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stage.board.bus.host_record import LATCH, WORD
from stage.board.bus_layouts import make_default_layout
from stage.chips import Chip
from stage.tune.bus_listing import BusCycle, RegisterValue

TEMPLATE = """\
/* {title}
{notes}
 *
 * Give {name}_move two functions of yours, how your board writes to the chip and how it waits:
 *
 *     static void write_chip(unsigned address, unsigned long value) {{ {example}; }}
 *     static void wait_us(unsigned long us) {{ usleep(us); }}
 *
 *     {name}_move(write_chip, wait_us); the chip is as after power-up; then poll it until it has stopped
 */
#ifndef {guard}
#define {guard}

{defines}

struct {name}_write {{
    unsigned address;    /* of the chip's bus */
    unsigned long value; /* {bits} bits */
    unsigned long us;    /* to wait afterwards */
}};

static const struct {name}_write {name}_writes[] = {{
{writes}
}};

static void {name}_move(void (*write)(unsigned address, unsigned long value), void (*wait)(unsigned long us))
{{
    unsigned k;
    for (k = 0; k < sizeof {name}_writes / sizeof *{name}_writes; k++) {{
        write({name}_writes[k].address, {name}_writes[k].value);
        if ({name}_writes[k].us)
            wait({name}_writes[k].us);
    }}
}}

#endif
"""


def format_c_header(
    name: str,
    title: str,
    notes: Sequence[str],
    registers: Sequence[RegisterValue],
    cycles: Sequence[BusCycle],
    chip: Chip,
) -> str:
    """Format the C header of a move.

    Args:
        name: Prefix of its function, array and defines.
        title: First line of the leading comment.
        notes: Further lines of the leading comment.
        registers: Registers that get a define each.
        cycles: Bus cycles in order.
        chip: Chip of the axis.

    Returns:
        Text of the header.
    """
    mask = chip.DATA_MASK
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    name_width = max((len(register.name) for register in registers), default=0)
    defines = "\n".join(
        f"#define {name.upper()}_{_to_identifier(register.name):{name_width}} {_format_value(register):>12} "
        f"/* {_escape_comment(register.meaning_with_unit)} */"
        for register in registers
    )
    lines = []
    for k, cycle in enumerate(cycles):
        if cycle.address is None:
            continue
        wait_us = sum(wait.value for wait in _take_leading_waits(cycles[k + 1 :])) // 1000
        digits = (mask.bit_length() + 3) // 4
        lines.append(
            f"    {{{cycle.address}, 0x{cycle.value & mask:0{digits}X}, {wait_us}}}, /* {_escape_comment(cycle.meaning)} */"
        )
    return TEMPLATE.format(
        title=_escape_comment(title),
        notes="\n".join(f" * {_escape_comment(note)}".rstrip() for note in notes),
        name=name,
        guard=f"{name.upper()}_H",
        defines=defines,
        bits=mask.bit_length(),
        writes="\n".join(lines),
        example=_format_write_example(chip, {cycle.address for cycle in cycles}),
    )


def _format_write_example(chip: Chip, used_addresses: set[int | None]) -> str:
    """Format the C statement of a write cycle on a board with the usual layout.

    A board whose ports do not match the chip's addresses gets a call of a placeholder function.
    """
    layout = make_default_layout(chip)
    base = f"0x{layout.base:X}"
    kinds, port_addresses = {kind for kind, _ in layout.ports}, {address for _, address in layout.ports}
    if LATCH in kinds:
        return f"outb(address, {base}); outb(value, {base} + 1)"
    if not used_addresses <= {None, *port_addresses}:
        return "send(address, value)"
    return f"outw(value, {base} + 2 * address)" if WORD in kinds else f"outb(value, {base} + address)"


def _take_leading_waits(cycles: Sequence[BusCycle]) -> list[BusCycle]:
    """Return the waits before the first write."""
    waits = []
    for cycle in cycles:
        if cycle.address is not None:
            break
        waits.append(cycle)
    return waits


def _format_value(register: RegisterValue) -> str:
    return f"{register.value}L" if abs(register.value) > 0x7FFF else str(register.value)


def _to_identifier(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _escape_comment(text: str) -> str:
    """Break up comment delimiters, so that the text can stand in a C comment."""
    return text.replace("*/", "* /").replace("/*", "/ *")
