"""A panel's program written down: as Python, as C for `stage run`, as a test. No page.

The bytes go out at the times at which they went out on the panel: in Python to the tick of each chip, in C to the microsecond.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.board import layouts
from stage.board.host import BYTE, LATCH, LATCHED, WORD
from stage.errors import ArgumentError, StageError

if TYPE_CHECKING:
    from stage.panel.server import Panel
    from stage.panel.share import Shared


class Sent(NamedTuple):
    """A bus cycle of a program. ns: from when on its chip's clock is that at which it came; value: None of a read."""

    ns: int
    chip: int
    address: int
    value: int | None


def stage_of(made: dict[str, Any]) -> str:
    """Python that makes the stage of these options."""
    from stage.cli import setup

    given = [repr(made["model"])]
    each = setup.chips_of(made["chips"]) if "=" in made["chips"] else None
    given.append(f"chips={each or made['chips']!r}")
    if drives := _drives(made, each):
        given.append(f"drives={drives}")
    if made["bus_cycle"] != 1e-6:
        given.append(f"bus_cycle={made['bus_cycle']!r}")
    for name, value in (
        ("wiring", setup.wiring_of(made["wiring"])),
        ("multichip", setup.multichip_of(made["multichip"])),
        ("syni", setup.syni_of(made["syni"])),
    ):
        if value:
            given.append(f"{name}={value!r}")
    return f"Stage({', '.join(given)})"


def _drives(made: dict[str, Any], each: dict[str, str] | None) -> str:
    """Python that makes the drives of these options, as stage.cli.setup does; "" for the usual ones. each: chips by axis."""
    from stage.chips import chip_class

    motor = f"motor={made['motor']!r}, " if made["motor"] is not None else ""
    stepper = f"Drive({motor}microsteps={made['microsteps']}, bus_voltage={made['bus_voltage']!r})"
    usual = not motor and made["microsteps"] == 16 and made["bus_voltage"] == 24.0
    servo = {axis: chip_class(name).SERVO for axis, name in (each or {"": made["chips"]}).items()}
    if usual or (all(servo.values()) and not motor):
        return ""
    if len(set(servo.values())) == 1:
        return repr(made["motor"]) if all(servo.values()) else stepper
    parts = (f"{axis!r}: {repr(made['motor']) if of_servo else stepper}" for axis, of_servo in servo.items())
    return f"{{{', '.join(parts)}}}"


def _of_power_up(panel: Panel, shared: Shared) -> None:
    if shared.start[0] != 0:
        raise ArgumentError(
            "this program does not begin at power-up: press power-up first, or save everything, which has where it begins."
        )


def _python_lines(panel: Panel, shared: Shared, now: int) -> tuple[str, str]:
    """What makes the stage, and what plays the program on it; both begin at the left."""
    drive = "Drive, " if "Drive(" in stage_of(shared.made or {}) else ""
    words = _words(panel, shared)
    rows = "\n".join(
        f"    ({s.ns}, {s.chip}, {s.address}, {s.value}),{f'  # {w}' if w else ''}"
        for s, w in zip(shared.sent, words, strict=True)
    )
    loads = "".join(f"    stage.set_payload({kg!r}, {body!r})\n" for body, kg in shared.payloads.items() if kg)
    head = f"""from stage import {drive}Stage

END = {now}  # ns
PROGRAM = (  # ns, chip, address, value; None: a read
{rows}
)


def play(stage):
    \"\"\"Each cycle ends at its time.\"\"\"
    cycle = round(stage.bus_cycle * 1e9)
    for ns, chip, address, value in PROGRAM:
        stage.run_to(ns - cycle)
        if value is None:
            stage.chips[chip].read(address)
        else:
            stage.chips[chip].write(address, value)
    stage.run_to(END)
"""
    make = f"""    stage = {stage_of(shared.made or {})}
{loads}    play(stage)
"""
    return head, make


def to_python(panel: Panel, shared: Shared, now: int) -> str:
    """A program: the same bits, where nothing was broken or pushed."""
    _check(panel, shared)
    head, make = _python_lines(panel, shared, now)
    said = f"The panel's program, {len(shared.sent)} bus cycles in {now * 1e-9:.3f} s of simulated time."
    shown = "    for axis in stage.axes.values():\n        print(axis)\n"
    return f'"""{said}"""\n\n{head}\n\nif __name__ == "__main__":\n{make}{shown}'


def to_pytest(panel: Panel, shared: Shared, now: int) -> str:
    """A test: the axes end where they are now, with as many steps lost and as many mistakes noted."""
    _check(panel, shared)
    head, make = _python_lines(panel, shared, now)
    asserted = ""
    stage = panel.session.stage
    for name, axis in stage.axes.items():
        asserted += f"    assert stage.axes[{name!r}].position == pytest.approx({axis.position!r}, abs=1e-6)\n"
        asserted += f"    assert stage.axes[{name!r}].lost_steps == {axis.lost_steps}\n"
    for k, chip in enumerate(stage.chips):
        asserted += f"    assert [d.message for d in stage.chips[{k}].diagnostics] == {[d.message for d in chip.diagnostics]!r}\n"
    return (
        f'"""What was done on a panel, as a test."""\n\nimport pytest\n\n{head}\n\n'
        f"def test_what_was_done_on_the_panel():\n{make}{asserted}"
    )


def to_c(panel: Panel, shared: Shared, now: int) -> str:
    """Firmware for `stage run`: the same cycles, to the microsecond."""
    _check(panel, shared)
    chips = {k: chip for k, chip in enumerate(panel.session.stage.chips)}
    places = {p.index: p for p in layouts.places(chips, None, None, None)}
    lines = []
    for s, words in zip(shared.sent, _words(panel, shared), strict=True):
        cycles = _ports(places[s.chip], s)
        lines.append(f"    at({s.ns // 1000});{''.join(f' {c};' for c in cycles)}{f' /* {words} */' if words else ''}")
    made = shared.made or {}
    command = shlex.join(["stage", "run", "program.c", "--model", made["model"], "--chips", made["chips"]])
    return f"""/* What was done on a panel: {command.replace("*/", "* /")} */
#include <pulsestage.h>

static void at(uint64_t us)
{{
    uint64_t now = ps_micros();
    if (now < us)
        ps_delay_us((uint32_t)(us - now));
}}

PULSESTAGE_MAIN
{{
{chr(10).join(lines)}
    at({now // 1000});
    return 0;
}}
"""


def _ports(place: Any, s: Sent) -> list[str]:
    """The port cycles that reach an address of a chip."""
    for n, (kind, address) in enumerate(place.layout.ports):
        bits = {BYTE: 8, WORD: 16}.get(kind)
        if bits and address == s.address:
            port = f"0x{place.first + n:X}"
            return [f"ps_in{bits}({port})" if s.value is None else f"ps_out{bits}({port}, 0x{s.value:X})"]
    kinds = [kind for kind, _ in place.layout.ports]
    if LATCH in kinds and LATCHED in kinds:
        latch, data = (f"0x{place.first + kinds.index(kind):X}" for kind in (LATCH, LATCHED))
        return [
            f"ps_out8({latch}, 0x{s.address:X})",
            f"ps_in8({data})" if s.value is None else f"ps_out8({data}, 0x{s.value:X})",
        ]
    raise StageError(f"address {s.address} of {type(place.chip).__name__} has no port in its layout.")


def _words(panel: Panel, shared: Shared) -> list[str]:
    """What each cycle says, as in the trace."""
    listeners = [type(chip)(**chip.options()).listener() for chip in panel.session.stage.chips]
    found = []
    for s in shared.sent:
        hears = listeners[s.chip]
        found.append("" if s.value is None else hears.write(s.address, s.value).replace("*/", "* /"))
    return found


def _check(panel: Panel, shared: Shared) -> None:
    if shared.made is None:
        raise StageError(
            "a program of yours has made this stage, and only that knows how: save everything in its place."
        )
    _of_power_up(panel, shared)


FORMATS: dict[str, Callable[[Any, Any, int], str]] = {
    "program.py": to_python, "program.c": to_c, "test_program.py": to_pytest,
}  # fmt: skip
"""By the name of the file."""
