"""The arm with its servos, as identification simulates it: many candidates at once.

The robot's own model (`robot_models.mjcf`) without what cannot matter in free space: no shapes, no
left arm, fingers fixed to the hand, no gravity (the controller compensates it, see
`mjcf.add_position_servos`; without weight nothing is left to compensate).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import mujoco
import numpy as np
from mujoco import rollout
from mujoco.batch import Batch
from numpy.typing import NDArray

from skewmi.calibration.servo_recording import ServoRecording
from skewmi.calibration.stiction import Stiction
from skewmi.errors import ConfigurationError, SimulationError
from skewmi.robot_models import mjcf, servo, yumi
from skewmi.robot_models.servo import ServoParameters
from skewmi.robot_models.yumi import Array
from skewmi.trajectory import GRID_S, JointTrajectory

LONGEST_DELAY_S = 0.2
"""Largest delay that can be simulated, s."""


@dataclass(frozen=True)
class DelayedServo:
    """Servos whose targets reach them late."""

    parameters: ServoParameters
    delay_s: float
    """From when a command is due until it is the servos' target, s."""
    stiction: Stiction | None = None
    """What joints have more of at rest than `parameters.frictionloss`; None for nothing."""

    def __post_init__(self) -> None:
        if not (isfinite(self.delay_s) and 0.0 <= self.delay_s <= LONGEST_DELAY_S):
            raise ConfigurationError(
                f"servo delay is {self.delay_s} s; it must be within 0..{LONGEST_DELAY_S:g} s"
            )


@dataclass(frozen=True, eq=False)
class ModelledArm:
    """A compiled arm, and where its seven joints are in it, chain order."""

    model: mujoco.MjModel
    qpos: NDArray[np.intp]
    dofs: NDArray[np.intp]
    actuators: NDArray[np.intp]


class ServoModel:
    """Simulates the right arm under recorded commands.

    Args:
        velocity_lead: What the controller adds to its targets for a commanded velocity, as time:
            target = q + lead v, s. Shape (7,). kd / kp of its own nominal servos for a controller
            with velocity feed-forward (the simulated robot's), 0 for one without; kd / kp of
            `servo.DEFAULT` if not given.
        threads: That simulate candidates beside one another.
    """

    def __init__(self, velocity_lead: Array | None = None, threads: int = 1) -> None:
        if velocity_lead is None:
            velocity_lead = servo.DEFAULT.kd / servo.DEFAULT.kp
        self.velocity_lead: Array = np.array(velocity_lead, dtype=np.float64)
        if self.velocity_lead.shape != (7,) or not np.isfinite(self.velocity_lead).all():
            raise ConfigurationError(
                f"velocity_lead must be 7 finite times; got {self.velocity_lead.tolist()}"
            )
        if threads < 1:
            raise ConfigurationError(f"threads is {threads}; it must be 1 at least")
        self._model = _bare_arm()
        joints = yumi.joint_names("right")
        self._qpos = np.array([self._model.joint(name).qposadr[0] for name in joints])
        self._dof = np.array([self._model.joint(name).dofadr[0] for name in joints])
        self._actuators = np.array([self._model.actuator(name).id for name in joints])
        self._threads = threads
        self._data = [mujoco.MjData(self._model) for _ in range(threads)]

    def positions(self, candidates: Sequence[DelayedServo], recording: ServoRecording) -> Array:
        """Where each candidate is when positions were measured.

        Args:
            candidates: c of them.
            recording: Gives commands, start and times.

        Returns:
            rad. Shape (c, m, 7).

        Raises:
            SimulationError: A candidate's states are not finite.
        """
        q, v = self.states(candidates, recording.commands, recording.start)
        return between_states(q, v, recording.times_s)

    def states(
        self, candidates: Sequence[DelayedServo], commands: JointTrajectory, start: Array
    ) -> tuple[Array, Array]:
        """Positions (rad) and velocities (rad/s) at every command's time.

        They are read from the states: sensor data of a rollout are those of the step before.

        Args:
            candidates: c of them.
            commands: n samples; the arm rests before the first.
            start: Where it rests, rad. Shape (7,).

        Returns:
            Each shape (c, n, 7).

        Raises:
            SimulationError: A candidate's states are not finite.
        """
        target = commands.q + self.velocity_lead * commands.v
        late = np.array([late_targets(target, candidate.delay_s) for candidate in candidates])
        sticks = np.array([candidate.stiction is not None for candidate in candidates])
        q = np.empty((len(candidates), len(commands), 7))
        v = np.empty_like(q)
        for which, simulate in ((~sticks, self._plain), (sticks, self._sticking)):
            if which.any():
                some = [candidates[int(k)] for k in np.flatnonzero(which)]
                q[which], v[which] = simulate(some, late[which], start)
        return q, v

    def _plain(
        self, candidates: Sequence[DelayedServo], targets: Array, start: Array
    ) -> tuple[Array, Array]:
        return self.driven([candidate.parameters for candidate in candidates], targets, start)

    def _sticking(
        self, candidates: Sequence[DelayedServo], targets: Array, start: Array
    ) -> tuple[Array, Array]:
        """As `driven`, of joints whose friction is set anew before every step."""
        batch = Batch(self._model, len(candidates), self._threads)
        servos = [candidate.parameters for candidate in candidates]
        kp, kd, friction, limit, armature = (
            np.array([getattr(servo, name) for servo in servos])
            for name in ("kp", "kd", "frictionloss", "force_limit", "armature")
        )
        actuators, dofs = self._actuators, self._dof
        batch.expand("actuator_gainprm")[:, actuators, 0] = kp
        bias = batch.expand("actuator_biasprm")
        bias[:, actuators, 1], bias[:, actuators, 2] = -kp, -kd
        batch.expand("actuator_forcerange")[:, actuators] = np.stack((-limit, limit), axis=-1)
        batch.expand("dof_armature")[:, dofs] = armature
        batch.set_const()
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        qpos[:, self._qpos] = start
        loss = batch.expand("dof_frictionloss")
        own = [candidate.stiction for candidate in candidates if candidate.stiction is not None]
        every = Stiction(np.array([s.angle for s in own]), np.array([s.velocity for s in own]))
        q, v = np.empty((2, *targets.shape))
        for step in range(targets.shape[1]):
            q[:, step], v[:, step] = qpos[:, self._qpos], qvel[:, dofs]
            loss[:, dofs] = friction + kp * every.left(v[:, step])
            ctrl[:, actuators] = targets[:, step]
            batch.step()
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise SimulationError("the simulation of a servo candidate left the finite numbers")
        return q, v

    def driven(
        self, servos: Sequence[ServoParameters], targets: Array, start: Array
    ) -> tuple[Array, Array]:
        """As `states`, each of the servos with targets of its own.

        Args:
            servos: c of them.
            targets: What they get at every step, rad. Shape (c, n, 7).
            start: Where the arm rests, rad. Shape (7,).

        Returns:
            Positions (rad) and velocities (rad/s). Each shape (c, n, 7).

        Raises:
            SimulationError: States are not finite.
        """
        models = [self._with(parameters) for parameters in servos]
        nq, count, steps = self._model.nq, len(models), targets.shape[1] - 1
        first = np.zeros((count, mujoco.mj_stateSize(self._model, _FULL)))
        first[:, 1 + self._qpos] = start
        controls = np.empty((count, steps, self._model.nu))
        controls[..., self._actuators] = targets[:, :steps]
        states, _ = rollout.rollout(models, self._data, first, controls)
        states = np.concatenate((first[:, None], states), axis=1)
        if not np.isfinite(states).all():
            raise SimulationError("the simulation of a servo candidate left the finite numbers")
        return states[..., 1 + self._qpos], states[..., 1 + nq + self._dof]

    def errors(
        self, candidate: DelayedServo, commands: JointTrajectory, start: Array
    ) -> tuple[Array, Array]:
        """What a candidate's servos push by: how far targets are from positions, and velocities.

        Args:
            candidate: Of servos.
            commands: n samples; the arm rests before the first.
            start: Where it rests, rad. Shape (7,).

        Returns:
            Late targets less positions, rad, and velocities, rad/s, at every command's time. Each
            shape (n, 7).

        Raises:
            SimulationError: The candidate's states are not finite.
        """
        (q,), (v,) = self.states([candidate], commands, start)
        target = late_targets(commands.q + self.velocity_lead * commands.v, candidate.delay_s)
        return target - q, v

    def arm(self, parameters: ServoParameters) -> ModelledArm:
        """The arm with given servos, for whoever steps it."""
        return ModelledArm(self._with(parameters), self._qpos, self._dof, self._actuators)

    def _with(self, parameters: ServoParameters) -> mujoco.MjModel:
        model = copy.copy(self._model)
        model.actuator_gainprm[self._actuators, 0] = parameters.kp
        model.actuator_biasprm[self._actuators, 1] = -parameters.kp
        model.actuator_biasprm[self._actuators, 2] = -parameters.kd
        limit = parameters.force_limit
        model.actuator_forcerange[self._actuators] = np.stack((-limit, limit), axis=1)
        model.dof_frictionloss[self._dof] = parameters.frictionloss
        if not np.array_equal(model.dof_armature[self._dof], parameters.armature):
            model.dof_armature[self._dof] = parameters.armature
            # Constants of the model are derived from it.
            mujoco.mj_setConst(model, self._data[0])
        return model


_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


def late_targets(target: Array, delay_s: float) -> Array:
    """Targets at every step, late; between two of them linear. Shape (n, 7).

    A step holds its target for 4 ms. A delay that is no multiple of that is the mean of its two
    neighbours, which makes positions a continuous function of the delay.
    """
    whole, part = divmod(delay_s / GRID_S, 1.0)
    index = np.arange(len(target)) - int(whole)
    late: Array = (1.0 - part) * target[np.maximum(index, 0)]
    late += part * target[np.maximum(index - 1, 0)]
    return late


def between_states(q: Array, v: Array, times_s: Array) -> Array:
    """Positions between steps, by the cubic through two states: as exact as the steps.

    Args:
        q, v: At every step, rad and rad/s. Shape (c, n, 7).
        times_s: s from the first step on. Shape (m,).

    Returns:
        rad. Shape (c, m, 7).
    """
    at = times_s / GRID_S
    index = np.clip(np.floor(at + 1e-6).astype(np.int64), 0, q.shape[1] - 2)
    u = np.clip(at - index, 0.0, 1.0)[:, None]
    q0, q1 = q[:, index], q[:, index + 1]
    v0, v1 = GRID_S * v[:, index], GRID_S * v[:, index + 1]
    rest = q1 - q0
    between: Array = q0 + u * (v0 + u * ((3.0 * rest - 2.0 * v0 - v1) + u * (v0 + v1 - 2.0 * rest)))
    return between


def _bare_arm() -> mujoco.MjModel:
    spec = mjcf.build_robot(left_arm="absent", collision=False, visual=False)
    mjcf.add_position_servos(spec, servo.DEFAULT)
    fingers = yumi.finger_names("right")
    spec.delete(spec.actuator(fingers[0]))
    for equality in list(spec.equalities):
        spec.delete(equality)
    for name in fingers:
        spec.delete(spec.joint(name))
    for name in yumi.joint_names("right"):
        joint = spec.joint(name)
        joint.solref_friction, joint.solimp_friction = servo.DRY_SOLREF, servo.DRY_SOLIMP
    spec.option.timestep = GRID_S
    spec.option.gravity = (0.0, 0.0, 0.0)
    return spec.compile()
