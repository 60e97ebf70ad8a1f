"""What a policy sees and does: one description shared by simulation, training and deployment.

`sim` and `deploy` both call `assemble_observation` (and use one `CommandIntegrator`), so that a
policy meets on the robot exactly what it met in training. The description travels inside every
checkpoint and ONNX file; its hash is compared before anything runs. Needs numpy only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError, LayoutMismatchError

Array = NDArray[np.float64]

LAYOUT_VERSION = 1
"""Raised when the meaning of a layout's fields changes; part of the hash."""

TIME_FIELD = "time"
"""Name of the optional last observation field: step index / episode_steps, in [0, 1]."""


@dataclass(frozen=True)
class Field:
    """One number of the observation.

    `low` and `high` are its nominal range in `unit`: they scale network inputs and densities,
    they do not clip.
    """

    name: str
    unit: str
    frame: str
    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ConfigurationError(
                f"observation field {self.name!r}: low {self.low} must be below high {self.high}"
            )


@dataclass(frozen=True)
class ActionField:
    """One number of the action, in [-1, 1]; `scale` is what 1.0 means per control step."""

    name: str
    unit: str
    frame: str
    scale: float

    def __post_init__(self) -> None:
        if not self.scale > 0.0:
            raise ConfigurationError(
                f"action field {self.name!r}: scale {self.scale} must be positive"
            )


@dataclass(frozen=True)
class Ball:
    """A closed ball in some observation fields: |state[fields] - centre| <= radius.

    For one field it is an interval. A reward region is the intersection of balls.
    """

    fields: tuple[str, ...]
    centre: tuple[float, ...]
    radius: float


@dataclass(frozen=True)
class Workspace:
    """The box that the commanded hand position may not leave, and how the hand is held.

    All vectors are in metres in the task's world frame, that of its box; `base_position` is the
    origin of the robot base frame in it. The hand frame is the flange (tool0), z out of the flange.
    `hand_quaternion_wxyz` is its constant orientation in world. Following errors and blockages are
    in full actions: each axis of a distance divided by its action scale; see `command_integrator`.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    start: tuple[float, float, float]
    base_position: tuple[float, float, float]
    hand_quaternion_wxyz: tuple[float, float, float, float]
    free_following_error: float
    """How far the command may be ahead of a hand that follows it."""
    held_following_error: float
    """The same where something blocks the hand: bounds the force that the servos build up."""
    stop_blockage: float
    """Blockage at which a command stops before its step is over."""
    start_configuration: tuple[float, ...]
    """Joint angles, chain order 1,2,7,3,4,5,6, rad, that put the hand at `start`."""
    gripper_opening: float
    """Travel of each finger from closed while the action has no gripper component, m."""
    base_yaw: float = 0.0
    """Turn of the robot base about the vertical in the task's frame, rad; see `base_frame`."""


WORKSPACE_KEYS = {
    "free_following_error": "free_lead",
    "held_following_error": "held_lead",
    "stop_blockage": "stop_lead",
}
"""Fields of `Workspace` that are called otherwise in a layout's JSON: that is part of the hash."""


@dataclass(frozen=True)
class PolicyLayout:
    """Everything that must agree between the simulation, the policy and the robot."""

    task: str
    observation: tuple[Field, ...]
    action: tuple[ActionField, ...]
    reward_region: tuple[Ball, ...]
    control_dt: float
    """Seconds between two actions."""
    episode_steps: int
    success_hold_steps: int
    """An episode succeeds when this many consecutive steps end inside the reward region."""
    workspace: Workspace | None = None

    def __post_init__(self) -> None:
        if not self.control_dt > 0.0:
            raise ConfigurationError(f"control_dt {self.control_dt} s must be positive")
        if self.episode_steps < 1 or self.success_hold_steps < 1:
            raise ConfigurationError(
                f"episode_steps {self.episode_steps} and success_hold_steps "
                f"{self.success_hold_steps} must be at least 1"
            )
        names = self.observation_names
        if len(set(names)) != len(names):
            raise ConfigurationError(f"observation field names repeat: {', '.join(names)}")
        if TIME_FIELD in names[:-1]:
            raise ConfigurationError(f"{TIME_FIELD!r} must be the last observation field")
        for ball in self.reward_region:
            unknown = [name for name in ball.fields if name not in names]
            if unknown:
                raise ConfigurationError(
                    f"reward region uses unknown fields {unknown}; fields are {list(names)}"
                )

    @property
    def observation_names(self) -> tuple[str, ...]:
        return tuple(field.name for field in self.observation)

    @property
    def state_fields(self) -> tuple[Field, ...]:
        """The observation without time: what goals, densities and metrics are about."""
        return tuple(field for field in self.observation if field.name != TIME_FIELD)

    @property
    def observation_dim(self) -> int:
        return len(self.observation)

    @property
    def state_dim(self) -> int:
        return len(self.state_fields)

    @property
    def action_dim(self) -> int:
        return len(self.action)

    @property
    def action_scale(self) -> Array:
        """Physical size of action 1.0 per control step. Shape (action_dim,)."""
        return np.array([field.scale for field in self.action])

    @property
    def observation_low(self) -> Array:
        return np.array([field.low for field in self.observation])

    @property
    def observation_high(self) -> Array:
        return np.array([field.high for field in self.observation])

    def to_json(self) -> str:
        """Canonical JSON at full precision (floats by repr, keys sorted)."""
        content = {"layout_version": LAYOUT_VERSION, **asdict(self)}
        if content["workspace"] is not None:
            content["workspace"] = {
                WORKSPACE_KEYS.get(name, name): value
                for name, value in content["workspace"].items()
                if name != "base_yaw" or value != 0.0  # no part of what older versions hashed
            }
        return json.dumps(content, sort_keys=True, separators=(",", ":"))

    def hash(self) -> str:
        """sha256 of the canonical JSON, hexadecimal."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    @staticmethod
    def from_json(text: str) -> PolicyLayout:
        """Inverse of `to_json`.

        Raises:
            LayoutMismatchError: The text is not a layout, or one of another version.
        """
        try:
            content: dict[str, Any] = json.loads(text)
            version = content.pop("layout_version")
            if version != LAYOUT_VERSION:
                raise LayoutMismatchError(
                    f"policy layout version is {version}, this skewmi reads {LAYOUT_VERSION}; "
                    "export the policy again"
                )
            workspace = content.pop("workspace")
            return PolicyLayout(
                observation=tuple(Field(**field) for field in content.pop("observation")),
                action=tuple(ActionField(**field) for field in content.pop("action")),
                reward_region=tuple(
                    Ball(tuple(ball["fields"]), tuple(ball["centre"]), ball["radius"])
                    for ball in content.pop("reward_region")
                ),
                workspace=None if workspace is None else _workspace(workspace),
                **content,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise LayoutMismatchError(f"not a policy layout: {error}") from error


def _workspace(content: dict[str, Any]) -> Workspace:
    left = {"base_yaw": 0.0, **content}
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value := left.pop(key), list) else value
        for name, key in ((f.name, WORKSPACE_KEYS.get(f.name, f.name)) for f in fields(Workspace))
    }
    if left:
        raise ValueError(f"unknown fields of the workspace: {sorted(left)}")
    return Workspace(**values)


def require_same_layout(expected: PolicyLayout, given: PolicyLayout, what: str) -> None:
    """Refuse to mix layouts, naming the first parts that differ.

    Args:
        expected: Layout of whoever is going to use the policy.
        given: Layout that came with the policy or checkpoint.
        what: What `given` came with, for the message.

    Raises:
        LayoutMismatchError: The hashes differ.
    """
    if expected.hash() == given.hash():
        return
    ours, theirs = asdict(expected), asdict(given)
    parts = [f"{k}: expected {ours[k]!r}, got {theirs[k]!r}" for k in ours if ours[k] != theirs[k]]
    shown = "; ".join(part if len(part) < 200 else part[:197] + "..." for part in parts[:3])
    raise LayoutMismatchError(f"{what} was made for another layout ({shown})")


def assemble_observation(layout: PolicyLayout, values: Mapping[str, Any]) -> Array:
    """Build the observation from named values; the only place where it is built.

    Args:
        layout: Which fields, in which order.
        values: One entry per field, scalar or shape (n,), in the field's unit and frame.

    Returns:
        Shape (observation_dim,) for scalars, else (n, observation_dim).

    Raises:
        LayoutMismatchError: A field is missing.
    """
    missing = [name for name in layout.observation_names if name not in values]
    if missing:
        raise LayoutMismatchError(
            f"observation of task {layout.task!r} needs {missing}; got {sorted(values)}"
        )
    columns = [np.asarray(values[name], dtype=np.float64) for name in layout.observation_names]
    shape = np.broadcast_shapes(*(column.shape for column in columns))
    observation = np.empty((*shape, len(columns)))
    for index, column in enumerate(columns):
        observation[..., index] = column
    return observation


class Policy(Protocol):
    """What `deploy` and `evaluate` run: an ONNX file, a checkpoint or a script."""

    layout: PolicyLayout

    def reset(self) -> None:
        """Forget the previous episode."""

    def act(self, observation: Array) -> Array:
        """Action in [-1, 1], shape (..., action_dim), for an observation (..., observation_dim)."""
