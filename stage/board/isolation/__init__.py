"""Firmware in a process of its own, so that its crash is an error and a loop without end can be ended.

`process_runner` is the board's side, `starter` begins the process, `child` is what it runs, `shared_memory` is what both see.
`traps` changes the child, and nothing but the child, so that crashes, sleeps and memory-mapped accesses of firmware are noticed.
"""
