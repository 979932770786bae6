"""Plot of a result: rate, position and errors over time, for the moves of the formula and of the search."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.sim.fleet import Fleet
from stage.sim.program import Program
from stage.support.files import save_figure
from stage.support.plot_style import COLORS, MUTED_COLOR, add_heading, make_figure, remove_frame
from stage.tune.position_sampler import SAMPLE_INTERVAL_S, PositionSampler
from stage.tune.register_planners import MovePlan
from stage.tune.task import MoveCase
from stage.units import DEVIATION_UNITS, POSITION_UNITS

if TYPE_CHECKING:
    from stage.tune.result import TuningResult

CURVE_COLORS = {"formula": MUTED_COLOR, "search": COLORS[0]}
TOLERANCE_COLOR = "#dbe8f5"


def plot_result(result: TuningResult, path: str | PathLike, overwrite: bool = False) -> None:
    """Plot one move of each answer and save the figure.

    Args:
        result: Result to plot.
        path: File to write.
        overwrite: Replace an existing file.

    Raises:
        FileError: The file cannot be written.
        ExtraMissing: Matplotlib is not installed.
    """
    task = result.task
    axis: Any = task.stage.axes[task.axis]
    unit, small_unit = POSITION_UNITS[axis.unit], DEVIATION_UNITS[axis.unit]
    fig = make_figure(9, 8.4)
    panels: Any = fig.subplots(4, 1, sharex=True)
    duration = 1.15 * max(answer.proof.max_time for answer in result.answers) + 0.01
    for answer in result.answers:
        t, rate, position, following_error, sample_t, goal_error = _record_move(result, answer.plan, duration)
        colour = CURVE_COLORS[answer.name]
        mean_ms, max_ms = answer.proof.mean_time * 1e3, answer.proof.max_time * 1e3
        label = f"{answer.name}: arrives after {mean_ms:.0f} ms (mean), {max_ms:.0f} ms (worst)"
        panels[0].plot(t * 1e3, rate * 1e-3, color=colour, lw=1.4, label=label, drawstyle="steps-post")
        panels[1].plot(t * 1e3, position * unit.factor, color=colour, lw=1.4)
        panels[2].plot(t * 1e3, following_error * small_unit.factor, color=colour, lw=1.0)
        panels[3].plot(sample_t * 1e3, goal_error * small_unit.factor, color=colour, lw=1.2)
        for panel in panels:
            panel.axvline(mean_ms, color=colour, lw=0.8, ls=(0, (5, 4)))
    tolerance = float(task.tolerance or 0.0) * small_unit.factor
    panels[3].axhspan(-tolerance, tolerance, color=TOLERANCE_COLOR, zorder=0, label="arrived")
    panels[3].set_ylim(-4 * tolerance, 4 * tolerance)
    panels[0].set(ylabel="rate, 1000 counts/s" if task.is_servo else "pulse rate, kpps")
    panels[1].set(ylabel=f"position, {unit.symbol}")
    panels[2].set(ylabel=f"commanded - position, {small_unit.symbol}")
    panels[3].set(
        ylabel=f"{task.judge_at or 'position'} - goal, {small_unit.symbol}", xlabel="time from the start command, ms"
    )
    panels[0].legend(frameon=False, fontsize=9, loc="upper left")
    panels[3].legend(frameon=False, fontsize=9, loc="upper left")
    panels[0].set_ylim(top=1.3 * panels[0].get_ylim()[1])
    for panel in panels:
        remove_frame(panel)
    add_heading(fig, f"Axis {task.axis}, {axis.chip.MAP.chip}: {result.describe_distance()} {task.payload_text}")
    save_figure(fig, path, 130, overwrite)


def _record_move(result: TuningResult, plan: MovePlan, duration: float) -> tuple[np.ndarray, ...]:
    """Record one move with the full payload.

    Args:
        result: Result with the task.
        plan: Plan of the move.
        duration: Recorded time after the start command, s.

    Returns:
        Time (s), rate (pps), position (m) and following error (m) of the axis; sample time (s) and overshoot (m) of the judged
        position.
    """
    task = result.task
    stage, sampler = task.copy_stage(), PositionSampler(task)
    goal = sampler.place_at_start(stage, MoveCase(task.payload, 0.0, task.direction))
    start_position = stage.axes[task.axis].position
    program = Program()
    result.planner.write_move(program, plan, task.signed_pulses)
    fleet = Fleet([stage], 1)
    with stage.record(every=SAMPLE_INTERVAL_S / 2) as recording:
        fleet.play([program])
        start_time = stage.time
        results = fleet.play(sampler.build_ops(round(duration / SAMPLE_INTERVAL_S))[None]).results
    fleet.close()
    t = recording.column("time") - start_time
    visible = t >= -5e-3
    rate, position, commanded = (
        recording.column(f"{task.axis}/{name}")[visible] for name in ("rate", "position", "commanded")
    )
    sign = np.sign(stage.axes[task.axis].gear)
    overshoot = sampler.compute_errors(results, goal[None])[1][0]
    sample_t = SAMPLE_INTERVAL_S * np.arange(1, len(overshoot) + 1)
    return (
        t[visible],
        np.abs(rate),
        sign * (position - start_position),
        sign * (commanded - position),
        sample_t,
        overshoot,
    )
