"""Broken set-ups that agents diagnose and repair: a machine with a fault, or a host's program with a bug.

    case = Case("supply")
    case.box.call("run")                                     runs the program on the machine from power-up
    case.box.call("answer", {"cause": "supply too low"})
    case.box.call("service", {"work": "set the supply of the drives to what is on the nameplate"})
    case.compute_score()                                     whether it is found and repaired, and at which cost

broken_setups.py has ten named set-ups, setup_generation.py draws those of the suite from seeds, host_program.py has the language of
the host's programs, machine_faults.py what breaks and repairs machines, acceptance_trial.py what a customer requires, and
diagnosis_case.py the tools and the score.
"""

from registerbench.diagnosis.broken_setups import CAUSES, NO_FAULT, SETUPS, Setup
from registerbench.diagnosis.diagnosis_case import Case, Score
from registerbench.diagnosis.machine_faults import SERVICES
from registerbench.diagnosis.setup_generation import generate_setup

__all__ = ["CAUSES", "NO_FAULT", "SERVICES", "SETUPS", "Case", "Score", "Setup", "generate_setup"]
