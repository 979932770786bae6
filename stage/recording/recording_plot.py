"""A recording as one figure: rates, positions, following errors and switches over time. Needs matplotlib (extra `plot`).

The figure uses a few thousand samples. The dashboard and the waveforms are exact to the clock.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.recording.axis_series import SERIES, list_axes_with_series, make_plot_title
from stage.recording.pin_signals import SWITCHES
from stage.support import plot_style
from stage.support.files import save_figure

if TYPE_CHECKING:
    from stage.recording.recording import Recording

PANELS = (("rate",), ("commanded", "position"), ("following_error",), ("lost_steps",))
MAX_POINTS = 4000  # of a curve
LANE_HEIGHT_IN = 0.17


def draw_recording(recording: Recording, path: str | os.PathLike | None = None, overwrite: bool = False) -> Any:
    """Draw rates, positions, following errors, lost steps and switches of a recording over time.

    Args:
        recording: The recording.
        path: File to save it to, or None.
        overwrite: The file may exist.

    Returns:
        The figure.
    """
    lanes = _list_lanes(recording)
    panels = [p for p in PANELS if p != ("lost_steps",) or _has_lost_steps(recording)]
    panels = [p for p in panels if list_axes_with_series(recording, p[0])]
    low = max(LANE_HEIGHT_IN * len(lanes), 0.01)
    fig = plot_style.make_figure(9.2, 1.4 * len(panels) + low + 0.9)
    axes = fig.subplots(len(panels) + 1, 1, sharex=True, squeeze=False, height_ratios=[*(1.4 for _ in panels), low])[
        :, 0
    ]
    every = max(1, -(-len(recording) // MAX_POINTS))
    time = recording.column("time")[::every]
    axes[0].set_xlim(recording.began, time[-1])
    for ax, keys in zip(axes, panels, strict=False):
        _draw_panel(ax, recording, keys, time, every)
    _draw_lanes(axes[-1], lanes, time, every)
    axes[-1].set_xlabel("time, s", color=plot_style.TEXT_COLOR, fontsize=8.5)
    fig.align_ylabels(axes[:-1])
    handles, labels = axes[0].get_legend_handles_labels()
    if len(labels) > 1:
        axes[0].legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0, 1), ncols=len(labels), frameon=False, fontsize=8
        )
    chips = ", ".join(dict.fromkeys(type(a.chip).__name__ for a in recording.axes.values()))
    plot_style.add_heading(fig, f"Recording of {', '.join(recording.axes)}", f"{chips}; {recording.duration:.3f} s")
    if path is not None:
        save_figure(fig, path, 150, overwrite)
    return fig


def _has_lost_steps(recording: Recording) -> bool:
    return any(recording.column(f"{name}/lost_steps").any() for name in list_axes_with_series(recording, "lost_steps"))


def _draw_panel(ax: Any, recording: Recording, keys: tuple[str, ...], time: np.ndarray, stride: int) -> None:
    """Draw the series `keys` of all axes into one panel, using every `stride`-th sample."""
    for k, (name, axis) in enumerate(recording.axes.items()):
        color = plot_style.COLORS[k % len(plot_style.COLORS)]
        for key in keys:
            if name in list_axes_with_series(recording, key):
                values = recording.column(f"{name}/{key}")[::stride] * SERIES[key].scales[axis.unit != "m"]
                is_command = key == "commanded"
                style = {"linewidth": 2.6, "alpha": 0.35} if is_command else {"linewidth": 1.1, "label": name}
                ax.plot(time, values, color=color, **style)
    title, _, unit = make_plot_title(recording, keys[-1]).rpartition(" (")
    ax.set_ylabel(f"{title.lower()}\n{unit.rstrip(')')}", color=plot_style.TEXT_COLOR, fontsize=8.5)
    ax.ticklabel_format(axis="y", style="plain", useOffset=False)
    ax.locator_params(axis="y", nbins=4)
    plot_style.remove_frame(ax)


def _list_lanes(recording: Recording) -> list[tuple[str, str, np.ndarray]]:
    """Return label, kind and states of each switch of each axis that was on at some time, from the top."""
    lanes = []
    for name, axis in recording.axes.items():
        for pin, (label, kind) in SWITCHES.items():
            if pin in axis.chip.INPUTS and (on := recording.column(f"{name}/{pin}")).any():
                lanes.append((f"{name} {label}", kind, on))
    return lanes


def _draw_lanes(ax: Any, lanes: list[tuple[str, str, np.ndarray]], time: np.ndarray, stride: int) -> None:
    """Draw one horizontal lane per switch, colored while the switch is on."""
    for k, (_, kind, on) in enumerate(reversed(lanes)):
        states = on[: len(time) * stride]
        states = np.maximum.reduceat(states, np.arange(0, len(states), stride))  # a short edge is not left out
        ax.axhline(k + 0.14, color=plot_style.FRAME_COLOR, linewidth=0.6, zorder=0)
        ax.fill_between(
            time, k + 0.14, k + 0.14 + 0.66 * states, step="post", color=plot_style.SWITCH_COLORS[kind], linewidth=0
        )
    ax.set_yticks([k + 0.45 for k in range(len(lanes))], [label for label, *_ in reversed(lanes)])
    ax.set_ylim(0, max(len(lanes), 1))
    plot_style.remove_frame(ax)
    ax.grid(False, axis="y")
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
