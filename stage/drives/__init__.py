"""Drives: from pulses to torque. They depend neither on chips nor on MuJoCo."""
