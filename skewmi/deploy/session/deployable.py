"""Which policies can be deployed at all; needs nothing that plans or judges."""

from __future__ import annotations

from skewmi.errors import LayoutMismatchError
from skewmi.policy_io import PolicyLayout, Workspace


def require_workspace(layout: PolicyLayout) -> Workspace:
    """The workspace of a policy that commands a hand.

    Raises:
        LayoutMismatchError: Its task has none.
    """
    if layout.workspace is None:
        raise LayoutMismatchError(
            f"task {layout.task!r} has no workspace: there is no robot to deploy it on"
        )
    return layout.workspace
