"""Slow reference of the TMC2209's UART and registers, written from the data sheet and not from the package."""
