"""Firmware in a separate process, so that its crash becomes an error and an endless loop can be ended.

`process_runner` is the board's side, `process_starter` starts the process, `firmware_process` is its main program, and both sides
use `shared_memory`. `traps` changes only the separate process, so that crashes, sleeps and memory-mapped accesses of firmware are
noticed.
"""
