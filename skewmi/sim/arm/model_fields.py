"""What a twin's values mean in the model and in the sensors of OpenPressClose."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import SIM_DT
from skewmi.sim.variation import Twin, TwinSample

_NEEDS_SET_CONST = {"body_mass", "body_inertia", "body_pos", "body_quat", "dof_armature"}
"""Fields that constants of the model are derived from."""

SENSOR_KEYS = (
    "sensors.joint_noise",
    "sensors.lid_bias_deg",
    "sensors.lid_noise_deg",
    "sensors.button_noise",
)


_STREAM = 1
"""Keeps the twin's random stream apart from that of the start positions."""


def random_stream(twin: Twin, seed: int) -> np.random.Generator:
    """The stream that a twin's values and sensor errors are drawn from.

    Args:
        twin: Adds its own seed.
        seed: Of the environment or of the episode.
    """
    return np.random.default_rng([seed, twin.seed, _STREAM])


def model_fields(model: mujoco.MjModel, sample: TwinSample) -> dict[str, Array]:
    """The fields of the model that differ, for every simulation.

    Args:
        model: The nominal model, not changed.
        sample: Values drawn.

    Returns:
        By name of the `MjModel` field. Each shape (n, *shape of the field).
    """
    fields: dict[str, Array] = {}

    def write(name: str) -> Array:
        if name not in fields:
            nominal = getattr(model, name)
            fields[name] = np.tile(nominal, (sample.n, *([1] * nominal.ndim)))
        return fields[name]

    joints = yumi.joint_names("right")
    servos = np.array([model.actuator(name).id for name in joints])
    dofs = np.array([int(model.joint(name).dofadr[0]) for name in joints])
    lid_dof, button_dof = (
        int(model.joint(name).dofadr[0]) for name in ("lid_hinge", "button_slide")
    )
    box, lid = model.body("box").id, model.body("lid").id
    for name, value in sample.values.items():
        match name:
            case "servo.kp_scale":
                write("actuator_gainprm")[:, servos, 0] *= value
                write("actuator_biasprm")[:, servos, 1] *= value
            case "servo.kd_scale":
                write("actuator_biasprm")[:, servos, 2] *= value
            case "servo.frictionloss_scale":
                write("dof_frictionloss")[:, dofs] *= value
            case "servo.armature_scale":
                write("dof_armature")[:, dofs] *= value
            case "lid.frictionloss":
                write("dof_frictionloss")[:, lid_dof] = value
            case "lid.damping":
                write("dof_damping")[:, lid_dof] = value
            case "lid.mass":
                # The same shape of another density: the inertia grows with the mass.
                write("body_inertia")[:, lid] *= (value / model.body_mass[lid])[:, None]
                write("body_mass")[:, lid] = value
            case "button.frictionloss":
                write("dof_frictionloss")[:, button_dof] = value
            case "button.travel":
                write("jnt_range")[:, model.joint("button_slide").id, 1] = value
            case "contact.friction":
                # Of all geoms, because a contact takes the larger friction of its two.
                write("geom_friction")[:, :, 0] = value[:, None]
            case "box_pose.x":
                write("body_pos")[:, box, 0] += value
            case "box_pose.y":
                write("body_pos")[:, box, 1] += value
            case "box_pose.yaw_deg":
                half = np.radians(value) / 2
                quaternion_wxyz = np.zeros((sample.n, 4))
                quaternion_wxyz[:, 0], quaternion_wxyz[:, 3] = np.cos(half), np.sin(half)
                write("body_quat")[:, box] = quaternion_wxyz
    return fields


def needs_set_const(fields: dict[str, Array]) -> bool:
    """Whether constants of the model have to be derived anew."""
    return not _NEEDS_SET_CONST.isdisjoint(fields)


def delay_substeps(sample: TwinSample) -> NDArray[np.int64]:
    """Delay of the servos in time steps of the physics. Shape (n,)."""
    return np.rint(sample.get("servo.delay_ms") / (SIM_DT * 1e3)).astype(np.int64)


class SensorErrors:
    """Bias, constant in an episode, and white noise of the sensors.

    Args:
        sample: Values drawn.
    """

    def __init__(self, sample: TwinSample) -> None:
        self._n = sample.n
        self._joint_noise = sample.get("sensors.joint_noise")
        self._lid_bias = np.radians(sample.get("sensors.lid_bias_deg"))
        self._lid_noise = np.radians(sample.get("sensors.lid_noise_deg"))
        self._button_noise = sample.get("sensors.button_noise")

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Errors of one reading.

        Returns:
            Of the arm joints, rad, shape (n, 7); of the lid, rad, and of the button, m, (n,).
        """
        white = rng.standard_normal((self._n, 9))
        return (
            self._joint_noise[:, None] * white[:, :7],
            self._lid_bias + self._lid_noise * white[:, 7],
            self._button_noise * white[:, 8],
        )
