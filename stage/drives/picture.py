"""The pull-out curve as a picture. Needs matplotlib (extra `plot`)."""

from __future__ import annotations

from typing import Any

from stage.drives.dynamometer import PullOut
from stage.drives.motors import Drive
from stage.errors import StageError

INK, MUTED, ACCENT, BAND = "#1d2733", "#8a94a0", "#1f5f9e", "#cfe0f2"


def plot_pull_out(drive: Drive, table: PullOut, path: str | None = None) -> Any:
    """Draw measured torque and closed forms over speed; saves to `path` if given. Returns the figure."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise StageError("drawing needs matplotlib: pip install 'pulsestage[plot]'.") from error

    figure = Figure(figsize=(9, 4.8), layout="constrained")
    ax = figure.subplots()
    ax.fill_between(
        table.rpm, table.ideal, table.ideal_saturated, color=BAND, linewidth=0, label="closed form, V to 4/π V"
    )
    ax.plot(
        table.rpm, table.ideal, color=MUTED, linewidth=1.2, linestyle=(0, (4, 3)), label="closed form min($T_V$, $T_I$)"
    )
    ax.plot(table.rpm, table.sine, "o", color=INK, markersize=3.2, label="ideal sine drive, measured")
    ax.plot(table.rpm, table.chopper, color=ACCENT, linewidth=2, label="chopper drive, measured")
    ax.set_xlim(0, table.rpm.max())
    ax.set_ylim(0, 1.22 * max(table.chopper.max(), table.ideal_saturated.max()))
    ax.set_xlabel("speed (rpm)", color=INK)
    ax.set_ylabel("pull-out torque (N m)", color=INK)
    m = drive.motor
    current = drive.current or m.rated_current
    ax.set_title(f"{m.name}: pull-out torque", loc="left", color=INK, fontsize=12, weight="bold")
    ax.set_title(
        f"{drive.bus_voltage:g} V, {current:g} A, 1/{drive.microsteps} microsteps", loc="right", color=MUTED, fontsize=9
    )
    per_rpm = drive.pulses_per_turn / 60
    kpps: Any = (lambda v: v * per_rpm / 1e3, lambda v: v * 1e3 / per_rpm)
    top = ax.secondary_xaxis(-0.17, functions=kpps)
    top.set_xlabel("pulse rate (kpps)", color=MUTED, fontsize=9)
    top.tick_params(colors=MUTED, labelsize=8)
    top.spines["bottom"].set_color(MUTED)
    ax.grid(True, color="#e7ebef", linewidth=0.7)
    ax.legend(frameon=False, fontsize=9, loc="upper right")
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.tick_params(colors=INK, labelsize=9)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure
