"""Server of a stage for hosts on other machines: bus cycles, time and pins over TCP. docs/serve.md describes the frames.

client.py is the host's side, one file that needs only Python. server.py is the side of the stage, and frame_execution.py executes
the frames. frame_table.py has their table for documentation.
"""
