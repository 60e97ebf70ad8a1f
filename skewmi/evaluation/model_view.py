"""Copies of a MuJoCo model in Rerun, side by side, each moved by its own joint positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from skewmi.policy_io import Array

TIMELINE = "time"
"""Seconds, one round of episodes after the other."""
HIDDEN_GROUP = 3
"""Of geoms that only collide."""


def copy_path(index: int) -> str:
    """Entity of a copy, counted from 1 for people."""
    return f"/copies/{index + 1}"


class ModelView:
    """Draws copies of a model.

    Args:
        recording: A `rerun.RecordingStream`.
        model: What is drawn; its fields are changed while a copy that differs is drawn.
        offsets: Where each copy stands, m. Shape (n, 3).
    """

    def __init__(self, recording: Any, model: mujoco.MjModel, offsets: Array) -> None:
        self._recording, self._model, self._offsets = recording, model, offsets
        self._data = mujoco.MjData(model)
        self._geoms = _geoms_by_body(model)
        for index, offset in enumerate(offsets):
            where = rr.Transform3D(translation=offset)
            recording.log(copy_path(index), where, static=True)

    def draw(
        self, index: int, time_s: Array, qpos: Array, fields: Mapping[str, Array] | None = None
    ) -> None:
        """Draw one copy over some time.

        Args:
            index: Which.
            time_s: Shape (n,).
            qpos: Of the model. Shape (n, nq).
            fields: What is different in this copy's model, by the name of the `MjModel` field.
        """
        nominal = {name: getattr(self._model, name).copy() for name in fields or {}}
        for name, values in (fields or {}).items():
            getattr(self._model, name)[:] = values
        try:
            self._draw(index, time_s, qpos)
        finally:
            for name, values in nominal.items():
                getattr(self._model, name)[:] = values

    def _draw(self, index: int, time_s: Array, qpos: Array) -> None:
        n, bodies = len(time_s), self._model.nbody
        position, turn = np.empty((n, bodies, 3)), np.empty((n, bodies, 4))
        for row, q in enumerate(qpos):
            self._data.qpos[:] = q
            mujoco.mj_kinematics(self._model, self._data)
            position[row], turn[row] = self._data.xpos, self._data.xquat
        times = [rr.TimeColumn(TIMELINE, duration=time_s)]
        for body, geoms in self._geoms.items():
            path = f"{copy_path(index)}/{self._model.body(body).name or 'world'}"
            # A varied copy has shapes of its own in each round.
            self._recording.set_time(TIMELINE, duration=float(time_s[0]))
            for kind, ids in geoms.items():
                self._recording.log(f"{path}/{kind}", _shapes(self._model, kind, ids))
            moved = rr.Transform3D.columns(
                translation=position[:, body], quaternion=np.roll(turn[:, body], -1, axis=1)
            )
            self._recording.send_columns(path, indexes=times, columns=moved)


_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "boxes",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsules",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinders",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "spheres",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoids",
}
"""Geoms that are drawn; planes have no end, and our models no meshes."""


def _geoms_by_body(model: mujoco.MjModel) -> dict[int, dict[str, NDArray[np.int64]]]:
    """Indices of the geoms that are seen, by body and kind."""
    found: dict[int, dict[str, list[int]]] = {}
    for geom in range(model.ngeom):
        kind = _KINDS.get(int(model.geom_type[geom]))
        if kind is not None and model.geom_group[geom] != HIDDEN_GROUP:
            body = found.setdefault(int(model.geom_bodyid[geom]), {})
            body.setdefault(kind, []).append(geom)
    return {
        body: {kind: np.array(ids) for kind, ids in kinds.items()} for body, kinds in found.items()
    }


def _shapes(model: mujoco.MjModel, kind: str, ids: NDArray[np.int64]) -> Any:
    size, centre = model.geom_size[ids], model.geom_pos[ids].astype(np.float64)
    turn = np.roll(model.geom_quat[ids], -1, axis=1)
    quaternions = [rr.Quaternion(xyzw=row) for row in turn]
    colors = (255.0 * _colors(model, ids)).round().astype(np.uint8)
    if kind == "boxes":
        return rr.Boxes3D(
            half_sizes=size, centers=centre, quaternions=quaternions, colors=colors, fill_mode=3
        )
    if kind == "cylinders":
        return rr.Cylinders3D(
            lengths=2.0 * size[:, 1],
            radii=size[:, 0],
            centers=centre,
            quaternions=quaternions,
            colors=colors,
            fill_mode=3,
        )
    if kind == "capsules":
        # Rerun's begin at one end, MuJoCo's have their middle there.
        z = np.array([_along_z(row) for row in model.geom_quat[ids]])
        return rr.Capsules3D(
            lengths=2.0 * size[:, 1],
            radii=size[:, 0],
            translations=centre - size[:, 1:2] * z,
            quaternions=quaternions,
            colors=colors,
            fill_mode=3,
        )
    halves = np.repeat(size[:, :1], 3, axis=1) if kind == "spheres" else size
    return rr.Ellipsoids3D(
        half_sizes=halves, centers=centre, quaternions=quaternions, colors=colors, fill_mode=3
    )


def _along_z(quaternion_wxyz: Array) -> Array:
    matrix: Array = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion_wxyz)
    along: Array = matrix[[2, 5, 8]]
    return along


def _colors(model: mujoco.MjModel, ids: NDArray[np.int64]) -> Array:
    """Of the geoms' materials where they have one. Shape (n, 4)."""
    material = model.geom_matid[ids]
    own: Array = model.geom_rgba[ids].astype(np.float64)
    if model.nmat == 0:
        return own
    painted = model.mat_rgba[np.maximum(material, 0)].astype(np.float64)
    colors: Array = np.where(material[:, None] >= 0, painted, own)
    return colors
