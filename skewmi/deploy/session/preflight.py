"""What must agree between policy, session and robot server before the arm may move."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.description import RobotDescription, limit_values
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.policy_io import Array, PolicyLayout, Workspace
from skewmi.robot_models import yumi
from skewmi.robot_models.frames import rotation_from_quaternion
from skewmi.robot_models.kinematics import ArmKinematics, require_converged
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS, GRID_NS, JointPoint

OTHER_POSTURE = 0.5
"""Joint distance from the task's posture beyond which the start is sought from there, rad."""

_START_ITERATIONS = 50

_WAY_SAMPLES = 10
"""The guard looks at so many samples at once: few enough to be near each other."""


def check_agreement(
    layout: PolicyLayout,
    robot_model_hash: str | None,
    limits: JointLimits,
    server: RobotDescription,
) -> None:
    """Refuse to run a policy on a robot server that it was not made for.

    Args:
        layout: Of the policy.
        robot_model_hash: Of the model that the policy was trained with; None if it tells none.
        limits: That the session plans with.
        robot server: What the robot server says about itself.

    Raises:
        LayoutMismatchError: Task, layout or robot model differ.
        ConfigurationError: The session would plan beyond the robot server's limits, or their grids
            or joints differ.
    """
    if layout.task != server.task:
        raise LayoutMismatchError(
            f"the policy is for task {layout.task!r}, the robot server has {server.task!r}; "
            f"start one with `skewmi robot --task {layout.task}`"
        )
    if layout.workspace is None:
        raise LayoutMismatchError(f"task {layout.task!r} has no workspace: it needs no robot")
    if layout.hash() not in server.layout_hashes:
        raise LayoutMismatchError(
            f"the policy's layout {layout.hash()[:12]} is not one of the robot server's "
            f"({', '.join(h[:12] for h in server.layout_hashes)}); it was exported with another "
            "version of the task: train or export it again"
        )
    ours = yumi.MODEL_HASH
    for whose, model in (("policy", robot_model_hash), ("robot server", server.robot_model_hash)):
        if model is not None and model != ours:
            raise LayoutMismatchError(
                f"the {whose} uses robot model {model[:12]}, this skewmi has {ours[:12]}; "
                "export the policy again with this version, or run both sides with one version"
            )
    if server.joint_names != yumi.joint_names("right"):
        raise ConfigurationError(f"the robot server has other joints: {server.joint_names}")
    if server.grid_ns != GRID_NS or server.state_period_ns != CYCLE_NS:
        raise ConfigurationError(
            f"the robot server has a grid of {server.grid_ns} ns and states every "
            f"{server.state_period_ns} ns; this session needs {GRID_NS} and {CYCLE_NS}"
        )
    _check_limits(limits, server)


def draw_start(workspace: Workspace, seed: int, spread: float, q_near: Array) -> Array:
    """Joint angles of an episode's start, drawn around the task's start position.

    Args:
        workspace: Start, posture and orientation of the hand.
        seed: Of the draw.
        spread: Half-width of the uniform offset, m per axis.
        q_near: Where the arm is, rad: the start is the configuration next to it, unless that is
            another posture altogether. Shape (7,).

    Returns:
        rad. Shape (7,).

    Raises:
        KinematicsError: The start cannot be reached.
    """
    offset = np.random.default_rng(seed).uniform(-spread, spread, 3)
    start = np.clip(np.array(workspace.start) + offset, workspace.low, workspace.high)
    posture = np.array(workspace.start_configuration)
    near = posture if np.abs(q_near - posture).max() > OTHER_POSTURE else q_near
    result = ArmKinematics("right").inverse(
        (start - np.array(workspace.base_position))[None],
        rotation_from_quaternion(workspace.hand_quaternion_wxyz),
        near[None],
        posture=posture,
        max_iterations=_START_ITERATIONS,
    )
    require_converged(result)
    q: Array = result.q[0]
    return q


def check_way(q: Array, q_goal: Array, limits: JointLimits, checks: ChunkChecks) -> None:
    """Check the whole motion to a start before any of it is sent.

    Args:
        q: Where the arm rests, rad. Shape (7,).
        q_goal: Where it is to go, rad. Shape (7,).
        limits: To plan with.
        checks: That every chunk has to pass.

    Raises:
        LimitViolationError: An end is outside the position limits, or the way leads through the
            arm, body or table or asks for too much torque.
    """
    motion = StartMotion(q, q_goal, limits).trajectory
    rest = np.zeros(7)
    # Braking tails stay on the line of the motion: where it is free, they are. Limits on the grid
    # are the motion's own business, and every chunk is checked for everything when it is sent.
    guard = dict(checks.stages)["guard"]
    for first in range(0, len(motion), _WAY_SAMPLES):
        start = JointPoint(motion.q[first], rest, rest)
        guard(motion.part(slice(first, first + _WAY_SAMPLES + 1)), start, start.q[None])


def _check_limits(limits: JointLimits, server: RobotDescription) -> None:
    for name, values in limit_values(limits).items():
        allowed = server.limits.get(name, ())
        if len(allowed) != len(values):
            raise ConfigurationError(f"the robot server does not tell its limit on {name}")
        for joint, (ours, theirs) in enumerate(zip(values, allowed, strict=True)):
            if ours < theirs if name == "position_lower" else ours > theirs:
                raise ConfigurationError(
                    f"limit profile {limits.name!r} allows {name} {ours:.4g} in joint index "
                    f"{joint}, the robot server's {server.limit_profile!r} only {theirs:.4g}; use "
                    f"--limits {server.limit_profile} or restart the robot server"
                )
