"""PulseStage."""
