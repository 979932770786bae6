"""Firmware of the PCL-240 family: bus port, moves, origin return, rate changes, and lines in the ratio a:b."""
