"""What must agree between policy, daemon and endpoint before the arm may move."""

from __future__ import annotations

from skewmi.deploy.description import EndpointDescription, limit_values
from skewmi.deploy.stream import CYCLE_NS, GRID_NS
from skewmi.errors import ConfigurationError, LayoutMismatchError
from skewmi.policy_io import PolicyLayout
from skewmi.robot_models import yumi
from skewmi.robot_models.limits import JointLimits


def check_agreement(
    layout: PolicyLayout,
    robot_model_hash: str | None,
    limits: JointLimits,
    endpoint: EndpointDescription,
) -> None:
    """Refuse to run a policy on an endpoint that it was not made for.

    Args:
        layout: Of the policy.
        robot_model_hash: Of the model that the policy was trained with; None if it tells none.
        limits: That the daemon plans with.
        endpoint: What the endpoint says about itself.

    Raises:
        LayoutMismatchError: Task, layout or robot model differ.
        ConfigurationError: The daemon would plan beyond the endpoint's limits, or their grids
            or joints differ.
    """
    if layout.task != endpoint.task:
        raise LayoutMismatchError(
            f"the policy is for task {layout.task!r}, the endpoint has {endpoint.task!r}; "
            f"start one with `skewmi robot --task {layout.task}`"
        )
    if layout.workspace is None:
        raise LayoutMismatchError(f"task {layout.task!r} has no workspace: it needs no robot")
    if layout.hash() not in endpoint.layout_hashes:
        raise LayoutMismatchError(
            f"the policy's layout {layout.hash()[:12]} is not one of the endpoint's "
            f"({', '.join(h[:12] for h in endpoint.layout_hashes)}); it was exported with another "
            "version of the task: train or export it again"
        )
    ours = yumi.MODEL_HASH
    for whose, model in (("policy", robot_model_hash), ("endpoint", endpoint.robot_model_hash)):
        if model is not None and model != ours:
            raise LayoutMismatchError(
                f"the {whose} uses robot model {model[:12]}, this skewmi has {ours[:12]}; "
                "export the policy again with this version, or run both sides with one version"
            )
    if endpoint.joint_names != yumi.joint_names("right"):
        raise ConfigurationError(f"the endpoint has other joints: {endpoint.joint_names}")
    if endpoint.grid_ns != GRID_NS or endpoint.state_period_ns != CYCLE_NS:
        raise ConfigurationError(
            f"the endpoint has a grid of {endpoint.grid_ns} ns and states every "
            f"{endpoint.state_period_ns} ns; this daemon needs {GRID_NS} and {CYCLE_NS}"
        )
    _check_limits(limits, endpoint)


def _check_limits(limits: JointLimits, endpoint: EndpointDescription) -> None:
    for name, values in limit_values(limits).items():
        allowed = endpoint.limits.get(name, ())
        if len(allowed) != len(values):
            raise ConfigurationError(f"the endpoint does not tell its limit on {name}")
        for joint, (ours, theirs) in enumerate(zip(values, allowed, strict=True)):
            if ours < theirs if name == "position_lower" else ours > theirs:
                raise ConfigurationError(
                    f"limit profile {limits.name!r} allows {name} {ours:.4g} in joint index "
                    f"{joint}, the endpoint's {endpoint.limit_profile!r} only {theirs:.4g}; use "
                    f"--limits {endpoint.limit_profile} or restart the endpoint"
                )
