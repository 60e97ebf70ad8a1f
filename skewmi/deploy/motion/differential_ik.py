"""Joint velocities that move the hand as wanted: mink on the commanded configuration.

Per grid step one quadratic program in the joint step dq = h v:

    min  |J dq - h (V + k e)|^2_W  +  |dq - h g (q* - q)|^2 c^2
    s.t. h v_low <= dq <= h v_high,   J_p dq <= h u along the faces that the hand is beyond

with V the wanted hand velocity, e the pose error (shaped command less planned hand; the wanted
orientation is constant), and q* the posture that settles the one redundant joint. k and g are
rates in 1/s: mink's task gains are k h and g h. (With mink's usual gain of 1 the feedback would
be 1/h = 250/s, which a smoothed joint motion cannot follow: it diverges.) V enters through the
target, x + V / k, of which the gain k h makes h (V + k e).

Where the hand does not get to where it should be, because a joint is at its bound or the posture
nearly singular, the program above may turn in circles: it is the step of a Gauss-Newton method
whose residual does not vanish, which is stable only with a damping of about residual times
curvature. So there the posture's weight grows with the hand's distance d from where it should be,

    c^2 = c0^2 + p w max(0, d - 1 mm),

and p with the time for which the hand has waited there in vain, until the arm gives way, towards
the posture, from where the hand can go everywhere in its box.

Beyond a face of its box, in the tolerance, the hand may only move outwards as fast as it can stop
there (u, from the planner), whatever else the program is after: it would put a tilt right at the
price of some millimetres, be refused, and try the same again. Where joints at their bounds leave no
way inwards as fast as wanted, u = 0, which rest always meets.

mink gives kinematics and the weighted hand task; the program itself is put together here, since its
posture is a diagonal and its bounds are on single joints, and handed to daqp. A test compares with
`mink.solve_ik`, which takes twice as long.
"""

from __future__ import annotations

from functools import cache

import daqp
import mujoco
import numpy as np

from skewmi.deploy.motion.brake import Array
from skewmi.deploy.motion.mink_alone import import_mink
from skewmi.robot_models import mjcf, yumi
from skewmi.robot_models.base_frame import BaseFrame
from skewmi.trajectory import GRID_S

mink = import_mink()

FEEDBACK_RATE = 5.0
"""Largest k, 1/s."""

POSTURE_RATE = 1.0
"""g, 1/s."""

POSITION_COST = 1.0
"""Per metre."""

ORIENTATION_COST = 0.3
"""Per radian: 0.3 m of lever, about the arm's, makes both errors comparable."""

POSTURE_COST = 3e-3
"""c0 per radian. It is also what damps motion near singular postures: a singular value s of the
weighted Jacobian is answered with s^2 / (s^2 + c^2) of the wanted velocity."""

GIVING_WAY = 0.5
"""w, metres per square radian: about the curvature of the hand's paths."""

GIVING_WAY_FROM = 1e-3
"""Distance of the hand from where it should be up to which c = c0, m. In motion it is 0.3 mm."""

PATIENCE_S = 0.2
"""The time of waiting in vain that doubles p."""

MAX_WAIT_S = 20.0

AT_REST = 1e-3
"""Wanted speed below which the hand is waited for, m/s."""


_SENSE = np.zeros(13, dtype=np.intc)
"""daqp's kind of each bound: an inequality. Of seven joints and six directions of the hand."""


@cache
def _arm_model() -> mujoco.MjModel:
    """The right arm alone, its seven joints and nothing that moves besides. Not to be changed."""
    spec = mjcf.build_robot(left_arm="absent", collision=False, visual=False)
    for equality in list(spec.equalities):
        spec.delete(equality)
    for name in yumi.finger_names("right"):
        spec.delete(spec.joint(name))
    model = spec.compile()
    assert tuple(model.joint(i).name for i in range(model.njnt)) == yumi.joint_names("right")
    return model


class DifferentialIk:
    """Velocities of the right arm's seven joints; poses in the robot base frame.

    Args:
        posture: Preferred configuration q*, rad. Shape (7,).
        rotation: Wanted orientation, hand to task. Shape (3, 3).
        base: The robot base in the task's frame, along whose axes faces are; None for its own.
    """

    def __init__(self, posture: Array, rotation: Array, base: BaseFrame | None = None) -> None:
        base = BaseFrame((0.0, 0.0, 0.0)) if base is None else base
        model = _arm_model()
        self._configuration = mink.Configuration(model)
        self._site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, yumi.tool_name("right"))
        self._hand = mink.FrameTask(
            self._site,
            "site",
            position_cost=POSITION_COST,
            orientation_cost=ORIENTATION_COST,
            gain=FEEDBACK_RATE * GRID_S,
        )
        self._posture = np.array(posture, dtype=np.float64)
        self._quaternion_wxyz = mink.SO3.from_matrix(
            base.rotations_to_base(np.asarray(rotation, dtype=np.float64))
        ).wxyz
        self._turned = None if base.yaw == 0.0 else base.rotation
        self._waited_s = 0.0
        self._no_rows = np.zeros((0, model.nv))
        self._position_jacobian = np.zeros((3, model.nv))

    def reset(self) -> None:
        """Forget how long the hand has been waited for."""
        self._waited_s = 0.0

    def place(self, q: Array) -> Array:
        """Put the model at `q` and return the hand's position, base frame, m. Shape (3,)."""
        self._configuration.update(q)
        position: Array = self._configuration.data.site_xpos[self._site].copy()
        return position

    def solve(
        self,
        position: Array,
        velocity: Array,
        low: Array,
        high: Array,
        feedback_rate: float = FEEDBACK_RATE,
        outwards: Array | None = None,
    ) -> Array | None:
        """Joint velocities at the configuration of the last `place`.

        Args:
            position: Where the hand should be now, base frame, m. Shape (3,).
            velocity: How it should move, m/s. Shape (3,).
            low: Lowest joint velocities, rad/s. Shape (7,).
            high: Highest. Shape (7,).
            feedback_rate: k, 1/s.
            outwards: Highest hand velocities in the directions -x, -y, -z, x, y, z of the task,
                m/s; infinite for none, negative for a way back. Shape (6,).

        Returns:
            rad/s, shape (7,); None if the solver fails (then the planner brakes).
        """
        target = np.concatenate((self._quaternion_wxyz, position + velocity / feedback_rate))
        self._hand.gain = feedback_rate * GRID_S
        self._hand.set_target(mink.SE3(wxyz_xyz=target))
        jacobian, error, _ = self._hand.compute_qp_residual(self._configuration)
        cost = POSTURE_COST * POSTURE_COST + self._giving_way(position, velocity)
        hessian = jacobian.T @ jacobian
        hessian.flat[:: len(self._posture) + 1] += cost
        to_posture = self._posture - self._configuration.data.qpos
        gradient = -(error @ jacobian) - (cost * POSTURE_RATE * GRID_S) * to_posture
        program = hessian, gradient, GRID_S * low, GRID_S * high
        if outwards is None:
            return _velocities(*program, self._no_rows)
        rows, most = self._face_rows(outwards)
        velocities = _velocities(*_with_rows(*program, rows, GRID_S * most))
        if velocities is None and (most < 0.0).any():
            most = np.maximum(most, 0.0)
            velocities = _velocities(*_with_rows(*program, rows, GRID_S * most))
        return velocities

    def _face_rows(self, outwards: Array) -> tuple[Array, Array]:
        """Rows n . J_p of the directions n with a bound, and their bounds, m/s."""
        data = self._configuration.data
        mujoco.mj_jacSite(
            self._configuration.model, data, self._position_jacobian, None, self._site
        )
        bounded = np.isfinite(outwards)
        jacobian = self._position_jacobian
        along = jacobian if self._turned is None else self._turned @ jacobian
        rows = np.concatenate((-along, along))[bounded]
        return np.ascontiguousarray(rows), outwards[bounded]

    def _giving_way(self, position: Array, velocity: Array) -> float:
        """What is added to c0^2 where the hand cannot follow, and count the time."""
        away = position - self._configuration.data.site_xpos[self._site]
        excess = float(np.sqrt(away @ away)) - GIVING_WAY_FROM
        waiting = excess > 0.0 and velocity @ velocity < AT_REST * AT_REST
        self._waited_s += GRID_S if waiting else -GRID_S
        self._waited_s = min(max(self._waited_s, 0.0), MAX_WAIT_S)
        return (1.0 + self._waited_s / PATIENCE_S) * GIVING_WAY * max(0.0, excess)


def _velocities(
    hessian: Array, gradient: Array, low: Array, high: Array, rows: Array
) -> Array | None:
    """Solve for a joint step with `low <= (step, rows @ step) <= high`; rad/s, or None."""
    step, _, flag, _ = daqp.solve(hessian, gradient, rows, high, low, _SENSE[: high.size])
    if flag <= 0 or not np.isfinite(step).all():
        return None
    velocities: Array = step / GRID_S
    return velocities


def _with_rows(
    hessian: Array, gradient: Array, low: Array, high: Array, rows: Array, most: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """A program of bounds on single joints with `rows @ step <= most` besides."""
    low = np.concatenate((low, np.full(most.size, -np.inf)))
    return hessian, gradient, low, np.concatenate((high, most)), rows
