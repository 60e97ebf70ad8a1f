"""Pictures without a window."""

from __future__ import annotations

import os
import platform

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError

Image = NDArray[np.uint8]
"""Shape (height, width, 3), RGB."""


def make_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """MuJoCo's renderer, also where there is no display and MUJOCO_GL was not set.

    MuJoCo chooses its OpenGL platform when it is first imported, and without MUJOCO_GL it takes
    the one that needs a window system. Choosing again here makes pictures on servers need no
    environment variable.

    Args:
        model: Whose scenes are drawn; its off-screen buffer grows if it is too small.
        width: Of the image, pixels.
        height: Of the image, pixels.

    Raises:
        ConfigurationError: The size is not positive, or no OpenGL works on this machine.
    """
    if width < 1 or height < 1:
        raise ConfigurationError(f"image size is {width}x{height}; both must be at least 1 pixel")
    _choose_platform()
    buffer = model.vis.global_
    buffer.offwidth = max(buffer.offwidth, width)
    buffer.offheight = max(buffer.offheight, height)
    try:
        return mujoco.Renderer(model, height, width)
    except (mujoco.FatalError, ImportError, RuntimeError, AttributeError) as error:
        raise ConfigurationError(
            f"cannot draw: no OpenGL for off-screen pictures ({error}); install EGL (on Debian "
            "libegl1 and libgl1-mesa-dri) or set MUJOCO_GL to egl, osmesa or glfw"
        ) from error


def _choose_platform() -> None:
    headless = not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if platform.system() != "Linux" or os.environ.get("MUJOCO_GL") or not headless:
        return
    try:
        from mujoco.egl import GLContext
    except (ImportError, AttributeError):  # no EGL library: the renderer then says what is missing
        return
    gl_context.GLContext = GLContext
