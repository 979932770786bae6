"""Mode in which this process runs hot functions: from the native library, as plain Python, or to compile them."""

import os

EMITTING = os.environ.get("PULSESTAGE_EMIT") == "1"
"""This process compiles them, see object_emitter.py: the builder sets it for its helpers, nobody else."""
COMPILED = EMITTING or os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
"""They come from the native library; otherwise they run as plain Python. (numba's own switch, so that one is enough.)"""
