"""Firmware of the HCTL-1100: its port, moves, home, the servo loop as a model, motion sample by sample."""
