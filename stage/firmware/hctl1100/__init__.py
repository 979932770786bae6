"""Firmware of the HCTL-1100: bus port, moves, homing, a model of the servo loop, and positions streamed sample by sample."""
