"""What must agree between policy, session and robot server before the arm may move."""

from __future__ import annotations

from collections.abc import Mapping

from skewmi.deploy.robot.description import RobotDescription, limit_values
from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.policy_io import PolicyLayout
from skewmi.robot_models import yumi
from skewmi.robot_models.limits import JointLimits
from skewmi.trajectory import CYCLE_NS, GRID_NS


def check_pace(server: RobotDescription, *, lock_step: bool) -> None:
    """Refuse to run at another pace than the robot server.

    Raises:
        ConfigurationError: One of them runs in lock-step, the other in real time.
    """
    if server.lock_step != lock_step:
        pace = {True: "in lock-step", False: "in real time"}
        raise ConfigurationError(
            f"the robot server runs {pace[server.lock_step]}, this run is to be "
            f"{pace[lock_step]}; give --lock-step to both or to none"
        )


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
        server: What the robot server says about itself.

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
    _check_model("policy", robot_model_hash)
    check_robot(limits, server)


def check_same_box(agreed: Mapping[str, float], server: RobotDescription) -> None:
    """Refuse a robot server that has come to know another place of the box since the agreement.

    Args:
        agreed: `RobotDescription.box_pose` that the session plans with.
        server: What the robot server says about itself now.

    Raises:
        ConfigurationError: They differ.
    """
    if dict(agreed) != dict(server.box_pose):
        raise ConfigurationError(
            f"the robot server has the task's box elsewhere than before: {dict(server.box_pose)}, "
            f"and this session plans with {dict(agreed)}; start the session again"
        )


def check_robot(limits: JointLimits, server: RobotDescription) -> None:
    """Refuse to move a robot that is another one than this version's, whoever decides on motion.

    Args:
        limits: That the session plans with.
        server: What the robot server says about itself.

    Raises:
        LayoutMismatchError: The robot models differ.
        ConfigurationError: The session would plan beyond the robot server's limits, or their grids
            or joints differ.
    """
    _check_model("robot server", server.robot_model_hash)
    if server.joint_names != yumi.joint_names("right"):
        raise ConfigurationError(f"the robot server has other joints: {server.joint_names}")
    if server.grid_ns != GRID_NS or server.state_period_ns != CYCLE_NS:
        raise ConfigurationError(
            f"the robot server has a grid of {server.grid_ns} ns and states every "
            f"{server.state_period_ns} ns; this session needs {GRID_NS} and {CYCLE_NS}"
        )
    _check_limits(limits, server)


def _check_model(whose: str, model: str | None) -> None:
    ours = yumi.MODEL_HASH
    if model is not None and model != ours:
        raise LayoutMismatchError(
            f"the {whose} uses robot model {model[:12]}, this skewmi has {ours[:12]}; "
            "export the policy again with this version, or run both sides with one version"
        )


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
