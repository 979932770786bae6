"""Stop reasons that reports give beside those of the chips: `Report.stopped_by`."""

STOP_COMMAND = "stop command"
"""What a report says has ended a move that a host has stopped before its end."""
ANOTHER_AXIS = "another axis"
"""What a report says has ended an axis of a line that stopped because another axis of it did."""
UNKNOWN = "unknown"
"""What a report says has ended a run that stopped early, where neither the chip nor its journal shows a reason."""
UNWANTED_REASONS = (
    "EL+", "EL-", "SLMT+", "SLMT-", "STOP0", "ALARM", "EMG", "HOME", "timeout", "Ctrl-C", UNKNOWN
)  # fmt: skip
"""Ends that nobody asks for. HOME: a home search failed; SLMT: a software limit."""
