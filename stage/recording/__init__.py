"""Recordings of a run: NumPy columns, rerun, VCD. See recording.py for what is kept and how."""

from stage.recording.recording import Recording

__all__ = ["Recording"]
