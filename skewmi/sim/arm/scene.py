"""The model of a task: robot and scene in one MuJoCo model, and how to read and start it.

Used by the batched environment and by the simulated robot server alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from skewmi.box_frame import box_pose, placed
from skewmi.policy_io import Array, PolicyLayout, Workspace
from skewmi.robot_models import frames, kinematics, mjcf, yumi
from skewmi.robot_models.base_frame import base_of
from skewmi.sim.arm import table
from skewmi.sim.arm.arm_task import ArmTask
from skewmi.sim.arm.definition import SIM_DT
from skewmi.sim.arm.randomization import Randomization

HAND_FORCE_SENSOR = "hand_contact_force"
"""Net contact force on hand and wrist (axis 6 and beyond), world axes, N."""
ARM_FORCE_SENSOR = "arm_contact_force"
"""Net contact force on the whole right arm with its hand, world axes, N."""

_NETFORCE = 3
"""`reduce` of a contact sensor that adds up all contacts (MJCF: reduce="netforce")."""


def build_spec(task: ArmTask) -> mujoco.MjSpec:
    """Robot with servos, table, parts, sensors: everything but what changes per episode.

    World frame: task world (table top at z = 0). Actuators: the seven arm joints, then the
    fingers, each named as its joint and commanded in rad or m.
    """
    x, y, z = frames.BASE_IN_WORLD.tolist()
    spec = mjcf.build_robot(
        fingers="hooked", left_arm="parked", collision=True, base_position=(x, y, z)
    )
    mjcf.add_position_servos(spec, task.servo)
    spec.modelname = task.name
    spec.option.timestep = SIM_DT
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.gravity = (0.0, 0.0, -9.81)
    spec.visual.global_.offwidth = 1920
    spec.visual.global_.offheight = 1080
    spec.visual.headlight.ambient = (0.25, 0.25, 0.25)
    spec.visual.headlight.diffuse = (0.25, 0.25, 0.25)

    for name in yumi.finger_names("right"):
        # A handle may pull on the hook with more than the grip force: with a soft stop the light
        # fingers would then open 4 mm further than they can.
        spec.joint(name).solref_limit = table.STIFF_LIMIT["solref_limit"]
        spec.joint(name).solimp_limit = table.STIFF_LIMIT["solimp_limit"]
    for geom in list(spec.geoms):
        # Of two geoms in contact MuJoCo takes the larger friction.
        geom.friction[0] = table.FRICTION
    table.add_table(spec)
    task.add_parts(spec)
    table.add_surroundings(spec)
    for name, body in ((HAND_FORCE_SENSOR, "yumi_link_7_r"), (ARM_FORCE_SENSOR, "yumi_link_1_r")):
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=body,
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), _NETFORCE, 1],
        )
    return spec


class ArmScene:
    """Compiled model with the addresses of everything that a task reads and writes.

    Args:
        task: What stands before the arm.
        displacement: Where a calibration has its box, x (m), y (m) and yaw_deg; None if it was not
            looked for. The models stay as they are: what is known is not what is.

    Attributes:
        task: As given.
        box: Where the box is known to stand; None if it was not looked for.
        base: The robot base in the known box's frame: that of all hand poses here, "world".
        model: The compiled model with everything to be seen; time step 4 ms.
        physics_model: The same without geoms that touch nothing. Its states are bit for bit
            those of `model`, a fifth faster: MuJoCo places every geom at every step.
        kinematics: Of the right arm.
        arm_qpos: Position addresses of the arm joints, chain order. Shape (7,).
        finger_qpos: Position addresses of the two fingers. Shape (2,).
        arm_ctrl: Actuators of the arm joints, chain order. Shape (7,).
        finger_ctrl: Actuator of the fingers.
        velocity_lead: Factor of the target velocity in `controls`, s. Shape (7,).
        scene_qpos: Position addresses of the scene's joints, as the task lists them. Shape (k,).
        scene_dof: Their velocity addresses. Shape (k,).
        hand_force, arm_force: Slices of `sensordata`, see the sensors' names.
    """

    def __init__(
        self, task: ArmTask, displacement: tuple[float, float, float] | None = None
    ) -> None:
        self.task = task
        spec = build_spec(task)
        self.model: mujoco.MjModel = spec.compile()
        for geom in list(spec.geoms):
            if geom.contype == 0 and geom.conaffinity == 0:
                spec.delete(geom)
        self.physics_model: mujoco.MjModel = spec.compile()
        self.box = box_pose(displacement, task.box_origin(self.model), task.name)
        self.base = base_of(self.box)
        self.kinematics = kinematics.ArmKinematics("right")
        joints = yumi.joint_names("right")
        fingers = yumi.finger_names("right")
        self.arm_qpos = np.array([self._qpos(name) for name in joints])
        self.arm_dof = np.array([self._dof(name) for name in joints])
        self.finger_qpos = np.array([self._qpos(name) for name in fingers])
        self.scene_qpos = np.array([self._qpos(name) for name in task.joint_names], dtype=np.int64)
        self.scene_dof = np.array([self._dof(name) for name in task.joint_names], dtype=np.int64)
        self.arm_ctrl = np.array([self.model.actuator(name).id for name in joints])
        self.finger_ctrl = int(self.model.actuator(fingers[0]).id)
        self.velocity_lead: Array = task.servo.kd / task.servo.kp
        self.hand_force = self._sensor(HAND_FORCE_SENSOR)
        self.arm_force = self._sensor(ARM_FORCE_SENSOR)

    def _qpos(self, joint: str) -> int:
        return int(self.model.joint(joint).qposadr[0])

    def _dof(self, joint: str) -> int:
        return int(self.model.joint(joint).dofadr[0])

    def _sensor(self, name: str) -> slice:
        sensor = self.model.sensor(name)
        return slice(int(sensor.adr[0]), int(sensor.adr[0] + sensor.dim[0]))

    def hand_pose(self, qpos: Array) -> tuple[Array, Array]:
        """Hand frame by forward kinematics of the joint positions, as on the robot.

        Args:
            qpos: Positions of the whole model. Shape (..., nq).

        Returns:
            Position in world, m, shape (..., 3); rotation hand to world, shape (..., 3, 3).
        """
        return self.arm_pose(qpos[..., self.arm_qpos])

    def arm_pose(self, arm_q: Array) -> tuple[Array, Array]:
        """`hand_pose` of the arm joints alone, chain order, rad. Shape (..., 7)."""
        position, rotation = self.kinematics.forward(arm_q)
        return self.base.to_task(position), self.base.rotations_to_task(rotation)

    def placed(self, layout: PolicyLayout) -> PolicyLayout:
        """A layout with the robot where it is in the known box's frame, see `box_frame.placed`."""
        return replace(layout, workspace=placed(workspace_of(layout), self.box))

    def observation_values(self, qpos: Array, hand_position_w: Array) -> dict[str, Array]:
        """Every observation field but time, for `assemble_observation`.

        Args:
            qpos: Positions of the whole model. Shape (..., nq).
            hand_position_w: From `hand_pose`. Shape (..., 3).

        Returns:
            Each shape (...), in the unit of its field.
        """
        values = {
            "hand_x": hand_position_w[..., 0],
            "hand_y": hand_position_w[..., 1],
            "hand_z": hand_position_w[..., 2],
            "gripper": qpos[..., self.finger_qpos].mean(axis=-1),
        }
        for joint, address in zip(self.task.joints, self.scene_qpos, strict=True):
            values[joint.field.name] = qpos[..., address]
        return values

    def start_positions(self, layout: PolicyLayout, hand_position_w: Array) -> Array:
        """Joint positions that begin an episode: scene as the task says, hand where asked.

        Args:
            layout: Gives start configuration, orientation and finger opening.
            hand_position_w: Where the hand starts, world, m. Shape (n, 3).

        Returns:
            Positions of the whole model. Shape (n, nq).

        Raises:
            KinematicsError: The arm cannot reach a start.
        """
        workspace = workspace_of(layout)
        start = np.tile(np.array(workspace.start_configuration), (len(hand_position_w), 1))
        qpos = np.tile(self.model.qpos0, (len(hand_position_w), 1))
        result = self._solve(workspace, hand_position_w, start)
        kinematics.require_converged(result)
        qpos[:, self.arm_qpos] = result.q
        qpos[:, self.finger_qpos] = workspace.gripper_opening
        qpos[:, self.scene_qpos] = [joint.start for joint in self.task.joints]
        return qpos

    def arm_positions(self, workspace: Workspace, hand_position_w: Array, q_near: Array) -> Array:
        """Arm joints for a hand position, hand held as the workspace says, rad.

        Args:
            workspace: Gives the orientation and the posture to prefer.
            hand_position_w: World, m. Shape (n, 3).
            q_near: Where to search from: the present command, one control step away at most.
                Shape (n, 7).

        Returns:
            Shape (n, 7).
        """
        # Two iterations leave 0.011 mm and 0.003 degrees of a full step in the worst case, a
        # tenth of what is allowed between this and the deployed solution.
        return self._solve(workspace, hand_position_w, q_near, unchecked_iterations=2).q

    def _solve(
        self,
        workspace: Workspace,
        hand_position_w: Array,
        q_near: Array,
        *,
        unchecked_iterations: int | None = None,
    ) -> kinematics.InverseResult:
        return self.kinematics.inverse(
            self.base.to_base(hand_position_w),
            self.base.rotations_to_base(hand_rotation(workspace)),
            q_near,
            posture=np.array(workspace.start_configuration),
            unchecked_iterations=unchecked_iterations,
        )

    def controls(
        self, arm_q: Array, finger_opening: Array | float, arm_velocity: Array | float = 0.0
    ) -> Array:
        """Controls of all actuators: servo targets of arm (rad) and fingers (m).

        The servos of the model know no target velocity: torque = kp (ctrl - q) - kd v. With
        ctrl = q_d + (kd / kp) v_d they become kp (q_d - q) + kd (v_d - v), which follows a
        moving target without the lag kd / kp, as the feed-forward of a robot controller does.

        Args:
            arm_q: Target positions q_d, chain order. Shape (..., 7).
            finger_opening: Travel of each finger from closed. Shape (...).
            arm_velocity: Target velocities v_d, rad/s. Shape (..., 7), or 0 at rest.

        Returns:
            Shape (..., nu).
        """
        ctrl = np.empty((*arm_q.shape[:-1], self.model.nu))
        ctrl[..., self.arm_ctrl] = arm_q + self.velocity_lead * arm_velocity
        ctrl[..., self.finger_ctrl] = finger_opening
        return ctrl

    def reset(
        self,
        data: mujoco.MjData,
        rng: np.random.Generator | None = None,
        *,
        layout: PolicyLayout | None = None,
        randomization: Randomization | None = None,
    ) -> None:
        """Write the start of an episode into one MjData, and the servo targets that hold it.

        Args:
            data: Of `model`.
            rng: Source of the start's variation; without it the start is the nominal one.
            layout: Of the task; the default layout if not given.
            randomization: What varies; the default if not given.
        """
        layout = self.placed(self.task.layout()) if layout is None else layout
        randomization = Randomization() if randomization is None else randomization
        starts = np.array([workspace_of(layout).start])
        if rng is not None:
            starts = randomization.sample_starts(layout, 1, rng)
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self.start_positions(layout, starts)[0]
        opening = workspace_of(layout).gripper_opening
        data.ctrl[:] = self.controls(data.qpos[self.arm_qpos], opening)
        mujoco.mj_forward(self.model, data)

    def read(self, data: mujoco.MjData) -> Mapping[str, float]:
        """Observation fields (without time) of one MjData, in the unit of each field."""
        hand_position_w, _ = self.hand_pose(data.qpos)
        values = self.observation_values(data.qpos, hand_position_w)
        return {name: float(value) for name, value in values.items()}


def workspace_of(layout: PolicyLayout) -> Workspace:
    """The workspace, which the layout of every task with an arm has."""
    assert layout.workspace is not None
    return layout.workspace


def hand_rotation(workspace: Workspace) -> Array:
    """Rotation hand to world in which the hand is held. Shape (3, 3)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.array(workspace.hand_quaternion_wxyz))
    return matrix.reshape(3, 3)
