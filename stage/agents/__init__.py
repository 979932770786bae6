"""Tools by which an agent drives a stage, and what is built on them: an MCP server, broken set-ups, a loop that measures agents.

    from stage import Stage
    from stage.agents import Budget, Toolbox

    box = Toolbox(Stage("xy"), mode="host", budget=Budget(moves=20))
    box.tools                                       names, descriptions, JSON schemas
    print(box.call("move", {"axis": "x", "distance": "10mm"}))

An agent is whoever makes calls: a language model, a script, a person. docs/agents.md is the page.
"""

from stage.agents.budget import Budget
from stage.agents.tool import Answer, Tool
from stage.agents.toolbox import MODES, Toolbox

__all__ = ["MODES", "Answer", "Budget", "Tool", "Toolbox"]
