"""What makes a task of an arm: its box, what stands before it, and when it has succeeded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from skewmi.errors import ConfigurationError
from skewmi.policy_io import TIME_FIELD, ActionField, Array, Ball, Field, PolicyLayout, Workspace
from skewmi.robot_models import frames
from skewmi.robot_models.servo import CONTACT_SERVO, ServoParameters
from skewmi.sim.arm import definition
from skewmi.sim.arm.variation_keys import ARM_KEYS
from skewmi.sim.checks import chosen_target
from skewmi.sim.variation import Variations

Vector = tuple[float, float, float]

ARM_VARIATIONS = Variations(ARM_KEYS, ("skewmi.sim",))
"""What may vary whatever stands before the arm, and the files for it that come with skewmi."""

LAYOUT_SWITCHES = ("gripper_action", "time_input")
"""Options of `ArmTask.layout`, each off by default."""


@dataclass(frozen=True)
class SensedJoint:
    """A joint of the scene that a policy observes.

    Attributes:
        name: In the model, and in the scene states of a robot.
        field: What it is in the observation; its range is that of the joint.
        give: How far the joint's soft stops give way, in the field's unit.
        bias_key, noise_key: Keys of a variation that its sensor's errors are drawn from, in the
            field's unit, or in degrees if they end so; empty: it has none.
        start: Its position at the start of an episode.
    """

    name: str
    field: Field
    give: float = 0.003
    bias_key: str = ""
    noise_key: str = ""
    start: float = 0.0


@dataclass(frozen=True)
class ArmTask:
    """A task of the right arm, whose hand points straight down.

    Attributes:
        name: Of the task.
        low, high: Box that the commanded hand may not leave, world, m.
        start: Where the hand starts, world, m.
        start_configuration: Joint angles, chain order, rad, that put the hand there: what
            `python -m skewmi.robot_models.start_search` prints.
        joints: Of the scene, as the observation has them after hand and gripper.
        add_parts: Adds what stands on the table to the robot's model, whose origin is the
            world's; see `skewmi.sim.arm.table`.
        success: The state's region that is rewarded, in fields of `joints` above all; that the
            hand is in its box is added.
        box_body: Body that stands on the table, in the world and not turned, with everything that
            moves with it: what a calibration finds the place of. Empty if it finds none.
        targets: Regions by name that may be chosen in its place; one of them is `success`.
        gripper_opening: Finger travel while the policy does not move the fingers, m.
        success_hold_steps: So many steps in a row must end in the region.
        episode_steps: Control steps of an episode.
        servo: Of the arm.
        possible: Whether states can be at all, as far as the ranges of the fields do not tell:
            from each field's values, shape (...), to (...). It may let impossible ones pass.
        variations: What may vary, and the files that come with the task.
    """

    name: str
    low: Vector
    high: Vector
    start: Vector
    start_configuration: tuple[float, ...]
    joints: tuple[SensedJoint, ...]
    add_parts: Callable[[mujoco.MjSpec], None]
    success: tuple[Ball, ...]
    box_body: str = ""
    gripper_opening: float = 0.0
    success_hold_steps: int = 10
    episode_steps: int = 200
    servo: ServoParameters = CONTACT_SERVO
    possible: Callable[[Mapping[str, Array]], NDArray[np.bool_]] | None = None
    variations: Variations = ARM_VARIATIONS
    targets: Mapping[str, tuple[Ball, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {key.name for key in self.variations.keys}
        for joint in self.joints:
            unknown = {joint.bias_key, joint.noise_key} - known - {""}
            if unknown:
                raise ConfigurationError(
                    f"task {self.name!r}: joint {joint.name!r} names keys that its variations do "
                    f"not have: {sorted(unknown)}"
                )
        if self.targets and self.success not in self.targets.values():
            raise ConfigurationError(f"task {self.name!r}: its success is none of its targets")

    def box_origin(self, model: mujoco.MjModel) -> tuple[float, float] | None:
        """Middle of the box in the nominal model, m; None if there is none to find the place of."""
        if not self.box_body:
            return None
        x, y, _ = model.body(self.box_body).pos.tolist()
        return x, y

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the scene's joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets, that of `success` first; none if there is nothing to choose."""
        names = sorted(self.targets, key=lambda name: self.targets[name] != self.success)
        return tuple(names)

    @property
    def scene_fields(self) -> dict[str, str]:
        """Observation field of each joint of the scene."""
        return {joint.name: joint.field.name for joint in self.joints}

    def layout(
        self, *, gripper_action: bool = False, time_input: bool = False, target: str | None = None
    ) -> PolicyLayout:
        """What a policy sees and does.

        Args:
            gripper_action: Adds the speed of the fingers as fourth action (the published code has
                it, the paper's text does not); without it the fingers keep their opening.
            time_input: Adds the time as last observation, as step index / episode steps.
            target: Name of the region that is rewarded; without it, it is `success`.

        Raises:
            NotFoundError: There is no such target; the message lists those that exist.
        """
        success = self.success
        if target is not None:
            success = chosen_target(self.name, self.targets, target)
        x, y, z = frames.BASE_IN_WORLD.tolist()
        qw, qx, qy, qz = frames.HAND_DOWN_QUATERNION_WXYZ.tolist()
        workspace = Workspace(
            low=self.low,
            high=self.high,
            start=self.start,
            base_position=(x, y, z),
            hand_quaternion_wxyz=(qw, qx, qy, qz),
            free_following_error=definition.FREE_FOLLOWING_ERROR,
            held_following_error=definition.HELD_FOLLOWING_ERROR,
            stop_blockage=definition.STOP_BLOCKAGE,
            start_configuration=self.start_configuration,
            gripper_opening=self.gripper_opening,
        )
        sides = tuple(zip("xyz", self.low, self.high, strict=True))
        observation = [Field(f"hand_{a}", "m", "world", low, high) for a, low, high in sides]
        observation.append(Field("gripper", "m", "finger", 0.0, definition.FINGER_MAX))
        observation += [joint.field for joint in self.joints]
        if time_input:
            observation.append(Field(TIME_FIELD, "1", "episode", 0.0, 1.0))
        action = [
            ActionField(f"hand_{axis}", "m/step", "world", definition.HAND_STEP) for axis in "xyz"
        ]
        if gripper_action:
            action.append(ActionField("gripper", "m/step", "finger", definition.FINGER_STEP))
        in_box = (
            Ball((f"hand_{a}",), ((low + high) / 2,), (high - low) / 2 + definition.BOX_TOLERANCE)
            for a, low, high in sides
        )
        return PolicyLayout(
            task=self.name,
            observation=tuple(observation),
            action=tuple(action),
            reward_region=(*in_box, *success),
            control_dt=definition.CONTROL_DT,
            episode_steps=self.episode_steps,
            success_hold_steps=self.success_hold_steps,
            workspace=workspace,
        )
