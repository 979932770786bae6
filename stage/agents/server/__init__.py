"""The tools behind the Model Context Protocol, for any client that speaks it: `stage mcp`. Needs the extra `agents`.

sessions.py has the stages, one a session; protocol.py the requests; http.py and stdio.py the two transports; resources.py and
prompts.py what a client finds beside the tools.
"""
