"""The dashboard of a recording inside a notebook, by rerun's widget: pip install 'pulsestage[notebook]'."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stage.support.extras import has

if TYPE_CHECKING:
    from stage.recording.recording import Recording

MOST = 300_000  # samples that are sent to a browser: 5 minutes at a millisecond
SIZE = 960, 620  # pixels


def widget_of(recording: Recording) -> dict[str, Any]:
    """What Jupyter shows of a recording as a widget; nothing without rerun's, or where it would be too much for a browser."""
    if not (has("rerun") and has("rerun_notebook")) or not 0 < len(recording) <= MOST:
        return {}
    import rerun_notebook

    with tempfile.TemporaryDirectory(prefix="pulsestage-") as folder:
        data = recording.save(Path(folder) / "recording.rrd").read_bytes()
    viewer = rerun_notebook.Viewer(width=SIZE[0], height=SIZE[1])
    viewer.send_rrd(data)
    bundle: dict[str, Any]
    bundle, _ = viewer._repr_mimebundle_()
    return {kind: what for kind, what in bundle.items() if kind.startswith("application/")}
