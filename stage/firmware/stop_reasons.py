"""Stop reasons of `Report.stopped_by` that do not come from a chip."""

STOP_COMMAND = "stop command"
"""Stop reason of a move that the host has stopped before its end."""
ANOTHER_AXIS = "another axis"
"""Stop reason of an axis of a line that stopped because another axis of the line had stopped."""
UNKNOWN = "unknown"
"""Stop reason of a move that ended early if neither the chip nor its journal shows the cause."""
UNWANTED_REASONS = (
    "EL+", "EL-", "SLMT+", "SLMT-", "STOP0", "ALARM", "EMG", "HOME", "timeout", "Ctrl-C", UNKNOWN
)  # fmt: skip
"""Stop reasons that mean failure of a move. HOME: a home search failed; SLMT: a software limit."""
