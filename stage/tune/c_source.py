"""A plan in C: a header without any other, whose bytes a driver writes in order."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stage.board.bus.host_record import LATCH, WORD
from stage.board.layouts import default_layout
from stage.chips import Chip
from stage.tune.written import Cycle, Row

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


def c_source(
    name: str, title: str, notes: Sequence[str], rows: Sequence[Row], cycles: Sequence[Cycle], chip: Chip
) -> str:
    """The header. name: of its function and array."""
    mask = chip.DATA_MASK
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    wide = max((len(r.name) for r in rows), default=0)
    defines = "\n".join(
        f"#define {name.upper()}_{_word(r.name):{wide}} {_value(r):>12} /* {_plain(r.words)} */" for r in rows
    )
    lines = []
    for k, c in enumerate(cycles):
        if c.address is None:
            continue
        after = sum(d.value for d in _waits(cycles[k + 1 :])) // 1000
        digits = (mask.bit_length() + 3) // 4
        lines.append(f"    {{{c.address}, 0x{c.value & mask:0{digits}X}, {after}}}, /* {_plain(c.words)} */")
    return TEMPLATE.format(
        title=_plain(title), notes="\n".join(f" * {_plain(n)}".rstrip() for n in notes), name=name, guard=f"{name.upper()}_H",
        defines=defines, bits=mask.bit_length(), writes="\n".join(lines), example=_example(chip, {c.address for c in cycles}),
    )  # fmt: skip


def _example(chip: Chip, used: set[int | None]) -> str:
    """How a board with the usual layout makes a write cycle, in C; where its ports are not the chip's addresses, a call."""
    layout = default_layout(chip)
    base = f"0x{layout.base:X}"
    kinds, there = {kind for kind, _ in layout.ports}, {address for _, address in layout.ports}
    if LATCH in kinds:
        return f"outb(address, {base}); outb(value, {base} + 1)"
    if not used <= {None, *there}:
        return "send(address, value)"
    return f"outw(value, {base} + 2 * address)" if WORD in kinds else f"outb(value, {base} + address)"


def _waits(after: Sequence[Cycle]) -> list[Cycle]:
    """Those before the next write."""
    found = []
    for c in after:
        if c.address is not None:
            break
        found.append(c)
    return found


def _value(r: Row) -> str:
    return f"{r.value}L" if abs(r.value) > 0x7FFF else str(r.value)


def _word(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _plain(text: str) -> str:
    """A text that may stand in a comment."""
    return text.replace("*/", "* /").replace("/*", "/ *")
