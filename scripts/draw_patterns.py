"""Every operation pattern and procedure of the PCL-240K data sheet, drawn by the emulated chip, with the bytes that make it.

python scripts/draw_patterns.py              writes docs/patterns.md and docs/pictures/patterns/*.png
python scripts/draw_patterns.py triangular   draws one picture
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from stage import firmware
from stage.chips import PCL240K
from stage.errors import StageError, unknown_name_error
from stage.firmware import Bench, Profile, Report

DOCS = Path(__file__).resolve().parents[1] / "docs"
P = Profile.of(fl=1000, fh1=8000, fh2=16_000, accel=0.2)
PATTERNS: list[Pattern] = []


@dataclass(frozen=True)
class Pattern:
    """One pattern: `run` makes the move on a new bench; its docstring is the page's text, its source the page's code."""

    name: str
    title: str
    source: str
    run: Callable[[], Report]

    @property
    def text(self) -> str:
        return " ".join((self.run.__doc__ or "").split())

    @property
    def code(self) -> str:
        body = inspect.getsource(self.run).partition('"""')[2].partition('"""')[2]
        return inspect.cleandoc(body).replace("return ", "report = ")


def pattern(title: str, source: str) -> Callable:
    def add(run: Callable[[], Report]) -> Callable[[], Report]:
        PATTERNS.append(Pattern(run.__name__, title, source, run))
        return run

    return add


def axis():
    """Return the axis of a new chip on a bench."""
    return Bench(PCL240K()).axes["x"]


@pattern("High speed preset mode", "section 5 b")
def high_speed_preset() -> Report:
    """R0 contains the number of pulses, R6 the ramp-down point. The chip starts at FL, ramps up to FH1, compares R0
    with R6 after each pulse, ramps down once R0 < R6, and stops at R0 = 0: five pulses, or a few more, after it has
    reached FL again.
    """
    return firmware.preset_move(axis(), 3000, P)


@pattern("Constant speed preset mode", "section 5 c")
def constant_speed_preset() -> Report:
    """Bit 2 of the start command is 0, so there are no ramps. From the first pulse on, the rate is that of the selected
    register; R6 has no effect.
    """
    return firmware.preset_move(axis(), 2000, P, high_speed=False)


@pattern("High speed continuous mode", "section 5 d")
def high_speed_continuous() -> Report:
    """The chip runs in manual mode (40h) until a stop command. 1Dh (from FH1; 1Fh from FH2) ramps down to FL and
    stops there. R0 counts down from its present value, and wraps.
    """
    return firmware.continuous_move(axis(), 0.4, +1, P)


@pattern("Constant speed continuous mode", "section 5 e")
def constant_speed_continuous() -> Report:
    """The chip runs in manual mode without ramps. The reset command 08h stops at once; the chip first
    completes a pulse in progress.
    """
    return firmware.continuous_move(axis(), 0.3, +1, P, high_speed=False)


@pattern("High speed origin return mode", "section 5 f")
def high_speed_origin_return() -> Report:
    """Control mode 4Bh is the origin return in minus direction with SD enabled. The SD switch lies before the
    origin: it slows the axis to FL, a rate from which the motor can stop at ORG without a ramp.
    """
    bench = Bench(PCL240K())
    bench.add_rail("x", at=4000, sd_minus=(None, 700), org=(None, 0))
    return firmware.origin_return(bench.axes["x"], -1, P, slow_approach=False)


@pattern("Constant speed origin return mode", "section 5 g")
def constant_speed_origin_return() -> Report:
    """Control mode 49h is the origin return in minus direction. The rate is constant FL, and ORG stops the axis."""
    bench = Bench(PCL240K())
    bench.add_rail("x", at=500, org=(None, 0))
    return firmware.origin_return(bench.axes["x"], -1, P, high_speed=False, slow_approach=False)


@pattern("Origin return with a slow approach", "section 5 f; as firmware uses it")
def origin_return_slow_approach() -> Report:
    """The default of `origin_return` has two phases. After the fast return, it leaves ORG at a very low rate (R1
    rewritten), goes 100 pulses further, and approaches again at that rate: the motor does not oscillate when the
    switch trips, and the position repeats within a pulse.
    """
    bench = Bench(PCL240K())
    bench.add_rail("x", at=4000, sd_minus=(None, 700), org=(None, 0))
    return firmware.origin_return(bench.axes["x"], -1, P, back_off=100)


@pattern("Speed change during operation", "section 5 h")
def speed_change() -> Report:
    """A start command during a run changes the rate: 15h, 17h and 14h ramp to FH1, FH2 and FL. The host can rewrite
    the register that is not selected during the run without effect and then select it, so any number of rates is
    possible.
    """
    return firmware.speed_change_move(axis(), 6000, [4000, 9000, 6000, 12_000, 3000], P, dwell=0.08)


@pattern("Dual rate mode (1), ramping up", "section 6")
def dual_rate_up() -> Report:
    """The move starts at constant FL (10h) and ramps up later. According to section 5 h, bit 2 must be set before the rate
    changes, hence 14h before 15h.
    """
    return firmware.dual_rate_move(axis(), 2500, P, rates=("FL", "FH1"), dwell=0.15)


@pattern("Dual rate mode (2), ramping down", "section 6")
def dual_rate_down() -> Report:
    """The move starts to FH1, ramps down to FL by 14h, and ends at FL: with R6 = 5, there is no second ramp-down."""
    return firmware.dual_rate_move(axis(), 2400, P, rates=("FH1", "FL"), dwell=0.15)


@pattern("Dual rate, up and down", "section 3 a, 6")
def dual_rate_up_and_down() -> Report:
    """One preset move uses FL, FH1, FH2 and FH1 again; the ramp-down point is that of FH1, the last rate."""
    return firmware.dual_rate_move(axis(), 6500, P, rates=("FL", "FH1", "FH2", "FH1"), dwell=0.1)


@pattern("Ramping up/down and interrupting mode", "section 6; section 4, R0")
def ramping_and_interrupting() -> Report:
    """3Dh is the decelerating stop with /INT at the stop. R0 contains the remaining pulses. The reset command clears /INT
    and enables the next start, which makes these pulses.
    """
    return firmware.interrupted_move(axis(), 4500, P, after=0.25, pause=0.15)


@pattern("Switchover of frequency register", "section 6")
def switchover() -> Report:
    """A continuous run alternates between FH1 and FH2, then 1Dh stops it."""
    return firmware.dual_rate_move(axis(), None, P, rates=("FH1", "FH2", "FH1"), dwell=0.1, seconds=0.1)


@pattern("Decelerating stop", "section 3 a")
def decelerating_stop() -> Report:
    """1Fh stops from FH2, here with /INT at the stop (bit 5: 37h, 3Fh)."""
    return firmware.continuous_move(axis(), 0.35, +1, P, fh2=True, interrupt=True)


@pattern("Immediate stop", "section 3 a; Q & A")
def immediate_stop() -> Report:
    """The reset command 08h stops a high-speed run without a ramp. A chip can stop within half a pulse; a motor may lose
    steps.
    """
    return firmware.continuous_move(axis(), 0.35, +1, P, immediate=True)


@pattern("Triangular drive", "Q & A")
def triangular() -> Report:
    """The move is too short to reach FH1: R6 = R0 R5 / (R4 + R5). `preset_move` adds 2: rounding down takes up to
    one pulse, and R0 < R6 is true one pulse after R0 = R6. With the printed formula the chip is still a little
    above FL when R0 reaches 0.
    """
    return firmware.preset_move(axis(), 500, P)


@pattern("Ramp-down point too late", "section 4, R6, Fig. A")
def down_point_too_late() -> Report:
    """R6 is smaller than the number of pulses of the ramp-down: the output ends in the middle of the ramp-down."""
    return firmware.preset_move(axis(), 3000, P, down_point=200)


@pattern("Ramp-down point too early", "section 4, R6, Fig. C")
def down_point_too_early() -> Report:
    """R6 is larger than the number of pulses of the ramp-down: the chip makes the remaining pulses at FL, which takes long."""
    return firmware.preset_move(axis(), 3000, P, down_point=700)


@pattern("Acceleration in pieces", "Q & A")
def curved_ramp() -> Report:
    """The chip ramps linearly. If a ramp is long compared with the host's bus cycles, the host can rewrite
    acceleration rate R4 and the speed register repeatedly: here five pieces approximate an S. The ramp down remains
    one line to FL.
    """
    pieces = [(2000, 0.12), (5000, 0.14), (11_000, 0.16), (14_000, 0.14), (15_000, 0.12)]
    return firmware.curved_ramp_move(axis(), 11_500, pieces, P)


@pattern("Speed changed several times while ramping up", "Q & A")
def steps_while_ramping_up() -> Report:
    """The other answer of the Q & A uses one acceleration rate, rewrites the speed register several times, and has a
    constant rate between the ramps.
    """
    return firmware.speed_change_move(axis(), 7000, [4000, 8000, 12_000, 16_000], P, dwell=0.05)


@pattern("Slow-down switch", "section 2, SD+ and SD-")
def slow_down() -> Report:
    """Control mode 42h enables SD. While the switch of the direction is asserted, the axis ramps down to FL and stays there;
    when the switch is released, it ramps up again.
    """
    bench = Bench(PCL240K())
    bench.add_rail("x", sd_plus=(2000, 2700))
    return firmware.continuous_move(bench.axes["x"], 0.9, +1, P, slow_down=True)


@pattern("End limit", "section 2, EL+ and EL-")
def end_limit() -> Report:
    """The EL switch of the direction stops the output at once, whatever the mode; while it is asserted, a start in that
    direction has no effect, and a start in the other direction works.
    """
    bench = Bench(PCL240K())
    bench.add_rail("x", el_plus=(2000, None))
    return firmware.preset_move(bench.axes["x"], 5000, P)


@pattern("Counting external pulses", "section 4, R0; output mode")
def external_counting() -> Report:
    """R0 counts the rising edges of EXTP in place of the output's pulses in output mode D0h. The axis runs at FL
    until 20 edges have arrived.
    """
    return firmware.external_count(axis(), 20, P, rate=100)


HEAD = """\
# Operation patterns

The figures of sections 5 and 6 of the PCL-240K data sheet are lost. On this page, the emulated chip draws them again: each
picture is a move that firmware made by bus cycles, replayed to the clock. `scripts/draw_patterns.py` makes this page and
its pictures from one list; a test compares the bytes below with those that the code writes now.

**How to read a picture.** A picture shows the pulse rate over time; dashed lines are the rates FL, FH1, FH2. Above them,
arrows mark the bytes that start, change or stop a run, and dots mark events in the chip: the ramp-down point R0 < R6, and
the reason of the stop. Below them are the pins, filled while asserted (FUP, FKEEP, FDOWN, HOLD high; SD, ORG, EL, EXTP and
INT low). FKEEP is also asserted at rest.

**How to read the bytes.** The first byte of a row goes to address 0; any others are the bytes of a register, for the
addresses 3, 2, 1, the last of them for address 1. Times are in ms from the first start.

**How to make these moves.** The code of every pattern continues this code. `axis()` is a new chip; use `machine.axes["x"]`
instead to move a carriage. `report.plot("move.png")` draws the move of `report = firmware.preset_move(...)`.

```python
from stage import firmware
from stage.chips import PCL240K
from stage.firmware import Bench, Profile

P = CALL


def axis():
    return Bench(PCL240K()).axes["x"]
```
"""

SPEED_DATA = """
## Setting speed data

*Section 5 a.* `P = {call}`: the reset command, then R1 to R5 and R7. All patterns on this page begin with it. `accel` is the
time from FL to the highest rate, here FH2, so that the ramp to FH1 takes about half of it.
The ramp from FL to FH1 takes Tsu = (R2 - R1) R4 / CLOCK = {accel:.1f} ms, and so does the ramp down.

{table}
"""


def rows(report: Report) -> list[tuple[str, str, str]]:
    return [(f"{t * 1e3:.3f}", code, meaning) for t, code, meaning in report.writes()]


def table(rows: list[tuple[str, str, str]]) -> str:
    lines = ["| ms | bytes, hex | meaning |", "|---:|---|---|"]
    return "\n".join(lines + [f"| {t} | {f'`{code}`' if code else ''} | {meaning} |" for t, code, meaning in rows])


def is_speed_data(row: tuple[str, str, str]) -> bool:
    name, _, value = row[2].partition(" <- ")
    return float(row[0]) <= 0 and name in P.registers() and int(value.split(" ")[0]) == P.registers()[name]


def section(p: Pattern, report: Report) -> str:
    """Return the section of the page about one pattern."""
    table_rows: list[tuple[str, str, str]] = []
    for row in rows(report):
        if not is_speed_data(row):
            table_rows.append(row)
        elif table_rows[-1][2] != "speed data, as above":
            table_rows.append((row[0], "", "speed data, as above"))
    return (
        f"\n## {p.title}\n\n*{p.source[0].upper()}{p.source[1:]}.* {p.text}\n\n![{p.title}](pictures/patterns/{p.name}.png)\n\n"
        f"```python\n{p.code}\n```\n\n{table(table_rows)}\n"
    )


def page(reports: dict[str, Report]) -> str:
    """Return the text of docs/patterns.md."""
    first = [r for r in rows(next(iter(reports.values()))) if is_speed_data(r) or r[1] == "08"]
    call = next(re.finditer(r"^P = (.*)$", Path(__file__).read_text(), re.M))[1]
    speed = SPEED_DATA.format(call=call, accel=P.get_accel_time() * 1e3, table=table(first))
    contents = "".join(f"- [{p.title}](#{anchor(p.title)})\n" for p in PATTERNS)
    return HEAD.replace("CALL", call) + "\n" + contents + speed + "".join(section(p, reports[p.name]) for p in PATTERNS)


def anchor(title: str) -> str:
    """Return GitHub's anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def draw(p: Pattern, report: Report) -> Path:
    path = DOCS / "pictures" / "patterns" / f"{p.name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    report.plot(path, p.title, overwrite=True)
    return path


def main(names: list[str]) -> None:
    known = {p.name: p for p in PATTERNS}
    for name in names:
        if name not in known:
            raise unknown_name_error("pattern", name, known)
    selected = [known[n] for n in names] or PATTERNS
    reports = {p.name: p.run() for p in selected}
    for p in selected:
        print(draw(p, reports[p.name]).relative_to(DOCS.parent))
    if not names:
        (DOCS / "patterns.md").write_text(page(reports))
        print("docs/patterns.md")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except StageError as error:
        sys.exit(f"draw_patterns: {error}")
