"""Recordings of a run: NumPy columns, rerun, VCD. See recording.py for what is kept and how, rerun_viewer.py to look at one."""

from stage.recording.recording import COLUMNS, Recording, RecordingError, RecordingWarning
from stage.recording.saved_recording import Saved, read

__all__ = ["COLUMNS", "Recording", "RecordingError", "RecordingWarning", "Saved", "read"]
