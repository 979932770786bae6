"""Firmware of the PCL-240 family: its port, moves, origin return, rates, lines in the ratio a:b."""
