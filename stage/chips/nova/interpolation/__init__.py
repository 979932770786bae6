"""Interpolation by the NOVA chips, compiled: lines, circles, helices, bit patterns, and the queue of segments."""
