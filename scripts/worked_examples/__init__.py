"""Worked examples of the data sheets, computed by the emulated chips."""
