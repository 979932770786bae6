"""Choice of the OpenGL backend for MuJoCo's renderers and windows, with an error that names what is missing.

Without MUJOCO_GL, MuJoCo chooses GLFW, which needs a screen. Without a screen, MuJoCo's viewer ends the process, and so does a
renderer that is created after another one has failed. So this module uses EGL on machines without a screen, tests GLFW before
MuJoCo uses it, and does not try a library again that has failed once.
"""

from __future__ import annotations

import atexit
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from stage.errors import StageError

if TYPE_CHECKING:
    import mujoco

_failures: list[str] = []  # why this process cannot render
_open_renderers: WeakSet = WeakSet()  # renderers


def has_screen() -> bool:
    """Check whether this machine has a screen on which a window can open."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_window(alternative: str) -> None:
    """Raise StageError if MuJoCo's viewer cannot open a window. The error ends with `alternative`, a sentence that says what to do
    instead.
    """
    if not has_screen():
        raise StageError(f"there is no screen here for MuJoCo's viewer. {alternative}")
    if why := _find_glfw_failure():
        raise StageError(f"MuJoCo's viewer cannot open a window here: {why}. {alternative}")


def make_renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """Make MuJoCo's renderer for pictures of `width` x `height` pixels. Without a screen, use EGL unless MUJOCO_GL is set.

    Raises:
        StageError: There is no OpenGL, or the picture is larger than the model's offscreen buffer.
    """
    import mujoco

    buffer = model.vis.global_
    if width > buffer.offwidth or height > buffer.offheight:
        raise StageError(
            f"a picture of {width} x {height} pixels is larger than the model's offscreen buffer of {buffer.offwidth} x "
            f'{buffer.offheight}: <visual><global offwidth="{width}" offheight="{height}"/></visual>.'
        )
    if not _failures:
        try:
            with _choose_context(mujoco.Renderer):
                new_renderer = mujoco.Renderer(model, height, width)
            if not _open_renderers:
                atexit.register(_close_renderers)  # after MuJoCo's own, hence before it: EGL's display goes last
            _open_renderers.add(new_renderer)
            return new_renderer
        except Exception as error:  # PyOpenGL and MuJoCo have no common one
            _failures.append(f"{type(error).__name__}: {error}")
    raise StageError(
        f"no OpenGL to render with ({_failures[0]}). Without a screen it takes EGL (Debian: libegl1), with MUJOCO_GL=osmesa, "
        "said before Python starts, OSMesa (Debian: libosmesa6); recordings need neither."
    )


def _close_renderers() -> None:
    for new_renderer in list(_open_renderers):
        new_renderer.close()


@contextmanager
def _choose_context(cls: type) -> Iterator[None]:
    """Within this block, let MuJoCo's renderer create its context by EGL if there is no screen and MUJOCO_GL is not set.

    Raises:
        RuntimeError: The renderer would use GLFW, which does not work here.
    """
    setting = os.environ.get("MUJOCO_GL", "").lower().strip()
    module: Any = getattr(sys.modules[cls.__module__], "gl_context", None)
    if sys.platform == "linux" and not setting and not has_screen() and module is not None:
        from mujoco.egl import GLContext

        usual, module.GLContext = module.GLContext, GLContext
        try:
            yield
        finally:
            module.GLContext = usual
        return
    if sys.platform == "linux" and setting not in ("egl", "osmesa") and (why := _find_glfw_failure()):
        raise RuntimeError(why)
    yield


def _find_glfw_failure() -> str:
    """Return the reason why GLFW does not work here; "" if it works."""
    try:
        import glfw

        with warnings.catch_warnings(record=True) as messages:
            warnings.simplefilter("always")
            works = glfw.init()
    except Exception as error:  # the library itself may be missing
        return f"{type(error).__name__}: {error}"
    return "" if works else "; ".join(str(w.message) for w in messages) or "GLFW does not start"
