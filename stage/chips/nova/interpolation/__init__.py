"""Interpolation by the NOVA chips, compiled: lines, circles, helices, bit patterns, and the queue of segments.

An interpolation makes *ticks*: in each tick every axis makes one pulse or none. A segment is one line, arc, helix or bit pattern.
"""
