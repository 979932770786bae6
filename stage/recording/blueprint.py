"""The dashboard that a recording opens as: the stage, its signals, and what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from stage.recording.recording import Recording


def dashboard(recording: Recording, ranges: dict[str, tuple[float, float]]) -> Any:
    """A rerun blueprint: 3D above state lanes on the left, series on the right, bus log in a tab."""
    import rerun.blueprint as rrb

    centre, extent = np.array(recording.model.stat.center), float(recording.model.stat.extent)
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=centre + extent * np.array([0.62, -0.84, 0.52]),
        look_target=centre,
        eye_up=(0, 0, 1),
    )
    view = rrb.Spatial3DView(
        origin="/stage",
        name="Stage",
        background=rrb.Background(color=(36, 40, 48)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=eye,
    )

    def series(name: str, *origins: str) -> Any:
        return rrb.TimeSeriesView(
            name=name, origin="/", contents=[f"+ /{o}/**" for o in origins],
            axis_y=rrb.ScalarAxis(range=ranges[origins[0]]),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=True),
        )  # fmt: skip

    lanes = rrb.StateTimelineView(origin="/signals", name="Switches and chip phases")
    bus = rrb.TextLogView(origin="/bus", name="Bus")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(view, rrb.Tabs(lanes, bus), row_shares=[3, 2]),
            rrb.Vertical(
                series("Pulse rate (pps)", "rate"),
                series("Position, true and commanded (mm)", "position", "commanded"),
                series("Following error (um)", "error"),
                rrb.Tabs(
                    series("Load angle (electrical degrees)", "load_angle"),
                    series("Lost steps", "lost_steps"),
                    series("Counter R0", "counter"),
                ),
            ),
            column_shares=[5, 4],
        ),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
    )
