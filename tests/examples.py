"""How many random examples a test takes, by the environment.

PULSESTAGE_EXAMPLES scales all of them: the everyday suite is content with a few, since each run draws others; `make test-slow`
takes ten times as many. PULSESTAGE_SEED repeats a run of the tests that draw for themselves; Hypothesis prints its own way.
"""

import os
import random

EXAMPLES = int(os.environ.get("PULSESTAGE_EXAMPLES", "100"))
SEED = int(os.environ.get("PULSESTAGE_SEED", random.SystemRandom().getrandbits(32)))
