"""Accesses of x86-64 code to windows, made bus cycles: the table of instructions, one instruction, the handler of faults."""
