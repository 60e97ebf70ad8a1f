"""Pictures without a window.

Which of OpenGL's platforms works is found by trying it: a DISPLAY that is set may name a screen
that is long gone (ssh -X, tmux, a container), and one that is not set says nothing about EGL.
"""

from __future__ import annotations

import importlib
import os
import platform

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError

Image = NDArray[np.uint8]
"""Shape (height, width, 3), RGB."""

MAX_SIZE = 8192
"""Widest and highest picture, pixels; common drivers draw no larger ones."""

_PLATFORMS = {"egl": "mujoco.egl", "glfw": "mujoco.glfw", "osmesa": "mujoco.osmesa"}
"""Value of MUJOCO_GL on Linux -> the module that has its GLContext."""

_works: str | None = None
"""The platform that drew last; a process cannot change over once one has."""


def make_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """MuJoCo's renderer, also where there is no display and MUJOCO_GL was not set.

    With MUJOCO_GL its platform is taken; without, on Linux, the first of EGL, which needs no
    screen, and GLFW that works.

    Args:
        model: Whose scenes are drawn; its off-screen buffer grows if it is too small.
        width: Of the image, pixels.
        height: Of the image, pixels.

    Raises:
        ConfigurationError: The size is not allowed, or no OpenGL works on this machine; the
            message says what was tried, and what each answered.
    """
    global _works
    if not (1 <= width <= MAX_SIZE and 1 <= height <= MAX_SIZE):
        raise ConfigurationError(
            f"image size is {width}x{height}; both must be in 1..{MAX_SIZE} pixels"
        )
    buffer = model.vis.global_
    buffer.offwidth = max(buffer.offwidth, width)
    buffer.offheight = max(buffer.offheight, height)
    failures = []
    for name in [_works] if _works is not None else _candidates():
        try:
            if name in _PLATFORMS:
                gl_context.GLContext = importlib.import_module(_PLATFORMS[name]).GLContext
            renderer = mujoco.Renderer(model, height, width)
        # Whatever a driver, a library or its binding may raise: then this platform does not work.
        except Exception as error:
            failures.append(f"{name}: {' '.join(str(error).split()) or type(error).__name__}")
        else:
            _works = name
            return renderer
    chosen = os.environ.get("MUJOCO_GL")
    advice = (
        f"MUJOCO_GL={chosen} asks for this one; unset it to have the others tried"
        if chosen
        else "install EGL (on Debian libegl1 and libgl1-mesa-dri), or OSMesa (libosmesa6) and set "
        "MUJOCO_GL=osmesa"
    )
    raise ConfigurationError(
        f"cannot draw: no OpenGL for off-screen pictures ({'; '.join(failures)}); {advice}"
    )


def _candidates() -> list[str]:
    """The platforms to try, best first; a name that is not ours leaves MuJoCo's own choice."""
    chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
    if platform.system() != "Linux":
        return [chosen or "MuJoCo's own"]
    if chosen in ("", "enable", "enabled", "on", "true", "1"):
        return ["egl", "glfw"]
    return ["glfw" if chosen == "glx" else chosen]
