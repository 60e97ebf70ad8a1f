"""Joint velocities that move the hand as wanted: mink on the commanded configuration.

Per grid step one quadratic program in the joint step dq = h v:

    min  |J dq - h (V + k e)|^2_W  +  |dq - h g (q* - q)|^2 c^2
    s.t. h v_low <= dq <= h v_high

with V the wanted hand velocity, e the pose error (shaped command less planned hand; the wanted
orientation is constant), and q* the posture that settles the one redundant joint. k and g are
rates in 1/s: mink's task gains are k h and g h. (With mink's usual gain of 1 the feedback would
be 1/h = 250/s, which a smoothed joint motion cannot follow: it diverges.) V enters through the
target, x + V / k, of which the gain k h makes h (V + k e).
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import qpsolvers

from skewmi.deploy.motion.brake import Array
from skewmi.robot_models import mjcf, yumi

FEEDBACK_RATE = 5.0
"""k, 1/s."""

POSTURE_RATE = 1.0
"""g, 1/s."""

POSITION_COST = 1.0
"""Per metre."""

ORIENTATION_COST = 0.3
"""Per radian: 0.3 m of lever, about the arm's, makes both errors comparable."""

POSTURE_COST = 3e-3
"""c per radian. It is also what damps motion near singular postures: a singular value s of the
weighted Jacobian is answered with s^2 / (s^2 + c^2) of the wanted velocity."""


def _arm_model() -> mujoco.MjModel:
    """The right arm alone, its seven joints and nothing that moves besides."""
    spec = mjcf.build_robot(left_arm="absent", collision=False, visual=False)
    for equality in list(spec.equalities):
        spec.delete(equality)
    for name in yumi.finger_names("right"):
        spec.delete(spec.joint(name))
    model = spec.compile()
    assert tuple(model.joint(i).name for i in range(model.njnt)) == yumi.joint_names("right")
    return model


class JointVelocityBounds(mink.Limit):  # type: ignore[misc]
    """h v_low <= dq <= h v_high, with bounds that the planner sets anew at each step.

    Replaces mink's velocity limit (symmetric and constant) and configuration limit (which knows
    no braking distance).
    """

    def __init__(self, joints: int) -> None:
        self._g = np.vstack([np.eye(joints), -np.eye(joints)])
        self._h = np.zeros(2 * joints)
        self._joints = joints

    def set(self, low: Array, high: Array) -> None:
        self._h[: self._joints] = high
        self._h[self._joints :] = -low

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> object:
        return mink.Constraint(G=self._g, h=dt * self._h)


class DifferentialIk:
    """Velocities of the right arm's seven joints; poses in the robot base frame.

    Args:
        posture: Preferred configuration q*, rad. Shape (7,).
        rotation: Wanted orientation, hand to base. Shape (3, 3).
        grid_dt: h, s.
    """

    def __init__(self, posture: Array, rotation: Array, grid_dt: float) -> None:
        model = _arm_model()
        self._dt = grid_dt
        self._configuration = mink.Configuration(model)
        self._hand = mink.FrameTask(
            yumi.tool_name("right"),
            "site",
            position_cost=POSITION_COST,
            orientation_cost=ORIENTATION_COST,
            gain=FEEDBACK_RATE * grid_dt,
        )
        self._posture = mink.PostureTask(model, cost=POSTURE_COST, gain=POSTURE_RATE * grid_dt)
        self._posture.set_target(posture)
        self._bounds = JointVelocityBounds(model.nv)
        self._rotation = mink.SO3.from_matrix(np.asarray(rotation, dtype=np.float64))
        self._site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, yumi.tool_name("right"))
        self._tasks = (self._hand, self._posture)

    def place(self, q: Array) -> Array:
        """Put the model at `q` and return the hand's position, base frame, m. Shape (3,)."""
        self._configuration.update(q)
        position: Array = self._configuration.data.site_xpos[self._site].copy()
        return position

    def solve(self, position: Array, velocity: Array, low: Array, high: Array) -> Array | None:
        """Joint velocities at the configuration of the last `place`.

        Args:
            position: Where the hand should be now, base frame, m. Shape (3,).
            velocity: How it should move, m/s. Shape (3,).
            low: Lowest joint velocities, rad/s. Shape (7,).
            high: Highest. Shape (7,).

        Returns:
            rad/s, shape (7,); None if the solver fails (then the planner brakes).
        """
        target = position + velocity / FEEDBACK_RATE
        self._hand.set_target(mink.SE3.from_rotation_and_translation(self._rotation, target))
        self._bounds.set(low, high)
        problem = mink.build_ik(
            self._configuration, self._tasks, self._dt, damping=0.0, limits=[self._bounds]
        )
        result = qpsolvers.solve_problem(problem, solver="daqp")
        if not result.found or result.x is None or not np.isfinite(result.x).all():
            return None
        velocities: Array = result.x / self._dt
        return velocities
