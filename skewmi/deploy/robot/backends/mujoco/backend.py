"""The simulated YuMi: the task's MuJoCo scene as a robot backend, one physics step per tick."""

from __future__ import annotations

import copy
from collections import deque

import mujoco
import numpy as np

from skewmi.deploy.robot.backend import BackendFaultError, Measurement
from skewmi.deploy.robot.backends.mujoco.contact_meter import ContactMeter
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.errors import CommandRefusedError, ConfigurationError, NotFoundError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi
from skewmi.sim import tasks
from skewmi.sim.arm.definition import FINGER_MAX
from skewmi.sim.arm.model_fields import model_fields
from skewmi.sim.arm.scene import ArmScene, hand_rotation, workspace_of
from skewmi.sim.arm.sensors import SensorErrors, delay_substeps, random_stream
from skewmi.sim.arm.variation_keys import OPENING_ERROR
from skewmi.sim.variation import VariationSample
from skewmi.trajectory import GRID_S, JointPoint


class MujocoBackend:
    """Arm, gripper and scene of a task in MuJoCo; satisfies `RobotBackend`.

    The servos and the contact of the training simulation, stepped by one 4 ms step per tick
    with the tick's joint target. `step` costs about 0.1 ms.

    Args:
        task: Whose scene; the registry's default if not given.
        start_configuration: Where the arm is at first, rad, shape (7,); the task's start
            configuration if not given. A scene reset always goes to the task's.
        variation: How robot and scene differ from the nominal ones: a variation file, a bundled
            name, or JSON. Its values are drawn at each scene reset from the seed of that reset.
            Shapes for replays stay nominal, as does all that the robot is told.

    Raises:
        NotFoundError: The task has no scene with a robot, or there is no such variation file.
        ConfigurationError: The scene's time step does not divide the grid, or the variation is
            not valid.
    """

    name = "sim"
    simulated = True

    def __init__(
        self,
        task: str | None = None,
        start_configuration: Array | None = None,
        variation: str | None = None,
    ) -> None:
        self.task = tasks.default() if task is None else task
        spec = tasks.find(self.task)
        if spec.arm is None:
            raise NotFoundError(
                f"no simulated robot for task {self.task!r}; there is one for "
                f"{', '.join(tasks.with_arm())}"
            )
        self.layout: PolicyLayout = spec.layout()
        self.layout_hashes = tuple(layout.hash() for _, layout in spec.layouts())
        self.joint_names = yumi.joint_names("right")
        self.scene = ArmScene(spec.arm)
        self.scene_json = scene_geometry(self.scene.model, spec.scene_fields).to_json()
        self._data = mujoco.MjData(self.scene.model)
        self._substeps = round(GRID_S / self.scene.model.opt.timestep)
        if abs(self._substeps * self.scene.model.opt.timestep - GRID_S) > 1e-12:
            raise ConfigurationError(
                f"the scene's time step {self.scene.model.opt.timestep} s does not divide the "
                f"robot server's grid of {GRID_S} s"
            )
        self._names = (*self.joint_names, yumi.finger_names("right")[0])
        self._finger_dof = np.array(
            [int(self.scene.model.joint(name).dofadr[0]) for name in yumi.finger_names("right")]
        )
        workspace = workspace_of(self.layout)
        self._hand_site = int(self.scene.model.site(yumi.tool_name("right")).id)
        self._contact = ContactMeter(
            np.array(workspace.low), np.array(workspace.high), hand_rotation(workspace)
        )
        self._variation = spec.variations.resolve(variation)
        self._nominal_model = copy.copy(self.scene.model)
        self._opening_error = 0.0
        self.reset_scene(seed=0)
        if start_configuration is not None:
            self._data.qpos[self.scene.arm_qpos] = start_configuration
            self._data.ctrl[self.scene.arm_ctrl] = start_configuration
            self._hold()
            mujoco.mj_forward(self.scene.model, self._data)

    def arm_position(self) -> Array:
        """Measured arm joints, rad, with the sensor errors of the tick. Shape (7,)."""
        arm: Array = self._data.qpos[self.scene.arm_qpos]
        return arm if self._errors is None else arm + self._errors[0][0]

    def measure(self) -> Measurement:
        """Present positions, velocities and servo forces.

        Positions of arm and scene have the variation's sensor errors, one draw a tick.
        """
        data, scene = self._data, self.scene
        of_scene = data.qpos[scene.scene_qpos]
        if self._errors is not None:
            of_scene = of_scene + self._errors[1][0]
        fingers = scene.finger_qpos
        return Measurement(
            names=self._names,
            position=np.append(self.arm_position(), data.qpos[fingers].mean()),
            velocity=np.append(data.qvel[scene.arm_dof], data.qvel[self._finger_dof].mean()),
            effort=np.append(
                data.actuator_force[scene.arm_ctrl], data.actuator_force[scene.finger_ctrl]
            ),
            scene_names=scene.task.joint_names,
            scene_position=of_scene,
            scene_velocity=data.qvel[scene.scene_dof],
        )

    def step(self, target: JointPoint) -> None:
        """Follow the servo target `target.q`, with `target.v` as feed-forward, for 4 ms.

        Raises:
            BackendFaultError: MuJoCo found a state that is not physical.
        """
        controls = self.scene.controls(target.q, 0.0, target.v)
        controls[self.scene.finger_ctrl] = self._finger_target
        self._pending.append(controls)
        self._data.ctrl[:] = self._pending.popleft()
        mujoco.mj_step(self.scene.model, self._data, self._substeps)
        raised = []
        for index in range(mujoco.mjtWarning.mjNWARNING.value):
            if self._data.warning[index].number:
                raised.append(mujoco.mjtWarning(index).name)
                # Told once: a fault that was acknowledged is over.
                self._data.warning[index].number = 0
        if raised:
            raise BackendFaultError(f"the simulation raised {', '.join(raised)}")
        self._read_sensors()
        self._note_contact()

    def contact(self) -> dict[str, float]:
        """Largest forces on hand and arm, tilt and excess of the box since the scene's reset.

        Of every physics step, and of the true pose, not of what the sensors say.
        """
        return self._contact.summary()

    def _note_contact(self) -> None:
        data, scene = self._data, self.scene
        self._contact.add(
            data.sensordata[scene.hand_force],
            data.sensordata[scene.arm_force],
            data.site_xpos[self._hand_site],
            data.site_xmat[self._hand_site],
        )

    def open_gripper(self, opening: float) -> None:
        """Move each finger to `opening` m from closed.

        Raises:
            CommandRefusedError: Not an opening of the fingers.
        """
        if not 0.0 <= opening <= FINGER_MAX:
            raise CommandRefusedError(
                f"finger opening {opening:.4g} m is outside 0..{FINGER_MAX:g} m"
            )
        self._finger_target = opening + self._opening_error

    def reset_scene(self, seed: int) -> Array:
        """Scene as the task begins, arm at its start configuration.

        Args:
            seed: Of the variation's values and sensor errors.

        Returns:
            Where the arm rests. Shape (7,), rad.
        """
        sample: VariationSample | None = None
        if not self._variation.is_nominal:
            self._rng = random_stream(self._variation, seed)
            sample = self._variation.sample(self._rng, 1)
            self._write_model(sample)
        self.scene.reset(self._data, layout=self.layout)
        self._sensors: SensorErrors | None = None
        self._delay = 0
        if sample is not None:
            self._sensors = SensorErrors(sample, self.scene.task)
            self._delay = int(delay_substeps(sample)[0]) // self._substeps
            self._opening_error = float(sample.get(OPENING_ERROR)[0])
            self._data.qpos[self.scene.finger_qpos] += self._opening_error
            self._data.ctrl[self.scene.finger_ctrl] += self._opening_error
            mujoco.mj_forward(self.scene.model, self._data)
        self._hold()
        self._read_sensors()
        self._contact.clear()
        start = np.array(workspace_of(self.layout).start_configuration)
        q = self._data.qpos[self.scene.arm_qpos].copy()
        # The start position decides; its configuration is the posture that inverse kinematics
        # of the reset starts from, so both agree unless the table of constants is wrong.
        if np.abs(q - start).max() > 1e-2:
            raise ConfigurationError(
                "the task's start configuration does not put the hand at its start position"
            )
        return np.asarray(q, dtype=np.float64)

    def _write_model(self, sample: VariationSample) -> None:
        """Make the model that of the values drawn, whatever it was before."""
        model = self.scene.model
        fields = model_fields(self._nominal_model, self.scene.task.variations.keys, sample)
        for name, values in fields.values.items():
            getattr(model, name)[:] = values[0]
        if fields.needs_set_const:
            mujoco.mj_setConst(model, self._data)

    def _hold(self) -> None:
        """Let the present controls be all that is on its way to the servos."""
        self._finger_target = float(self._data.ctrl[self.scene.finger_ctrl])
        self._pending = deque(self._data.ctrl.copy() for _ in range(self._delay))

    def _read_sensors(self) -> None:
        self._errors = None if self._sensors is None else self._sensors.draw(self._rng)
