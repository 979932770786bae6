"""Tools by which an agent drives a stage, and an MCP server that offers them.

    from stage import Stage
    from stage.agents import Budget, Toolbox

    box = Toolbox(Stage("xy"), mode="host", budget=Budget(moves=20))
    box.tools                                       names, descriptions, JSON schemas
    print(box.call("move", {"axis": "x", "distance": "10mm"}))

An agent is whoever makes calls: a language model, a script, a person. docs/agents.md is the page. Needs the extra `agents`.
"""

from stage.agents.budget import Budget
from stage.agents.bus_tools import MODES
from stage.agents.tool import Answer, Tool
from stage.agents.toolbox import Toolbox

__all__ = ["MODES", "Answer", "Budget", "Tool", "Toolbox"]
