"""The switches that an axis of a stage may have."""

PINS = ("el_plus", "el_minus", "sd_plus", "sd_minus", "org")
"""By the names of the pins that they are meant for, see docs/models.md."""
