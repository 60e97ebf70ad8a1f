"""Doing once what every cycle does: first calls load code and build tables."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.session.stream import ChunkStream
from skewmi.policy_io import Policy, Workspace
from skewmi.trajectory import CYCLE_TICKS

_CYCLES = 10


def warm_up(
    policy: Policy, workspace: Workspace, planner: Planner, checks: ChunkChecks, stream: ChunkStream
) -> None:
    """Plan and check some cycles, sending nothing.

    Args:
        policy: Acts once, and is reset by whoever runs it.
        workspace: Of the policy.
        planner: Plans some cycles; to be reset afterwards.
        checks: Judge them, in the box and out of it.
        stream: Lays out its messages.
    """
    stream.warm_up()
    start = np.array(workspace.start_configuration)
    planner.reset(start)
    earlier = np.tile(start, (3, 1))
    planner.set_target(np.array(workspace.start) + 0.01, policy.layout.control_dt)
    policy.reset()
    policy.act(np.zeros(policy.layout.observation_dim))
    for cycle in range(_CYCLES):
        present = planner.present
        chunk = planner.step()
        checks.boxed = cycle % 2 == 0
        for _, check in checks.stages:
            check(chunk, present, earlier)
        earlier = chunk.q[CYCLE_TICKS - 3 : CYCLE_TICKS]
