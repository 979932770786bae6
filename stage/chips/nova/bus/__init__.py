"""Bus cycles of the NOVA chips, compiled."""
