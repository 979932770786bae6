import ctypes.util
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
if sys.platform == "linux" and "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # frames without a screen; must be said before MuJoCo is imported
