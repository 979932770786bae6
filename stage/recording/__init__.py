"""Recordings of a run as NumPy columns, rerun files and VCD waveforms.

recording.py explains what is recorded and how; rerun_viewer.py shows a recording.
"""

from stage.recording.recording import COLUMNS, Recording, RecordingError, RecordingWarning
from stage.recording.saved_recording import SavedRecording, read

__all__ = ["COLUMNS", "Recording", "RecordingError", "RecordingWarning", "SavedRecording", "read"]
