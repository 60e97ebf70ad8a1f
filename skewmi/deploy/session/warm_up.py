"""Doing once what every cycle does: first calls load code and build tables."""

from __future__ import annotations

import numpy as np

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.safety.checks import ChunkChecks
from skewmi.deploy.session.stream import ChunkStream
from skewmi.policy_io import Policy, Workspace
from skewmi.trajectory import CYCLE_TICKS

_CYCLES = 10


class Rehearsal:
    """Plans and checks cycles as a run does, sending nothing.

    Args:
        policy: Acts once, and is reset by whoever runs it.
        workspace: Of the policy.
        planner: Plans; to be reset afterwards.
        checks: Judge what is planned, in the box and out of it.
    """

    def __init__(
        self, policy: Policy, workspace: Workspace, planner: Planner, checks: ChunkChecks
    ) -> None:
        self._policy = policy
        self._workspace = workspace
        self._planner = planner
        self._checks = checks
        self._cycle = 0
        policy.reset()

    def __call__(self) -> None:
        """One cycle."""
        policy, planner = self._policy, self._planner
        if self._cycle % _CYCLES == 0:
            start = np.array(self._workspace.start_configuration)
            planner.reset(start)
            self._earlier = np.tile(start, (3, 1))
            target = np.array(self._workspace.start) + 0.01
            planner.set_target(target, policy.layout.control_dt)
        if self._cycle == 0:
            policy.act(np.zeros(policy.layout.observation_dim))
        present = planner.present
        chunk = planner.step()
        self._checks.boxed = self._cycle % 2 == 0
        for _, check in self._checks.stages:
            check(chunk, present, self._earlier)
        self._earlier = chunk.q[CYCLE_TICKS - 3 : CYCLE_TICKS]
        self._cycle += 1


def warm_up(rehearsal: Rehearsal, stream: ChunkStream) -> Rehearsal:
    """Do once what every cycle does, sending nothing; returns the rehearsal.

    Args:
        rehearsal: Plans some cycles.
        stream: Lays out its messages.
    """
    stream.warm_up()
    for _ in range(_CYCLES):
        rehearsal()
    return rehearsal
