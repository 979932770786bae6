"""Firmware of the NOVA chips: bus port, home search, path interpolation, and work-arounds for the S-curve failure."""
