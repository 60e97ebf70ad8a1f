"""What a planner cycle would take if it were nothing but calls of the libraries it uses.

For the same chunk as the cycle: mink's whole inverse kinematics, ruckig's trajectories and
Pinocchio's dynamics, kinematics and Jacobians, as often as the cycle needs them, with inputs laid
ready. Three stages are no library's (the closed-form stop, the checks of `limits.py`, the batched
kinematics of the position guard): they are called as they are.
"""

from __future__ import annotations

from collections.abc import Callable

import mink
import numpy as np
import pinocchio
import ruckig
from numpy.typing import NDArray
from planner_timing import StageTimes

from skewmi.deploy.motion.differential_ik import (
    FEEDBACK_RATE,
    ORIENTATION_COST,
    POSITION_COST,
    POSTURE_COST,
    POSTURE_RATE,
)
from skewmi.deploy.motion.joint_shaper import JointShaper
from skewmi.deploy.safety.guard import FEW_SAMPLES, LEVER
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.policy_io import Workspace
from skewmi.robot_models import mjcf, urdf, yumi
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_TICKS, GRID_S, JointPoint, JointTrajectory

Array = NDArray[np.float64]

LIBRARIES = ("mink", "ruckig", "pinocchio")
OWN = ("stop", "check", "position_guard")


class BareMink:
    """`mink.solve_ik` on the right arm, with mink's own velocity limit."""

    def __init__(self, workspace: Workspace, bounds: JointLimits) -> None:
        spec = mjcf.build_robot(left_arm="absent", collision=False, visual=False)
        for equality in list(spec.equalities):
            spec.delete(equality)
        for name in yumi.finger_names("right"):
            spec.delete(spec.joint(name))
        model = spec.compile()
        self.configuration = mink.Configuration(model)
        self.hand = mink.FrameTask(
            yumi.tool_name("right"),
            "site",
            position_cost=POSITION_COST,
            orientation_cost=ORIENTATION_COST,
            gain=FEEDBACK_RATE * GRID_S,
        )
        self.posture = mink.PostureTask(model, cost=POSTURE_COST, gain=POSTURE_RATE * GRID_S)
        self.posture.set_target(np.array(workspace.start_configuration))
        speeds = dict(zip(yumi.joint_names("right"), bounds.velocity.tolist(), strict=True))
        self.limits = [mink.VelocityLimit(model, speeds)]
        rotation = rotation_from_quaternion(workspace.hand_quaternion_wxyz)
        self._rotation = mink.SO3.from_matrix(rotation)

    def target(self, position: Array) -> mink.SE3:
        return mink.SE3.from_rotation_and_translation(self._rotation, position)

    def solve(self, q: Array, target: mink.SE3) -> Array:
        self.configuration.update(q)
        self.hand.set_target(target)
        return mink.solve_ik(
            self.configuration,
            (self.hand, self.posture),
            GRID_S,
            "daqp",
            damping=0.0,
            limits=self.limits,
        )


def _ruckig(axes: int, acceleration: Array, jerk: Array) -> Callable[[list[list[float]]], None]:
    """A bare step towards a velocity: position, velocity, acceleration, target."""
    otg, trajectory = ruckig.Ruckig(axes), ruckig.Trajectory(axes)
    plan = ruckig.InputParameter(axes)
    plan.control_interface = ruckig.ControlInterface.Velocity
    plan.synchronization = ruckig.Synchronization.Phase
    plan.max_acceleration, plan.max_jerk = acceleration.tolist(), jerk.tolist()

    def step(state: list[list[float]]) -> None:
        plan.current_position, plan.current_velocity, plan.current_acceleration = state[:3]
        plan.target_velocity = state[3]
        otg.calculate(plan, trajectory)
        trajectory.at_time(GRID_S)

    return step


class BareCalls:
    """The calls of one cycle, on a chunk that was planned."""

    def __init__(self, workspace: Workspace, bounds: JointLimits) -> None:
        self._mink = BareMink(workspace, bounds)
        self._joints = JointShaper(bounds)
        self._seven = _ruckig(7, self._joints.acceleration, self._joints.jerk)
        self._three = _ruckig(3, self._joints.acceleration[:3], self._joints.jerk[:3])
        self._model = pinocchio.buildModelFromXML(urdf.build_urdf(arms=("right",)))
        self._data = self._model.createData()
        joints = [self._model.getJointId(name) for name in yumi.joint_names("right")]
        self._columns = [self._model.joints[joint].idx_q for joint in joints]
        self._tool = self._model.getFrameId(yumi.tool_name("right"))
        self._rotation = rotation_from_quaternion(workspace.hand_quaternion_wxyz)
        self._weights = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])[:, None]
        self._kinematics = ArmKinematics("right")
        self._checker = ChunkChecker(bounds, workspace, self._kinematics.forward)

    def run(
        self,
        chunk: JointTrajectory,
        state: JointPoint,
        earlier: Array,
        times: StageTimes,
    ) -> None:
        """Time every library's calls for the cycle that planned `chunk` from `state`, at which the
        three positions `earlier` led."""
        q, v, a = chunk.q, chunk.v, chunk.a
        position, _ = self._kinematics.forward(q[: CYCLE_TICKS + 1])
        targets = [self._mink.target(p) for p in position[1:] + 0.01]
        with times.of("mink"):
            for k in range(CYCLE_TICKS):
                self._mink.solve(q[k], targets[k])
        seven = [[x.tolist() for x in (q[k], v[k], a[k], v[k + 1])] for k in range(CYCLE_TICKS)]
        three = [[x[:3] for x in step] for step in seven]
        with times.of("ruckig"):
            for small, large in zip(three, seven, strict=True):
                # Twice: where the hand would come to, and where it goes.
                self._three(small)
                self._three(small)
                self._seven(large)
        full = np.tile(pinocchio.neutral(self._model), (3, len(q), 1))
        full[1:] = 0.0
        for part, samples in zip(full, (q, v, a), strict=True):
            part[:, self._columns] = samples
        with times.of("pinocchio"):
            self._pinocchio(*full)
        self._joints.point = chunk.point(CYCLE_TICKS)
        with times.of("stop"):
            stop = self._joints.stop()
            stop.sample(GRID_S)
            stop.extent()
        with times.of("check"):
            self._checker.check(q, v, a, state, earlier=earlier)
        with times.of("position_guard"):
            self._kinematics.forward(q)

    def _pinocchio(self, q: Array, v: Array, a: Array) -> None:
        """What the guard needs; distances not, which the median cycle does not measure."""
        model, data, tool = self._model, self._data, self._tool
        for k in np.unique(np.linspace(0, len(q) - 1, FEW_SAMPLES).round().astype(int)):
            pinocchio.rnea(model, data, q[k], v[k], a[k])
            pinocchio.forwardKinematics(model, data, q[k])
            pose = pinocchio.updateFramePlacement(model, data, tool)
            pinocchio.log3(self._rotation.T @ pose.rotation)
        for k in (CYCLE_TICKS, len(q) - 1):
            frame = pinocchio.LOCAL_WORLD_ALIGNED
            jacobian = pinocchio.computeFrameJacobian(model, data, q[k], tool, frame)
            np.linalg.svd(self._weights * jacobian[:, self._columns], compute_uv=False)
