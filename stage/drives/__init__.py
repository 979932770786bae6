"""Drives: from pulses to torque. They know neither chips nor MuJoCo."""
