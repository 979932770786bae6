"""Server of the Model Context Protocol that offers the tools to clients: `stage mcp`. Needs the extra `agents`.

client_sessions.py keeps a stage for each session, mcp_handlers.py answers requests, and http.py and stdio.py are the transports.
resources.py and prompts.py have what a client can read and send in addition to calls of tools.
"""
