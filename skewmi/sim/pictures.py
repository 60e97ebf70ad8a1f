"""One picture of one copy of a running task, for Gymnasium's `rgb_array`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import mujoco

from skewmi.batch_env import BatchEnv
from skewmi.errors import ConfigurationError
from skewmi.sim.offscreen import Image
from skewmi.sim.rendering import Renderer
from skewmi.sim.tasks.point_maze.scene import MazePicture
from skewmi.sim.tasks.point_maze.task import PointMazeBatch

if TYPE_CHECKING:
    from skewmi.sim.arm.batch import OpenPressCloseBatch


class Camera(Protocol):
    """Draws copies of one environment."""

    def render(self, index: int) -> Image:
        """Picture of copy `index` now. Shape (height, width, 3)."""

    def close(self) -> None:
        """Give the OpenGL context back."""


def make_camera(env: BatchEnv, width: int, height: int) -> Camera:
    """A camera for an environment.

    Args:
        env: Which environment.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.

    Raises:
        ConfigurationError: Nobody can draw this environment.
    """
    if isinstance(env, PointMazeBatch):
        return MazeCamera(env, width, height)
    # Imported here, so that the maze is drawn without loading the robot.
    from skewmi.sim.arm.batch import OpenPressCloseBatch

    if isinstance(env, OpenPressCloseBatch):
        return BoxCamera(env, width, height)
    raise ConfigurationError(f"cannot draw an environment of type {type(env).__name__}")


class MazeCamera:
    """The maze from above; satisfies `Camera`."""

    def __init__(self, env: PointMazeBatch, width: int, height: int) -> None:
        self._env = env
        self._picture = MazePicture(width, height)

    def render(self, index: int) -> Image:
        """See `Camera.render`."""
        return self._picture.render(self._env.position[index])

    def close(self) -> None:
        """See `Camera.close`."""
        self._picture.close()


class BoxCamera:
    """Robot and box from the scene's own `overview` camera; satisfies `Camera`."""

    def __init__(self, env: OpenPressCloseBatch, width: int, height: int) -> None:
        self._env = env
        self._size = (width, height)
        self._data = mujoco.MjData(env.scene.model)
        self._renderer: Renderer | None = None

    def render(self, index: int) -> Image:
        """See `Camera.render`."""
        if self._renderer is None:
            width, height = self._size
            self._renderer = Renderer(self._env.scene.model, width=width, height=height)
        # The batch runs a model without visual geoms; the positions mean the same in both.
        self._data.qpos[:] = self._env.batch.bind("qpos")[index]
        return self._renderer.draw(self._data, "overview")

    def close(self) -> None:
        """See `Camera.close`."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
