"""A stage behind a bus, for hosts elsewhere: bus cycles, time and pins over TCP. docs/serve.md has the frames.

client.py is a host's side, one file that needs Python only; server.py the stage's; machine.py what a frame does to it; frames.py
the table of frames.
"""
