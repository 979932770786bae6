"""Server of the Model Context Protocol (MCP) that offers the tools to clients: `stage mcp`. Needs the extra `agents`.

client_sessions.py holds a stage for each client session, mcp_handlers.py answers requests, http.py and stdio.py are the transports.
resources.py and prompts.py define what a client can read and send in addition to tool calls.
"""
