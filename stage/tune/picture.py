"""The picture of a result: rate, position and following error over time, of the formula's move and of the search's."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.sim.fleet import Fleet
from stage.sim.program import Program
from stage.support.files import save_figure
from stage.support.pictures import COLOURS, MUTED, bare, figure, heading
from stage.tune.looks import LOOK, Looks
from stage.tune.plans import Plan
from stage.tune.task import Case
from stage.units import PLACES, SMALL

if TYPE_CHECKING:
    from stage.tune.result import Result

SHADES = {"formula": MUTED, "search": COLOURS[0]}
BAND = "#dbe8f5"


def draw(result: Result, path: str | PathLike, overwrite: bool = False) -> None:
    """Write the picture. Raises FileError; ExtraMissing without matplotlib."""
    task = result.task
    axis: Any = task.stage.axes[task.axis]
    unit, tiny = PLACES[axis.unit], SMALL[axis.unit]
    fig = figure(9, 8.4)
    panels: Any = fig.subplots(4, 1, sharex=True)
    end = 1.15 * max(a.proof.worst for a in result.answers) + 0.01
    for a in result.answers:
        t, rate, position, behind, u, off = _measured(result, a.plan, end)
        colour = SHADES[a.name]
        label = f"{a.name}: arrives after {a.proof.mean * 1e3:.0f} ms (mean), {a.proof.worst * 1e3:.0f} ms (worst)"
        panels[0].plot(t * 1e3, rate * 1e-3, color=colour, lw=1.4, label=label, drawstyle="steps-post")
        panels[1].plot(t * 1e3, position * unit.per, color=colour, lw=1.4)
        panels[2].plot(t * 1e3, behind * tiny.per, color=colour, lw=1.0)
        panels[3].plot(u * 1e3, off * tiny.per, color=colour, lw=1.2)
        for panel in panels:
            panel.axvline(a.proof.mean * 1e3, color=colour, lw=0.8, ls=(0, (5, 4)))
    near = float(task.within or 0.0) * tiny.per
    panels[3].axhspan(-near, near, color=BAND, zorder=0, label="arrived")
    panels[3].set_ylim(-4 * near, 4 * near)
    panels[0].set(ylabel="rate, 1000 counts/s" if task.is_servo else "pulse rate, kpps")
    panels[1].set(ylabel=f"position, {unit.symbol}")
    panels[2].set(ylabel=f"commanded - position, {tiny.symbol}")
    panels[3].set(
        ylabel=f"{task.judge_at or 'position'} - goal, {tiny.symbol}", xlabel="time from the start command, ms"
    )
    panels[0].legend(frameon=False, fontsize=9, loc="upper left")
    panels[3].legend(frameon=False, fontsize=9, loc="upper left")
    panels[0].set_ylim(top=1.3 * panels[0].get_ylim()[1])
    for panel in panels:
        bare(panel)
    heading(fig, f"Axis {task.axis}, {axis.chip.MAP.chip}: {result.way()} {task.carries}")
    save_figure(fig, path, 130, overwrite)


def _measured(result: Result, plan: Plan, seconds: float) -> tuple[np.ndarray, ...]:
    """Seconds, rate (pps), position and following error (m) of one move with the payload; seconds and m beyond the goal, of
    what is judged."""
    task = result.task
    stage, looks = task.copy(), Looks(task)
    goal = looks.begin(stage, Case(task.payload, 0.0, task.way))
    start = stage.axes[task.axis].position
    before = Program()
    result.plans.write(before, plan, task.signed)
    fleet = Fleet([stage], 1)
    with stage.record(every=LOOK / 2) as recording:
        fleet.play([before])
        began = stage.time
        seen = fleet.play(looks.ops(round(seconds / LOOK))[None]).results
    fleet.close()
    t = recording.column("time") - began
    shown = t >= -5e-3
    rate, place, commanded = (
        recording.column(f"{task.axis}/{name}")[shown] for name in ("rate", "position", "commanded")
    )
    sign = np.sign(stage.axes[task.axis].gear)
    beyond = looks.errors(seen, goal[None])[1][0]
    u = LOOK * np.arange(1, len(beyond) + 1)
    return t[shown], np.abs(rate), sign * (place - start), sign * (commanded - place), u, beyond
