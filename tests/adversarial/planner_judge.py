"""Checks of planned and executed motion that were written without the planner.

Everything is judged on whole stretches of motion at once; a breach still names the cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio
from numpy.typing import NDArray
from planner_scenes import smallest_singular_value

from skewmi.policy_io import Workspace
from skewmi.robot_models import urdf, yumi
from skewmi.robot_models.limits import JointLimits

Array = NDArray[np.float64]
State = tuple[Array, Array, Array]

GRID_DT = 0.004
TCP_SPEED = 0.25
BOX_TOLERANCE = 0.005
AT_FACE = 1e-3
"""Distance from a face of the box at which the hand has reached it, m."""
AT_BOUND = 3e-3
"""Distance from a position bound at which a joint has reached it, rad; the planner steers to stop
2 mrad before it."""


class Breach(AssertionError):  # noqa: N818 - it is what a test reports
    """The planner broke a promise."""


class UrdfArm:
    """The right arm by Pinocchio on the URDF; poses in the base frame."""

    def __init__(self) -> None:
        self._model = pinocchio.buildModelFromXML(urdf.build_urdf(arms=("right",)))
        self._data = self._model.createData()
        joints = [self._model.getJointId(name) for name in yumi.joint_names("right")]
        self._columns = [self._model.joints[joint].idx_q for joint in joints]
        self._tool = self._model.getFrameId(yumi.tool_name("right"))
        self._q = pinocchio.neutral(self._model)

    def positions(self, q: Array) -> Array:
        """Flange positions, m. Shape (n, 7) -> (n, 3)."""
        model, data, full, columns, tool = (
            self._model,
            self._data,
            self._q,
            self._columns,
            self._tool,
        )
        out = np.empty((len(q), 3))
        for k, sample in enumerate(q):
            full[columns] = sample
            pinocchio.forwardKinematics(model, data, full)
            out[k] = pinocchio.updateFramePlacement(model, data, tool).translation
        return out

    def rotations(self, q: Array) -> Array:
        """Flange orientations. Shape (n, 7) -> (n, 3, 3)."""
        out = np.empty((len(q), 3, 3))
        for k, sample in enumerate(q):
            self._q[self._columns] = sample
            pinocchio.forwardKinematics(self._model, self._data, self._q)
            out[k] = pinocchio.updateFramePlacement(self._model, self._data, self._tool).rotation
        return out

    def singular_values(self, q: Array) -> Array:
        """Smallest singular values of the Jacobian. Shape (n, 7) -> (n,)."""
        jacobians = np.empty((len(q), 6, 7))
        frame = pinocchio.LOCAL_WORLD_ALIGNED
        for k, sample in enumerate(q):
            self._q[self._columns] = sample
            full = pinocchio.computeFrameJacobian(
                self._model, self._data, self._q, self._tool, frame
            )
            jacobians[k] = full[:, self._columns]
        return smallest_singular_value(jacobians)


@dataclass
class Judge:
    """Collects one round's chunks and executed samples and judges them.

    Attributes:
        usage: Largest fraction of each limit that was used.
    """

    limits: JointLimits
    workspace: Workspace
    arm: UrdfArm
    usage: dict[str, float] = field(default_factory=dict)
    chunks: list[State] = field(default_factory=list)
    starts: list[State] = field(default_factory=list)
    executed: list[Array] = field(default_factory=list)
    judged: int = 0
    """Chunks judged before those collected now."""

    def add(self, chunk: State, start: State) -> None:
        """A chunk (q, v, a), each (n, 7), and the state it must start at, each (7,)."""
        self.chunks.append(chunk)
        self.starts.append(start)

    def note(self, name: str, fractions: Array, owner: NDArray[np.intp] | None = None) -> None:
        """Fractions of a limit, one row each; `owner` says of which chunk."""
        if not fractions.size:
            return
        # NaN counts as more than anything.
        worst = int(np.argmax(np.where(np.isnan(fractions), np.inf, fractions)))
        value = float(fractions.flat[worst])
        self.usage[name] = max(self.usage.get(name, 0.0), value)
        if not value <= 1.0:
            row = worst // max(1, fractions[0].size)
            at = f"sample {row}" if owner is None else f"cycle {self.judged + owner[row]}"
            raise Breach(f"{name} is {100 * value:.6f} % of its limit, {at}")

    def settle(self) -> None:
        """Judge what has been collected since the last call."""
        if not self.chunks:
            return
        owner = np.repeat(np.arange(len(self.chunks)), [len(c[0]) for c in self.chunks])
        q, v, a = (np.concatenate(parts) for parts in zip(*self.chunks, strict=True))
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        last = np.append(first[1:], len(owner)) - 1
        for samples, states in zip((q, v, a), zip(*self.starts, strict=True), strict=True):
            wrong = (samples[first] != np.stack(states)).any(axis=1)
            if wrong.any():
                cycle = self.judged + int(np.argmax(wrong))
                raise Breach(f"the chunk of cycle {cycle} does not start on the one before")
        moving = (v[last] != 0.0).any(axis=1) | (a[last] != 0.0).any(axis=1)
        if moving.any():
            cycle = self.judged + int(np.argmax(moving))
            raise Breach(f"the chunk of cycle {cycle} does not end at rest")
        bounds, inside = self.limits, owner[1:] == owner[:-1]
        self.note("chunk v", np.abs(v) / bounds.velocity, owner)
        self.note("chunk a", np.abs(a) / bounds.acceleration, owner)
        jerk = np.abs(np.diff(a, axis=0))[inside] / GRID_DT
        self.note("chunk jerk", jerk / bounds.jerk, owner[1:][inside])
        # v must be the derivative of q: |q1 - q0 - h (v0 + v1) / 2| <= J h^3 / 12.
        misfit = np.abs(np.diff(q, axis=0) - GRID_DT * (v[1:] + v[:-1]) / 2)[inside]
        self.note("chunk fit", misfit / (bounds.jerk * GRID_DT**3 / 12), owner[1:][inside])
        self.motion(q, "tail", owner)
        self.hand(q, "tail", owner)
        self.judged += len(self.chunks)
        self.chunks.clear()
        self.starts.clear()

    def motion(self, q: Array, what: str, owner: NDArray[np.intp]) -> None:
        """Positions on the grid alone; differences only between samples of one owner."""
        bounds = self.limits
        middle = (bounds.position_upper + bounds.position_lower) / 2
        half = (bounds.position_upper - bounds.position_lower) / 2
        self.note(f"{what} position", np.abs(q - middle) / half, owner)
        derived = q
        for order, (name, bound) in enumerate(
            (
                ("velocity", bounds.velocity),
                ("acceleration", bounds.acceleration),
                ("jerk", bounds.jerk),
            ),
            start=1,
        ):
            derived = np.diff(derived, axis=0) / GRID_DT
            same = owner[order:] == owner[:-order]
            self.note(f"{what} {name}", np.abs(derived[same]) / bound, owner[order:][same])

    def hand(self, q: Array, what: str, owner: NDArray[np.intp]) -> Array:
        """Box and tool speed; returns the hand's positions, world, m. Shape (n, 3)."""
        position = self.arm.positions(q) + np.array(self.workspace.base_position)
        low, high = np.array(self.workspace.low), np.array(self.workspace.high)
        outside = np.maximum(low - position, position - high).max(axis=1)
        self.note(f"{what} box", np.maximum(outside, 0.0) / BOX_TOLERANCE, owner)
        same = owner[1:] == owner[:-1]
        speed = np.linalg.norm(np.diff(position, axis=0), axis=1)[same] / GRID_DT
        self.note(f"{what} tool speed", speed / TCP_SPEED, owner[1:][same])
        return position

    def finish(self) -> dict[str, object]:
        """Judge the executed stream; returns which borders it reached and how near singular."""
        self.settle()
        q = np.concatenate(self.executed)
        whole = np.zeros(len(q), dtype=np.intp)
        self.judged = 0
        self.motion(q, "executed", whole)
        position = self.hand(q, "executed", whole)
        low, high = np.array(self.workspace.low), np.array(self.workspace.high)
        to_faces = np.stack([position - low, high - position], axis=2).min(axis=0)
        to_bounds = np.stack(
            [q - self.limits.position_lower, self.limits.position_upper - q], axis=2
        ).min(axis=0)
        values = self.arm.singular_values(q[::5])
        return {
            "faces": [
                f"{'xyz'[axis]} {side}"
                for axis in range(3)
                for s, side in enumerate(("low", "high"))
                if to_faces[axis, s] < AT_FACE
            ],
            "bounds": [
                f"joint index {joint} {side}"
                for joint in range(7)
                for s, side in enumerate(("lower", "upper"))
                if to_bounds[joint, s] < AT_BOUND
            ],
            "smallest_singular_value": float(values.min()),
            "near_singular_cycles": int((values < 0.05).sum()),
        }
