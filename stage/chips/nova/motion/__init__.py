"""The drive of one axis of a NOVA chip, compiled: its profile, its pulses, their clocks."""
