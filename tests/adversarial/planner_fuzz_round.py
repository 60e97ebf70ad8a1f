"""One round of the planner's fuzzing: a scene, adversaries, ways back, and what the judge says."""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

import numpy as np
from planner_judge import Breach, Judge, UrdfArm
from planner_scenes import ADVERSARIES, Command, commands, draw_scene, not_numbers

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.safety.limits import ChunkChecker, LimitUsage
from skewmi.errors import LimitViolationError, SkewmiError
from skewmi.robot_models.kinematics import ArmKinematics

CYCLES_PER_ADVERSARY = 50
ADVERSARIES_PER_ROUND = 4
ARRIVED = 1e-3
"""Distance from its target at which the hand has arrived, m."""


class _Episode:
    """One planner under attack."""

    def __init__(self, rng: np.random.Generator, arm: UrdfArm) -> None:
        self.rng, self._arm = rng, arm
        kinematics = ArmKinematics("right")
        self.scene, self.workspace, bounds = draw_scene(rng, kinematics)
        self.profile = bounds.name
        self.planner = Planner(self.workspace, bounds)
        start = np.array(self.workspace.start_configuration)
        self.planner.reset(start)
        self.judge = Judge(bounds, self.workspace, arm, executed=[start[None]])
        self._checker = ChunkChecker(bounds, self.workspace, kinematics.forward)
        self.usage = LimitUsage()
        self._tail = np.tile(start, (4, 1))
        self._chunk = self.planner.step(0)
        self.cycles = self.refused = 0
        self.kinds: Counter[str] = Counter()
        self.continued: Counter[str] = Counter()
        self.worst_return = 0.0
        # The longest way in the box, at half the speed it is planned with.
        travel = np.linalg.norm(np.array(self.workspace.high) - np.array(self.workspace.low))
        self._patience = int((2.0 * travel / self.planner.hand_bounds.speed + 3.0) / 0.02)

    def cycle(self, splice: int = 5) -> None:
        """Execute the present chunk up to sample `splice`, and plan on from there."""
        chunk = self._chunk
        state = chunk.point(splice)
        rows = np.minimum(np.arange(1, splice + 1), len(chunk.q) - 1)
        self.judge.executed.append(chunk.q[rows])
        self._tail = np.concatenate((self._tail, chunk.q[rows]))[-4:]
        self._chunk = chunk = self.planner.step(splice)
        parts = chunk.q, chunk.v, chunk.a
        self.judge.add(parts, state)
        usage = self._checker.check(*parts, state, earlier=self._tail[:3])
        self.usage = self.usage.merged(usage)
        if self.planner.held_back is not None:
            self.continued[self.planner.held_back] += 1
        self.cycles += 1

    def attack(self, kind: str) -> None:
        """Give the commands of an adversary."""
        source = commands(kind, self.workspace, self.rng)
        for _ in range(CYCLES_PER_ADVERSARY):
            command = next(source)
            if command is not None:
                self._command(command)
            splice = 5
            if kind == "late" and self.rng.random() < 0.3:
                splice = int(self.rng.integers(1, 45))
            self.cycle(splice)
        self.kinds[kind] += CYCLES_PER_ADVERSARY
        self._command(not_numbers(self.planner.command_position, self.rng))

    def _command(self, command: Command) -> None:
        """What is no number must be refused and change nothing; all else must be taken."""
        target, duration = command
        if np.isfinite(target).all() and np.isfinite(duration) and duration > 0.0:
            self.planner.set_target(target, duration)
            return
        before = self.planner.command_position
        try:
            self.planner.set_target(target, duration)
        except LimitViolationError:
            if not np.array_equal(before, self.planner.command_position):
                raise Breach("a refused target changed the command") from None
            self.refused += 1
            return
        raise Breach(f"the target {target} in {duration} s was accepted")

    def _off_start(self) -> float:
        hand = self._arm.positions(self._chunk.q[-1:])[0] + self.workspace.base_position
        return float(np.linalg.norm(hand - np.array(self.workspace.start)))

    def go_back(self, share: float) -> None:
        """Ask for the start position, and wait until the given share of the way is left."""
        off = self._off_start()
        goal = max(ARRIVED, share * off)
        self.planner.set_target(np.array(self.workspace.start), 0.5)
        for _ in range(self._patience):
            if off <= goal:
                break
            self.cycle()
            off = self._off_start()
        if off > goal:
            raise Breach(
                f"the hand is {1e3 * off:.2f} mm away from where it was told to go, "
                f"not {1e3 * goal:.2f} mm"
            )
        if share == 0.0:
            self.worst_return = off

    def finish(self) -> dict[str, object]:
        self.judge.executed.append(self._chunk.q[1:])
        return self.judge.finish()


_ARM: list[UrdfArm] = []


def run_round(seed: int) -> dict[str, Any]:
    """One scene, several adversaries, after each a part of the way back, at last all of it.

    Returns:
        What came of it, fit for JSON; `breach` says what was broken, None if nothing was.
    """
    if not _ARM:
        _ARM.append(UrdfArm())
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    breach, kind, reached = None, "start", {}
    episode = _Episode(rng, _ARM[0])
    try:
        for kind in map(str, rng.choice(ADVERSARIES, ADVERSARIES_PER_ROUND, replace=False)):
            episode.attack(kind)
            episode.go_back(0.5)
            episode.judge.settle()
        kind = "return"
        episode.go_back(0.0)
        reached = episode.finish()
    except (Breach, SkewmiError) as error:
        breach = (
            f"round seed {seed} ({episode.scene}, {episode.profile}, {kind}), "
            f"cycle {episode.cycles}: {error}"
        )
    return {
        "seed": seed,
        "breach": breach,
        "scene": f"{episode.scene} {episode.profile}",
        "profile": episode.profile,
        "cycles": episode.cycles,
        "adversaries": dict(episode.kinds),
        "refused": episode.refused,
        "usage": episode.judge.usage,
        "checker": episode.usage.as_dict(),
        "continued": dict(episode.continued),
        "return_mm": 1e3 * episode.worst_return,
        "seconds": time.perf_counter() - begin,
        **reached,
    }
