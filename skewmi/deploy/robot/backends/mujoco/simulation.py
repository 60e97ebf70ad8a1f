"""The simulated YuMi in its task's scene: one physics step per grid interval."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from skewmi.deploy.robot.backend import BackendFaultError, LinkErrors, RobotState, SceneState
from skewmi.deploy.robot.backends.mujoco.contact_meter import ContactMeter
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi
from skewmi.robot_models.feed_forward import FeedForward
from skewmi.sim import tasks
from skewmi.sim.arm.drive import Drive, Stribeck
from skewmi.sim.arm.model_fields import model_fields
from skewmi.sim.arm.scene import ArmScene, hand_rotation, workspace_of
from skewmi.sim.arm.sensors import SensorErrors, random_stream
from skewmi.sim.arm.variation_keys import (
    LINK_DELAY_MS,
    LINK_JITTER_MS,
    LINK_LOSS,
    OPENING_ERROR,
    STICTION_SCALE,
)
from skewmi.sim.variation import VariationSample
from skewmi.trajectory import GRID_S, JointPoint

_REST = np.zeros(7)


class ArmSimulation:
    """Arm, gripper and scene of a task in MuJoCo.

    The servos and the contact of the training simulation. `step` costs about 0.1 ms.

    Args:
        task: Whose scene; the registry's default if not given.
        start_configuration: Where the arm is at first, rad, shape (7,); the task's start
            configuration if not given. A reset always goes to the task's.
        variation: How robot and scene differ from the nominal ones: a variation file, a bundled
            name, or JSON. Its values are drawn at each reset from the seed of that reset.
            Shapes for replays stay nominal, as does all that the session is told; where they
            stand is told for pictures alone.
        feed_forward: Of the arm's servos, if they are known; the nominal ones' if not given.
        box: Where a calibration has the task's box, see `ArmScene`: the arm starts before it there.

    Attributes:
        nominal_model: The model without what the variation changes: what is believed of it. Not to
            be written to.
        link_errors: What the variation says of the way to the session, as the last reset drew it;
            None if nothing. Whoever publishes the states sees to it.

    Raises:
        NotFoundError: The task has no scene with a robot, or there is no such variation file.
        ConfigurationError: The scene's time step does not divide the grid, or the variation is
            not valid.
    """

    def __init__(
        self,
        task: str | None = None,
        start_configuration: Array | None = None,
        variation: str | None = None,
        feed_forward: FeedForward | None = None,
        box: tuple[float, float, float] | None = None,
    ) -> None:
        self.task = tasks.default() if task is None else task
        self.spec = tasks.find(self.task)
        if self.spec.arm is None:
            raise NotFoundError(
                f"no simulated robot for task {self.task!r}; there is one for "
                f"{', '.join(tasks.with_arm())}"
            )
        self.scene = ArmScene(self.spec.arm, box)
        self.layout: PolicyLayout = self.scene.placed(self.spec.layout())
        self._data = mujoco.MjData(self.scene.model)
        self._substeps = round(GRID_S / self.scene.model.opt.timestep)
        if abs(self._substeps * self.scene.model.opt.timestep - GRID_S) > 1e-12:
            raise ConfigurationError(
                f"the scene's time step {self.scene.model.opt.timestep} s does not divide the "
                f"robot server's grid of {GRID_S} s"
            )
        self._finger_dof = np.array(
            [int(self.scene.model.joint(name).dofadr[0]) for name in yumi.finger_names("right")]
        )
        workspace = workspace_of(self.layout)
        self._hand_site = int(self.scene.model.site(yumi.tool_name("right")).id)
        self.contact = ContactMeter(
            np.array(workspace.low),
            np.array(workspace.high),
            hand_rotation(workspace),
            self.scene.base,
        )
        self._feed_forward = feed_forward
        self._variation = self.spec.variations.resolve(variation)
        self.nominal_model = copy.copy(self.scene.model)
        self._opening_error = 0.0
        self._stribeck: Stribeck | None = None
        self.reset(seed=0)
        if start_configuration is not None:
            self._data.qpos[self.scene.arm_qpos] = start_configuration
            self._data.ctrl[self.scene.arm_ctrl] = start_configuration
            self._hold(start_configuration)
            mujoco.mj_forward(self.scene.model, self._data)

    def robot_state(self, time_ns: int) -> RobotState:
        """Present positions, velocities and servo forces, of the arm and then of the fingers.

        They have the variation's sensor errors, one draw a step.
        """
        data, scene = self._data, self.scene
        arm = data.qpos[scene.arm_qpos]
        if self._errors is not None:
            arm = arm + self._errors[0][0]
        first, second = data.qpos[scene.finger_qpos].tolist()
        position = _appended(arm, 0.5 * (first + second))
        first, second = data.qvel[self._finger_dof].tolist()
        velocity = _appended(data.qvel[scene.arm_dof], 0.5 * (first + second))
        force = data.actuator_force
        effort = _appended(force[scene.arm_ctrl], force[scene.finger_ctrl])
        if self._rate_errors is not None:
            velocity[:7] += self._rate_errors[0][0]
            effort[:7] += self._rate_errors[1][0]
        return RobotState(time_ns, position, velocity, effort)

    def scene_state(self) -> SceneState:
        """Present positions, with the variation's sensor errors, and velocities of the scene."""
        data, scene = self._data, self.scene
        position = data.qpos[scene.scene_qpos]
        if self._errors is not None:
            position = position + self._errors[1][0]
        return SceneState(scene.task.joint_names, position, data.qvel[scene.scene_dof])

    def rest_at(self, q: Array) -> None:
        """The command steps to `q`, shape (7,), rad, and rests: feed-forward begins there anew."""
        if self._feed_forward is not None:
            self._feed_forward.start(q)

    def step(self) -> None:
        """Follow the servo target `command.q`, with feed-forward from `command.v`, for 4 ms.

        Raises:
            BackendFaultError: MuJoCo found a state that is not physical.
        """
        controls = self.scene.controls(self.command.q, 0.0, self.command.v)
        if (law := self._feed_forward) is not None:
            controls[self.scene.arm_ctrl] = law.step(self.command.q, self.command.v)
        controls[self.scene.finger_ctrl] = self._finger_target
        self._data.ctrl[:] = self._drive.arriving(controls)
        if self._stribeck is not None:
            dofs = self.scene.arm_dof
            friction = self._stribeck.friction(self._data.qvel[None, dofs])
            self.scene.model.dof_frictionloss[dofs] = friction[0]
        mujoco.mj_step(self.scene.model, self._data, self._substeps)
        self._check()
        self._read_sensors()
        # The true pose, not what the sensors say.
        self.contact.add(
            self._data.sensordata[self.scene.hand_force],
            self._data.sensordata[self.scene.arm_force],
            self._data.site_xpos[self._hand_site],
            self._data.site_xmat[self._hand_site],
        )

    def _check(self) -> None:
        raised = []
        for index in range(mujoco.mjtWarning.mjNWARNING.value):
            if self._data.warning[index].number:
                raised.append(mujoco.mjtWarning(index).name)
                # Told once: a fault that was acknowledged is over.
                self._data.warning[index].number = 0
        if raised:
            raise BackendFaultError(f"the simulation raised {', '.join(raised)}")

    def open_gripper(self, opening: float) -> None:
        """Move each finger to `opening` m from closed."""
        self._finger_target = opening + self._opening_error

    def reset(self, seed: int) -> Array:
        """Scene as the task begins, arm at its start configuration, commanded to stay there.

        Args:
            seed: Of the variation's values and sensor errors.

        Returns:
            Where the arm rests. Shape (7,), rad.
        """
        self._sample: VariationSample | None = None
        if not self._variation.is_nominal:
            self._rng = random_stream(self._variation, seed)
            self._sample = self._variation.sample(self._rng, 1)
            self._write_model(self._sample)
        self.scene.reset(self._data, layout=self.layout)
        self._sensors: SensorErrors | None = None
        self.link_errors: LinkErrors | None = None
        if self._sample is not None:
            self._sensors = SensorErrors(self._sample, self.scene.task)
            self.link_errors = _link_errors(self._sample, (seed, self._variation.seed))
            self._opening_error = float(self._sample.get(OPENING_ERROR)[0])
            self._data.qpos[self.scene.finger_qpos] += self._opening_error
            self._data.ctrl[self.scene.finger_ctrl] += self._opening_error
            mujoco.mj_forward(self.scene.model, self._data)
        start = np.array(workspace_of(self.layout).start_configuration)
        q = np.array(self._data.qpos[self.scene.arm_qpos], dtype=np.float64)
        self._hold(q)
        self._read_sensors()
        self.contact.clear()
        # The start position decides; its configuration is the posture that inverse kinematics
        # of the reset starts from, so both agree unless the table of constants is wrong.
        if np.abs(q - start).max() > 1e-2:
            raise ConfigurationError(
                "the task's start configuration does not put the hand at its start position"
            )
        return q

    def _write_model(self, sample: VariationSample) -> None:
        """Make the model that of the values drawn, whatever it was before."""
        model = self.scene.model
        fields = model_fields(self.nominal_model, self.scene.task.variations.keys, sample)
        if self._variation.has(STICTION_SCALE):
            # Changed in every step: an episode starts from what it is in motion.
            sliding = fields.write("dof_frictionloss")[:, self.scene.arm_dof]
            self._stribeck = Stribeck(sample, sliding)
        for name, values in fields.values.items():
            getattr(model, name)[:] = values[0]
        if fields.needs_set_const:
            mujoco.mj_setConst(model, self._data)

    def _hold(self, q: Array) -> None:
        """Let the present controls be all that is on its way to the servos, and stay at `q`."""
        self.command = JointPoint(np.array(q), _REST, _REST)
        """What the servos follow in the next step."""
        self.rest_at(q)
        self._finger_target = float(self._data.ctrl[self.scene.finger_ctrl])
        self._drive = Drive(self._sample, self._data.ctrl, self.scene.arm_ctrl)

    def _read_sensors(self) -> None:
        self._errors = self._rate_errors = None
        if self._sensors is not None:
            self._errors = self._sensors.draw(self._rng)
            if self._sensors.rates_err:
                self._rate_errors = self._sensors.draw_rates(self._rng)


def _link_errors(sample: VariationSample, seed: tuple[int, ...]) -> LinkErrors | None:
    names = (LINK_LOSS, LINK_DELAY_MS, LINK_JITTER_MS)
    if not any(name in sample.values for name in names):
        return None
    loss, delay_ms, jitter_ms = (float(sample.get(name)[0]) for name in names)
    return LinkErrors(loss, 1e-3 * delay_ms, 1e-3 * jitter_ms, seed)


def _appended(values: Array, last: float) -> Array:
    """`numpy.append` in a fifth of its time: this runs in every cycle."""
    longer = np.empty(len(values) + 1)
    longer[:-1] = values
    longer[-1] = last
    return longer
