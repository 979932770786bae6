"""Broken set-ups for agents to find and mend: a machine with a fault, or a host's program with a bug.

    case = Case("supply")
    case.box.call("run")                                     the program, on the machine from power-up
    case.box.call("answer", {"cause": "supply too low"})
    case.box.call("service", {"work": "set the supply of the drives to what is on the nameplate"})
    case.score()                                             found, mended, and what it took

setups.py has the ten; program.py the language of the host's programs; machine.py what breaks and mends machines; trial.py what a
customer wants; case.py the tools and the score.
"""

from registerbench.diagnosis.case import Case, Score
from registerbench.diagnosis.machine import SERVICES
from registerbench.diagnosis.setups import CAUSES, SETUPS, Setup

__all__ = ["CAUSES", "SERVICES", "SETUPS", "Case", "Score", "Setup"]
