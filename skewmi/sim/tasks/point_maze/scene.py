"""The maze as a MuJoCo model: for pictures, and to check the arithmetic of `maze` against."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.sim.offscreen import Image, make_renderer
from skewmi.sim.tasks.point_maze import maze
from skewmi.sim.tasks.point_maze.batch import PointMazeBatch

POINT_RADIUS = 1e-5
"""Radius of the colliding sphere, m: MuJoCo has no points."""

CAMERA = "top"
"""Camera that looks straight down on the whole maze, +x to the right and +y up."""

_WALL_HEIGHT = 0.8
_CAMERA_HEIGHT = 40.0
_VIEW_HALF_WIDTH = 7.3
_MAX_TRAIL = 5000


def build_scene(target: tuple[float, ...] = maze.TARGET) -> mujoco.MjSpec:
    """Walls, floor, target and a point on two slide joints `x` and `y`, in the maze's world.

    Wall geoms are named `wall_<k>` in the order of `maze.wall_rectangles`; the colliding geom of
    the point is `point`. Nothing else collides.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "point_maze"
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.visual.headlight.ambient = [0.5, 0.5, 0.5]
    spec.visual.headlight.diffuse = [0.5, 0.5, 0.5]
    world = spec.worldbody
    rectangles = maze.wall_rectangles()
    for k, (x_low, y_low, x_high, y_high) in enumerate(rectangles):
        world.add_geom(
            name=f"wall_{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.5 * (x_low + x_high), 0.5 * (y_low + y_high), 0.5 * _WALL_HEIGHT],
            size=[0.5 * (x_high - x_low), 0.5 * (y_high - y_low), 0.5 * _WALL_HEIGHT],
            rgba=[0.25, 0.29, 0.35, 1.0],
        )
    centre = 0.5 * (rectangles[:, :2].min(axis=0) + rectangles[:, 2:].max(axis=0))
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[*centre, -0.05],
        size=[50.0, 50.0, 0.05],
        rgba=[0.95, 0.95, 0.93, 1.0],
        contype=0,
        conaffinity=0,
    )
    world.add_geom(
        name="target",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[*target, 0.01],
        size=[maze.TARGET_RADIUS, 0.01, 0.0],
        rgba=[0.15, 0.65, 0.3, 1.0],
        contype=0,
        conaffinity=0,
    )
    world.add_camera(
        name=CAMERA,
        pos=[*centre, _CAMERA_HEIGHT],
        fovy=math.degrees(2.0 * math.atan(_VIEW_HALF_WIDTH / _CAMERA_HEIGHT)),
    )
    _add_point(world)
    return spec


def _add_point(world: mujoco.MjsBody) -> None:
    """Add the point: a sphere that collides, and a larger one to be seen."""
    body = world.add_body(name="point", pos=[0.0, 0.0, 0.5 * _WALL_HEIGHT])
    for name, axis in (("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0])):
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    body.add_geom(
        name="point", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[POINT_RADIUS, 0.0, 0.0], mass=0.0
    )
    body.add_geom(
        name="point_visual",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.2, 0.0, 0.0],
        rgba=[0.85, 0.25, 0.2, 1.0],
        mass=1.0,
        contype=0,
        conaffinity=0,
    )


class MazePicture:
    """Draws the maze from above, with a point and where it has been."""

    def __init__(
        self, width: int = 480, height: int = 480, target: tuple[float, ...] = maze.TARGET
    ) -> None:
        """Compile the model; the first `render` opens OpenGL.

        Args:
            width: Of the images, pixels.
            height: Of the images, pixels; it spans 14.6 m.
            target: That is drawn, x, y in m.
        """
        self._model = build_scene(target).compile()
        self._data = mujoco.MjData(self._model)
        self._size = (width, height)
        self._renderer: mujoco.Renderer | None = None

    def render(self, position: Array, trail: Array | None = None) -> Image:
        """One picture.

        Args:
            position: Of the point, x, y in m. Shape (2,).
            trail: Positions it has visited, m; of more than 5000 an even selection is drawn.
                Shape (n, 2).

        Raises:
            ConfigurationError: A shape is wrong, or there is no OpenGL.
        """
        position = np.asarray(position, dtype=np.float64)
        trail = np.zeros((0, 2)) if trail is None else np.asarray(trail, dtype=np.float64)
        if position.shape != (2,) or trail.ndim != 2 or trail.shape[1] != 2:
            raise ConfigurationError(
                f"position and trail have shapes {position.shape} and {trail.shape}; "
                "a picture takes (2,) and (n, 2)"
            )
        if self._renderer is None:
            self._renderer = make_renderer(self._model, *self._size)
        self._data.qpos[:] = position
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, CAMERA)
        stride = -(-len(trail) // _MAX_TRAIL) or 1
        for x, y in trail[::stride]:
            self._add_dot(x, y)
        image: Image = self._renderer.render()
        return image

    def close(self) -> None:
        """Give the OpenGL context back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _add_dot(self, x: float, y: float) -> None:
        assert self._renderer is not None
        scene = self._renderer.scene
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_SPHERE.value,
            np.array([0.05, 0.0, 0.0]),
            np.array([x, y, 0.05]),
            np.eye(3).ravel(),
            np.array([0.2, 0.4, 0.8, 1.0], dtype=np.float32),
        )
        scene.ngeom += 1


class MazeCamera:
    """Copies of a running maze from above; satisfies `Camera`.

    Args:
        env: Whose copies are drawn.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
    """

    def __init__(self, env: PointMazeBatch, width: int, height: int) -> None:
        self._env = env
        self._picture = MazePicture(width, height, env.layout.reward_region[0].centre)

    def render(self, index: int) -> Image:
        """See `Camera.render`."""
        return self._picture.render(self._env.position[index])

    def close(self) -> None:
        """See `Camera.close`."""
        self._picture.close()
