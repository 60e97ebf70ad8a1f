"""What may vary about an arm, and building blocks for what may vary about the scene before it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.robot_models import servo, yumi
from skewmi.sim.arm.model_fields import ModelFields
from skewmi.sim.variation import VariationKey

FRICTION_SCALE = "servo.frictionloss_scale"
DELAY_MS = "servo.delay_ms"
STICTION_SCALE = "servo.stiction_scale"
STRIBECK_VELOCITY = "servo.stribeck_velocity"
BACKLASH = "servo.backlash"
OPENING_ERROR = "gripper.opening_error"
JOINT_NOISE = "sensors.joint_noise"
JOINT_OFFSET = "sensors.joint_offset"
VELOCITY_NOISE = "sensors.velocity_noise"
EFFORT_NOISE = "sensors.effort_noise"
COMMAND_DELAY_MS = "command.delay_ms"
LINK_LOSS = "link.loss"
LINK_DELAY_MS = "link.delay_ms"
LINK_JITTER_MS = "link.jitter_ms"
"""Keys that are no field of a model: whoever simulates the arm sees to them."""


def _scale_stiffness(fields: ModelFields, scale: Array) -> None:
    servos = _servos(fields)
    fields.write("actuator_gainprm")[:, servos, 0] *= scale
    fields.write("actuator_biasprm")[:, servos, 1] *= scale


def _scale_damping(fields: ModelFields, scale: Array) -> None:
    fields.write("actuator_biasprm")[:, _servos(fields), 2] *= scale


def _scale_of_joints(field: str) -> Callable[[ModelFields, Array], None]:
    def scale(fields: ModelFields, values: Array) -> None:
        dofs = np.array([fields.dof(name) for name in yumi.joint_names("right")])
        fields.write(field)[:, dofs] *= values

    return scale


def _set_joint_friction(fields: ModelFields, values: Array) -> None:
    dofs = np.array([fields.dof(name) for name in yumi.joint_names("right")])
    fields.write("dof_frictionloss")[:, dofs] = values
    _make_friction_dry(fields, np.ones_like(values, dtype=np.bool_))


def _let_joints_stick(fields: ModelFields, scale: Array) -> None:
    # The friction itself depends on the speed: whoever simulates the arm sees to that.
    if np.any(scale > 1.0):
        _make_friction_dry(fields, scale > 1.0)


def _make_friction_dry(fields: ModelFields, dry: NDArray[np.bool_]) -> None:
    dofs = np.array([fields.dof(name) for name in yumi.joint_names("right")])
    for field, values in (("dof_solref", servo.DRY_SOLREF), ("dof_solimp", servo.DRY_SOLIMP)):
        written = fields.write(field)
        written[:, dofs] = np.where(dry[..., None], values, written[:, dofs])


def _scale_mass(fields: ModelFields, scale: Array) -> None:
    model = fields.model
    moved_by = np.full(model.nbody, -1)
    for index, name in enumerate(yumi.joint_names("right")):
        moved_by[model.joint(name).bodyid] = index
    # A body stands after its parent: what hangs on a link is moved by the joint of that link.
    for body in range(1, model.nbody):
        if moved_by[body] < 0:
            moved_by[body] = moved_by[model.body_parentid[body]]
    bodies = np.flatnonzero(moved_by >= 0)
    factors = scale[:, moved_by[bodies]]
    fields.write("body_mass")[:, bodies] *= factors
    fields.write("body_inertia")[:, bodies] *= factors[..., None]
    # The controller goes on to hold up what it believes to be there.
    fields.write("body_gravcomp")[:, bodies] /= factors


def _servos(fields: ModelFields) -> Array:
    return np.array([fields.model.actuator(name).id for name in yumi.joint_names("right")])


def _set_friction(fields: ModelFields, value: Array) -> None:
    # Of all geoms, because a contact takes the larger friction of its two.
    fields.write("geom_friction")[:, :, 0] = value[:, None]


SERVO_KEYS = (
    VariationKey("servo.kp_scale", 0.2, 5.0, "1", 7, _scale_stiffness),
    VariationKey("servo.kd_scale", 0.2, 5.0, "1", 7, _scale_damping),
    VariationKey(FRICTION_SCALE, 0.0, 10.0, "1", 7, _scale_of_joints("dof_frictionloss")),
    VariationKey(
        "servo.frictionloss", 0.0, 3.0, "N m", 7, _set_joint_friction, excludes=FRICTION_SCALE
    ),
    VariationKey("servo.armature_scale", 0.2, 5.0, "1", 7, _scale_of_joints("dof_armature")),
    VariationKey(DELAY_MS, 0.0, 100.0, "ms"),
    VariationKey(STICTION_SCALE, 1.0, 5.0, "1", 7, _let_joints_stick),
    VariationKey(STRIBECK_VELOCITY, 0.001, 1.0, "rad/s", 7),
    VariationKey(BACKLASH, 0.0, 0.05, "rad", 7),
)
CONTACT_KEYS = (VariationKey("contact.friction", 0.05, 2.0, "1", 1, _set_friction),)
SENSOR_KEYS = (
    VariationKey(JOINT_NOISE, 0.0, 0.05, "rad"),
    VariationKey(JOINT_OFFSET, -0.05, 0.05, "rad", 7),
    VariationKey(VELOCITY_NOISE, 0.0, 0.5, "rad/s"),
    VariationKey(EFFORT_NOISE, 0.0, 5.0, "N m"),
)
GRIPPER_KEYS = (VariationKey(OPENING_ERROR, -0.005, 0.005, "m"),)
MASS_KEYS = (VariationKey("arm.mass_scale", 0.5, 2.0, "1", 7, _scale_mass),)
"""Of the arm's links, the hand with the last."""
LINK_KEYS = (
    VariationKey(LINK_LOSS, 0.0, 0.9, "1"),
    VariationKey(LINK_DELAY_MS, 0.0, 500.0, "ms"),
    VariationKey(LINK_JITTER_MS, 0.0, 500.0, "ms"),
)
"""Of what the states of a robot server travel on: nothing that a batched simulation has."""

COMMAND_KEYS = (VariationKey(COMMAND_DELAY_MS, 0.0, 200.0, "ms"),)
"""Of a session between policy and arm, which a batched simulation has not."""

ARM_KEYS = (
    *SERVO_KEYS, *CONTACT_KEYS, *SENSOR_KEYS, *GRIPPER_KEYS, *MASS_KEYS, *LINK_KEYS, *COMMAND_KEYS,
)  # fmt: skip
"""What may vary whatever stands before the arm."""


def joint_key(
    name: str, field: str, joint: str, low: float, high: float, unit: str
) -> VariationKey:
    """A key that sets a number of a scene's joint.

    Args:
        name: `section.key`.
        field: `dof_frictionloss`, `dof_damping` or another field with a number for each degree
            of freedom.
        joint: Name in the model.
        low, high: Bounds.
        unit: Of the value.
    """

    def apply(fields: ModelFields, value: Array) -> None:
        fields.write(field)[:, fields.dof(joint)] = value

    return VariationKey(name, low, high, unit, 1, apply)


def travel_key(name: str, joint: str, low: float, high: float, unit: str) -> VariationKey:
    """A key that sets where a scene's joint meets its upper stop; arguments as `joint_key`."""

    def apply(fields: ModelFields, value: Array) -> None:
        fields.write("jnt_range")[:, fields.model.joint(joint).id, 1] = value

    return VariationKey(name, low, high, unit, 1, apply)


def mass_key(name: str, body: str, low: float, high: float) -> VariationKey:
    """A key that sets the mass of a body, kg: the same shape of another density."""

    def apply(fields: ModelFields, value: Array) -> None:
        index = fields.model.body(body).id
        nominal = fields.model.body_mass[index]
        fields.write("body_inertia")[:, index] *= (value / nominal)[:, None]
        fields.write("body_mass")[:, index] = value

    return VariationKey(name, low, high, "kg", 1, apply)


def pose_keys(
    section: str, body: str, *, shift: float = 0.05, turn_deg: float = 20.0
) -> tuple[VariationKey, ...]:
    """Keys that stand a body elsewhere than where it is believed to stand: x, y and yaw_deg.

    Args:
        section: Of the keys.
        body: Child of the world, not turned in the nominal model.
        shift: Bound of x and y, m.
        turn_deg: Bound of the turn about the vertical through the body's origin, degrees.
    """

    def shift_along(axis: int) -> Callable[[ModelFields, Array], None]:
        def apply(fields: ModelFields, value: Array) -> None:
            fields.write("body_pos")[:, fields.model.body(body).id, axis] += value

        return apply

    def turn(fields: ModelFields, value: Array) -> None:
        half = np.radians(value) / 2
        quaternion_wxyz = np.zeros((len(value), 4))
        quaternion_wxyz[:, 0], quaternion_wxyz[:, 3] = np.cos(half), np.sin(half)
        fields.write("body_quat")[:, fields.model.body(body).id] = quaternion_wxyz

    return (
        VariationKey(f"{section}.x", -shift, shift, "m", 1, shift_along(0)),
        VariationKey(f"{section}.y", -shift, shift, "m", 1, shift_along(1)),
        VariationKey(f"{section}.yaw_deg", -turn_deg, turn_deg, "deg", 1, turn),
    )
