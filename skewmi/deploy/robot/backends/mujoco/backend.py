"""The simulated YuMi: the task's MuJoCo scene as a robot backend, one physics step per tick."""

from __future__ import annotations

import copy
from collections import deque
from itertools import product

import mujoco
import numpy as np

from skewmi.deploy.recording.scene_geometry import SceneGeometry
from skewmi.deploy.robot.backend import BackendFaultError, Measurement
from skewmi.deploy.robot.backends.mujoco.contact_meter import ContactMeter
from skewmi.errors import CommandRefusedError, ConfigurationError, NotFoundError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi
from skewmi.sim.arm.model_fields import (
    SensorErrors,
    delay_substeps,
    model_fields,
    needs_set_const,
    random_stream,
)
from skewmi.sim.arm.scene import (
    OpenPressCloseScene,
    hand_rotation,
    workspace_of,
)
from skewmi.sim.tasks.open_press_close.definition import FINGER_MAX, make_layout
from skewmi.sim.twin import TwinSample, resolve
from skewmi.sim.variation import TwinSample, resolve
from skewmi.trajectory import GRID_S, JointPoint

SCENE_JOINTS = ("lid_hinge", "button_slide")
"""Names in the scene states: lid angle (rad), button depth (m)."""

TWIN_TASKS = ("open_press_close",)
"""Tasks whose scene has a robot in it."""


class SimTwin:
    """MuJoCo twin of arm, gripper and scene; satisfies `RobotBackend`.

    The servos and the contact of the training simulation, stepped by one 4 ms step per tick
    with the tick's joint target. `step` costs about 0.1 ms.

    Args:
        task: Whose scene.
        start_configuration: Where the arm is at first, rad, shape (7,); the task's start
            configuration if not given. A scene reset always goes to the task's.
        twin: How robot and scene differ from the nominal ones: a twin file, a bundled name, or
            JSON. Its values are drawn at each scene reset from the seed of that reset. Shapes
            for replays stay nominal, as does all that the robot is told.

    Raises:
        NotFoundError: The task has no scene with a robot, or there is no such twin file.
        ConfigurationError: The scene's time step does not divide the grid, or the twin is not
            valid.
    """

    name = "sim"
    simulated = True

    def __init__(
        self,
        task: str = "open_press_close",
        start_configuration: Array | None = None,
        twin: str | None = None,
    ) -> None:
        if task not in TWIN_TASKS:
            raise NotFoundError(
                f"no simulated robot for task {task!r}; there is one for {', '.join(TWIN_TASKS)}"
            )
        self.task = task
        self.layout: PolicyLayout = make_layout()
        self.layout_hashes = tuple(
            make_layout(gripper_action=gripper, time_input=time).hash()
            for gripper, time in product((False, True), repeat=2)
        )
        self.joint_names = yumi.joint_names("right")
        self.scene = OpenPressCloseScene()
        self.scene_json = SceneGeometry.from_model(self.scene.model).to_json()
        self._data = mujoco.MjData(self.scene.model)
        self._substeps = round(GRID_S / self.scene.model.opt.timestep)
        if abs(self._substeps * self.scene.model.opt.timestep - GRID_S) > 1e-12:
            raise ConfigurationError(
                f"the scene's time step {self.scene.model.opt.timestep} s does not divide the "
                f"robot server's grid of {GRID_S} s"
            )
        self._names = (*self.joint_names, yumi.finger_names("right")[0])
        lid, button = (self.scene.model.joint(name) for name in SCENE_JOINTS)
        self._scene_qpos = np.array([int(lid.qposadr[0]), int(button.qposadr[0])])
        self._scene_dof = np.array([int(lid.dofadr[0]), int(button.dofadr[0])])
        self._finger_dof = np.array(
            [int(self.scene.model.joint(name).dofadr[0]) for name in yumi.finger_names("right")]
        )
        workspace = workspace_of(self.layout)
        self._hand_site = int(self.scene.model.site(yumi.tool_name("right")).id)
        self._contact = ContactMeter(
            np.array(workspace.low), np.array(workspace.high), hand_rotation(workspace)
        )
        self._twin = resolve(twin)
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

        Positions of arm and scene have the twin's sensor errors, one draw a tick.
        """
        data, scene = self._data, self.scene
        lid_and_button = data.qpos[self._scene_qpos]
        if self._errors is not None:
            _, on_lid, on_button = self._errors
            lid_and_button = lid_and_button + np.array([on_lid[0], on_button[0]])
        fingers = scene.finger_qpos
        return Measurement(
            names=self._names,
            position=np.append(self.arm_position(), data.qpos[fingers].mean()),
            velocity=np.append(data.qvel[scene.arm_dof], data.qvel[self._finger_dof].mean()),
            effort=np.append(
                data.actuator_force[scene.arm_ctrl], data.actuator_force[scene.finger_ctrl]
            ),
            scene_names=SCENE_JOINTS,
            scene_position=lid_and_button,
            scene_velocity=data.qvel[self._scene_dof],
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
        """Lid shut, button up, arm at the task's start configuration.

        Args:
            seed: Of the twin's values and sensor errors.

        Returns:
            Where the arm rests. Shape (7,), rad.
        """
        sample = None
        if not self._twin.is_nominal:
            self._rng = random_stream(self._twin, seed)
            sample = self._twin.sample(self._rng, 1)
            self._write_model(sample)
        self.scene.reset(self._data, layout=self.layout)
        self._sensors: SensorErrors | None = None
        self._delay = 0
        if sample is not None:
            self._sensors = SensorErrors(sample)
            self._delay = int(delay_substeps(sample)[0]) // self._substeps
            self._opening_error = float(sample.get("gripper.opening_error")[0])
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

    def _write_model(self, sample: TwinSample) -> None:
        """Make the model that of the values drawn, whatever it was before."""
        model = self.scene.model
        fields = model_fields(self._nominal_model, sample)
        for name, values in fields.items():
            getattr(model, name)[:] = values[0]
        if needs_set_const(fields):
            mujoco.mj_setConst(model, self._data)

    def _hold(self) -> None:
        """Let the present controls be all that is on its way to the servos."""
        self._finger_target = float(self._data.ctrl[self.scene.finger_ctrl])
        self._pending = deque(self._data.ctrl.copy() for _ in range(self._delay))

    def _read_sensors(self) -> None:
        self._errors = None if self._sensors is None else self._sensors.draw(self._rng)
