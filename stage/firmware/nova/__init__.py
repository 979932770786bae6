"""Firmware of the NOVA chips: their port, home search, interpolation, the work-arounds of the S-curve failure."""
