"""Pictures of running environments with an arm."""

from __future__ import annotations

import mujoco

from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.offscreen import Image
from skewmi.sim.rendering import Renderer


class ArmCamera:
    """Robot and scene from the scene's own `overview` camera; satisfies `Camera`.

    Args:
        env: Whose copies are drawn.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
    """

    def __init__(self, env: ArmBatch, width: int, height: int) -> None:
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
