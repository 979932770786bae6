"""Plot of a pull-out curve. It needs matplotlib (extra `plot`), which is imported when a plot is drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from stage.drives.dynamometer import PullOutCurve, compute_closed_form_torque, compute_torque_bound, simulate_pull_out
from stage.drives.motor_tolerances import vary_motor
from stage.drives.motors import Drive, Motor, estimate_core_loss
from stage.drives.published_pull_out_curves import PUBLISHED_CURVES, PublishedCurve
from stage.support.files import save_figure
from stage.support.plot_style import COLORS, MUTED_COLOR, TEXT_COLOR, make_figure, remove_frame

ACCENT, BAND = COLORS[0], "#cfe0f2"


def _decorate_axes(ax: Any, drive: Drive, rpm_max: float, torque_max: float) -> None:
    """Set limits, labels and grid of a plot, and show the pulse rate below the speed."""
    ax.set_xlim(0, rpm_max)
    ax.set_ylim(0, torque_max)
    ax.set_xlabel("speed (rpm)", color=TEXT_COLOR)
    ax.set_ylabel("pull-out torque (N m)", color=TEXT_COLOR)
    per_rpm = drive.pulses_per_turn / 60 / 1e3
    below: Any = ax.secondary_xaxis(-0.16, functions=(lambda rpm: rpm * per_rpm, lambda kpps: kpps / per_rpm))
    below.set_xlabel(f"pulse rate at 1/{drive.microsteps} microsteps (kpps)", color=MUTED_COLOR, fontsize=9)
    below.tick_params(colors=MUTED_COLOR, labelsize=8)
    below.spines["bottom"].set_color(MUTED_COLOR)
    remove_frame(ax, size=9)


def _compute_closed_forms(drive: Drive, rpm_max: float) -> tuple[Any, Any, Any, Any]:
    """Compute the theoretical curves on a fine grid of speeds.

    Returns:
        Speeds, rpm; closed forms at V and at 4/pi V; and the bound by both limits at once, N m.
    """
    rpm, (m, v, i) = np.linspace(0, rpm_max, 601), (drive.motor, drive.bus_voltage, drive.amplitude)
    return (
        rpm,
        compute_closed_form_torque(m, v, i, rpm),
        compute_closed_form_torque(m, 4 / np.pi * v, i, rpm),
        compute_torque_bound(m, v, i, rpm),
    )


def plot_pull_out(drive: Drive, table: PullOutCurve, path: str | None = None, overwrite: bool = False) -> Any:
    """Plot the simulated pull-out torque of one motor over speed, together with the closed forms.

    If the motor has a published curve, the plot shows that curve and the simulation with the curve's settings. Otherwise it shows
    the band of the motor's likely core loss.

    Args:
        drive: Drive with its motor.
        table: Curves of `tabulate_pull_out`.
        path: File to save the figure in, if any.
        overwrite: Whether a file that exists is replaced.

    Returns:
        The figure.

    Raises:
        FileError: The file exists, unless `overwrite`.
    """
    fig = make_figure(9, 5.2)
    ax = fig.subplots()
    rpm, at_v, saturated, both = _compute_closed_forms(drive, table.rpm.max())
    ax.fill_between(rpm, at_v, saturated, color=BAND, linewidth=0, label="closed form, from V to 4/π V")
    ax.plot(rpm, at_v, color=MUTED_COLOR, linewidth=1.2, label="closed form at V: min($T_V$, $T_I$)")
    ax.plot(rpm, both, color=MUTED_COLOR, linewidth=1.2, linestyle=(0, (1, 1.5)), label="sine bound by V and I at once")
    ax.plot(
        table.rpm, table.sine, "o", color=TEXT_COLOR, markersize=3.4, clip_on=False, label="ideal sine drive, simulated"
    )
    ax.plot(table.rpm, table.chopper, color=ACCENT, linewidth=2.2, label="chopper drive, simulated")
    if drive.motor.name in PUBLISHED_CURVES:
        _draw_published_curve(ax, PUBLISHED_CURVES[drive.motor.name], drive.motor)
    else:
        _draw_likely_core_loss_band(ax, drive, table.rpm)
    _decorate_axes(ax, drive, table.rpm.max(), 1.2 * max(table.chopper.max(), table.ideal_saturated.max()))
    ax.set_title(f"{drive.motor.name}: pull-out torque", loc="left", color=TEXT_COLOR, fontsize=12, weight="bold")
    ax.set_title(f"{drive.bus_voltage:g} V, {drive.amplitude:g} A", loc="right", color=MUTED_COLOR, fontsize=9)
    handles, labels = ax.get_legend_handles_labels()
    places = (4, 3, *range(5, len(handles)), 1, 2, 0)
    order = [handles[k] for k in places], [labels[k] for k in places]
    ax.legend(*order, frameon=False, fontsize=9, loc="upper right")
    if path is not None:
        save_figure(fig, path, 150, overwrite)
    return fig


def _draw_published_curve(ax: Any, curve: PublishedCurve, motor: Motor) -> None:
    """Draw a published curve, and the simulated torque of the motor with the settings of that curve."""
    comparison, settings = curve.compare(motor), f"{curve.bus_voltage:g} V, {curve.current:g} A"
    ax.plot(comparison.rpm, comparison.published, "D", color=COLORS[1], markersize=5, label=f"published, {settings}")
    ax.plot(
        comparison.rpm,
        comparison.simulated,
        "--",
        color=COLORS[1],
        linewidth=1.6,
        label=f"chopper drive, simulated, {settings}",
    )


def _draw_likely_core_loss_band(ax: Any, drive: Drive, rpm: np.ndarray) -> None:
    """Draw the band of torque between the smallest and the largest core loss that a motor without a published curve is likely to
    have."""
    likely = estimate_core_loss(drive.motor)
    high, low = (
        simulate_pull_out(replace(drive, motor=vary_motor(drive.motor, core_loss_damping=loss)), rpm)
        for loss in (likely.low, likely.high)
    )
    label = f"likely: core loss {likely.low:.2g} to {likely.high:.2g} N m s/rad"
    ax.fill_between(rpm, low, high, color=COLORS[1], alpha=0.25, linewidth=0, label=label)
