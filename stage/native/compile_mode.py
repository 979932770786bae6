"""Mode in which this process runs hot functions: from the native library, as plain Python, or to compile them."""

import os

IS_EMITTER_PROCESS = os.environ.get("PULSESTAGE_EMIT") == "1"
"""Whether this process compiles hot functions, see object_emitter.py. Only the builder sets it, for its worker processes."""
COMPILED = IS_EMITTER_PROCESS or os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
"""Whether hot functions come from the native library; otherwise they run as plain Python. The switch is that of numba."""
