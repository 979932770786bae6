"""Drives: the simulated power stages and motors of axes, from pulses to torque. They depend neither on chips nor on MuJoCo."""
