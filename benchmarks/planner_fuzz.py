"""Adversarial commands against the planner, judged by checks written without it.

    python benchmarks/planner_fuzz.py --cycles 1000000 --out results/planner_fuzz.json

Each round draws a limit profile, a scene (the press task's box, a random box anywhere in reach, or
one with joint bounds so tight that the hand runs into them) and then a few seconds of commands
each of several kinds of adversary. Judged are

- the executed stream, position samples on the 4 ms grid alone: their first, second and third
  differences against velocity, acceleration and jerk limits, position bounds, the tool's speed and
  the box by Pinocchio's kinematics;
- every chunk: it starts bit for bit where it must, its v and a are within limits and fit q, its
  tail ends at rest inside all limits; and the deployed `ChunkChecker` accepts it;
- liveness: after the adversary the arm still goes where it is told.

Commands that are not numbers must be refused, leaving the planner as it was.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import common

from skewmi.deploy.limits import ChunkChecker, LimitUsage
from skewmi.deploy.motion.planner import Planner
from skewmi.errors import ConfigurationError, KinematicsError, LimitViolationError
from skewmi.policy_io import Workspace
from skewmi.robot_models import frames, limits, urdf, yumi
from skewmi.robot_models.kinematics import ArmKinematics, require_converged
from skewmi.robot_models.limits import JointLimits

Array = NDArray[np.float64]

GRID_DT = 0.004
CYCLES_PER_ROUND = 250
TCP_SPEED = 0.25
BOX_TOLERANCE = 0.005


class Breach(AssertionError):  # noqa: N818 - it is what a test reports
    """The planner broke a promise."""


def tool_positions() -> Callable[[Array], Array]:
    """Flange positions in the base frame by Pinocchio on the URDF, (n, 7) -> (n, 3)."""
    model = pinocchio.buildModelFromXML(urdf.build_urdf(arms=("right",)))
    data = model.createData()
    columns = [model.joints[model.getJointId(name)].idx_q for name in yumi.joint_names("right")]
    tool = model.getFrameId("tool0_r")
    q_full = pinocchio.neutral(model)

    def positions(q: Array) -> Array:
        out = np.empty((len(q), 3))
        for k, sample in enumerate(q):
            q_full[columns] = sample
            pinocchio.forwardKinematics(model, data, q_full)
            out[k] = pinocchio.updateFramePlacement(model, data, tool).translation
        return out

    return positions


@dataclass
class Judge:
    """Independent checks of one round; fractions of each limit that were used."""

    limits: JointLimits
    workspace: Workspace
    tool: Callable[[Array], Array]
    usage: dict[str, float] = field(default_factory=dict)

    def note(self, name: str, fraction: float) -> None:
        self.usage[name] = max(self.usage.get(name, 0.0), fraction)
        if not fraction <= 1.0:
            raise Breach(f"{name} is {100 * fraction:.6f} % of its limit")

    def motion(self, q: Array, what: str) -> None:
        """Positions on the grid alone."""
        bounds = self.limits
        middle = (bounds.position_upper + bounds.position_lower) / 2
        half = (bounds.position_upper - bounds.position_lower) / 2
        self.note(f"{what} position", float((np.abs(q - middle) / half).max()))
        derived = q
        for name, bound in (
            ("velocity", bounds.velocity),
            ("acceleration", bounds.acceleration),
            ("jerk", bounds.jerk),
        ):
            derived = np.diff(derived, axis=0) / GRID_DT
            self.note(f"{what} {name}", float((np.abs(derived) / bound).max(initial=0.0)))

    def hand(self, q: Array, what: str) -> None:
        position = self.tool(q) + np.array(self.workspace.base_position)
        low, high = np.array(self.workspace.low), np.array(self.workspace.high)
        outside = float(np.maximum(low - position, position - high).max())
        self.note(f"{what} box", max(outside, 0.0) / BOX_TOLERANCE)
        speed = np.linalg.norm(np.diff(position, axis=0), axis=1).max(initial=0.0) / GRID_DT
        self.note(f"{what} tool speed", float(speed) / TCP_SPEED)

    def chunk(self, q: Array, v: Array, a: Array, start: tuple[Array, Array, Array]) -> None:
        if not all(np.array_equal(x[0], y) for x, y in zip((q, v, a), start, strict=True)):
            raise Breach("a chunk does not start on the one before")
        if v[-1].any() or a[-1].any():
            raise Breach("a chunk does not end at rest")
        self.note("chunk v", float((np.abs(v) / self.limits.velocity).max()))
        self.note("chunk a", float((np.abs(a) / self.limits.acceleration).max()))
        jerk = np.abs(np.diff(a, axis=0)) / GRID_DT
        self.note("chunk jerk", float((jerk / self.limits.jerk).max()))
        # v must be the derivative of q: |q1 - q0 - h (v0 + v1) / 2| <= J h^3 / 12.
        misfit = np.abs(np.diff(q, axis=0) - GRID_DT * (v[1:] + v[:-1]) / 2)
        self.note("chunk fit", float((misfit / (self.limits.jerk * GRID_DT**3 / 12)).max()))
        self.motion(q, "tail")


def press_workspace(start_configuration: Array) -> Workspace:
    """The hand's box of OpenPressClose, whose start the configuration must reach."""
    return Workspace(
        low=(-0.019, -0.155, 0.190),
        high=(0.001, 0.135, 0.355),
        start=(-0.009, -0.1345, 0.270),
        base_position=(-0.4, 0.0, 0.0),
        hand_quaternion_wxyz=(0.0, 0.5**0.5, 0.5**0.5, 0.0),
        free_lead=1.0,
        held_lead=0.3,
        start_configuration=tuple(start_configuration.tolist()),
        gripper_opening=0.014,
    )


def random_workspace(rng: np.random.Generator, kinematics: ArmKinematics) -> Workspace:
    """A box of random size around a random pose; the orientation is the pose's."""
    bounds = limits.profile("lab")
    while True:
        q = rng.uniform(bounds.position_lower, bounds.position_upper)
        position, rotation = kinematics.forward(q)
        half = rng.uniform(0.005, 0.08, 3)
        centre = position - rng.uniform(-0.9, 0.9, 3) * half
        corners = np.array(np.meshgrid(*zip(centre - half, centre + half, strict=True)))
        result = kinematics.inverse(corners.reshape(3, 8).T, rotation, q, max_iterations=50)
        try:
            require_converged(result)
        except KinematicsError:
            continue
        quaternion = frames.quaternion_from_rotation(rotation)
        base = np.array([-0.4, 0.0, 0.0])
        low, high, start = (
            tuple((x + base).tolist()) for x in (centre - half, centre + half, position)
        )
        return Workspace(
            low,
            high,
            start,
            tuple(base.tolist()),
            tuple(quaternion.tolist()),
            0.03,
            tuple(q.tolist()),
            0.014,
        )


def draw_scene(
    rng: np.random.Generator, kinematics: ArmKinematics, press_start: Array
) -> tuple[str, Workspace, JointLimits]:
    """A workspace and limits: profile, speed and perhaps tight joint bounds are drawn too."""
    bounds = limits.profile(str(rng.choice(["lab", "careful"])))
    if rng.random() < 0.3:
        bounds = bounds.scaled(float(rng.uniform(0.1, 1.0)))
    kind = str(rng.choice(["press", "random", "tight"]))
    workspace = press_workspace(press_start)
    if kind == "random" or (kind == "tight" and rng.random() < 0.5):
        workspace = random_workspace(rng, kinematics)
    if kind == "tight":
        q = np.array(workspace.start_configuration)
        below, above = rng.uniform(0.02, 0.25, 7), rng.uniform(0.02, 0.25, 7)
        bounds = replace(bounds, position_lower=q - below, position_upper=q + above)
    return f"{kind} {bounds.name}", workspace, bounds


ADVERSARIES = (
    "constant",
    "reversal",
    "noise",
    "huge",
    "faces",
    "corners",
    "sudden",
    "silent",
    "late",
    "every cycle",
)


def commands(
    kind: str, workspace: Workspace, rng: np.random.Generator
) -> Iterator[tuple[Array, float] | None]:
    """Per cycle a target and its duration, or None; without end."""
    low, high = np.array(workspace.low), np.array(workspace.high)
    position = rng.uniform(low, high)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    cycle = 0
    while True:
        period = 1 if kind == "every cycle" else 5
        if cycle % period or kind == "silent":
            yield None
        elif kind == "constant":
            position = np.clip(position + 0.015 * direction, low, high)
            yield position, 0.1
        elif kind == "reversal":
            direction = -direction
            yield position + 0.015 * direction, 0.1
        elif kind == "noise":
            position = np.clip(position + rng.uniform(-0.015, 0.015, 3), low, high)
            yield position, 0.1
        elif kind == "huge":
            yield rng.normal(size=3) * 10.0 ** rng.uniform(-3, 6), 10.0 ** rng.uniform(-6, 1)
        elif kind == "faces":
            target = rng.uniform(low, high)
            axis = rng.integers(3)
            target[axis] = (low if rng.random() < 0.5 else high)[axis]
            yield target, float(rng.uniform(0.001, 0.3))
        elif kind == "corners":
            yield np.where(rng.random(3) < 0.5, low, high), float(rng.uniform(0.001, 0.1))
        elif kind == "sudden":
            yield rng.uniform(low, high), 0.001
        else:
            yield rng.uniform(low, high), float(rng.uniform(0.02, 0.5))
        cycle += 1


@dataclass
class Totals:
    """What all rounds came to."""

    cycles: int = 0
    rounds: int = 0
    continued: Counter[str] = field(default_factory=Counter)
    scenes: Counter[str] = field(default_factory=Counter)
    usage: dict[str, float] = field(default_factory=dict)
    checker: LimitUsage = field(default_factory=LimitUsage)
    worst_return_mm: float = 0.0


def run_round(
    seed: int, tool: Callable[[Array], Array], press_start: Array, totals: Totals
) -> None:
    """One scene, several adversaries, and the way back.

    Raises:
        Breach: With the seed.
        LimitViolationError: From the deployed checker, which must accept every chunk.
    """
    rng = np.random.default_rng(seed)
    kinematics = ArmKinematics("right")
    scene, workspace, bounds = draw_scene(rng, kinematics, press_start)
    planner = Planner(workspace, bounds)
    start = np.array(workspace.start_configuration)
    planner.reset(start)
    judge = Judge(bounds, workspace, tool, totals.usage)
    checker = ChunkChecker(bounds, workspace, kinematics.forward)
    state = start, np.zeros(7), np.zeros(7)
    chunk = planner.step(0)
    stream = [start[None]]
    splice = 0

    def cycle(command: tuple[Array, float] | None, late: int) -> None:
        nonlocal chunk, state, splice
        if command is not None:
            planner.set_target(*command)
        splice = 5 + late
        state = tuple(x.copy() for x in chunk.state(splice))  # type: ignore[assignment]
        rows = np.minimum(np.arange(1, splice + 1), len(chunk.q) - 1)
        stream.append(chunk.q[rows])
        chunk = planner.step(None if late == 0 else splice)
        judge.chunk(chunk.q, chunk.v, chunk.a, state)
        totals.checker = totals.checker.merged(checker.check(chunk.q, chunk.v, chunk.a, state))
        if totals.cycles % 7 == 0:
            judge.hand(chunk.q, "tail")
        if chunk.continued:
            totals.continued[chunk.continued] += 1
        totals.cycles += 1

    try:
        for kind in rng.choice(ADVERSARIES, 4, replace=False):
            source = commands(str(kind), workspace, rng)
            for _ in range(CYCLES_PER_ROUND // 5):
                late = int(rng.integers(1, 40)) if kind == "late" and rng.random() < 0.3 else 0
                cycle(next(source), late)
            _require_refusal(planner, rng)
        # The way back: time for the longest way in the box at the slowest profile.
        travel = np.linalg.norm(np.array(workspace.high) - np.array(workspace.low))
        patience = int((2.0 * travel / planner.hand_bounds.speed + 3.0) / 0.02)
        target = np.array(workspace.start)
        planner.set_target(target, 0.5)
        for _ in range(patience):
            cycle(None, 0)
            off = float(np.linalg.norm(tool(chunk.q[-1:])[0] + workspace.base_position - target))
            if off < 1e-3:
                break
        totals.worst_return_mm = max(totals.worst_return_mm, 1e3 * off)
        if off > 1e-3:
            raise Breach(f"the hand is {1e3 * off:.2f} mm away from where it was told to go")
        executed = np.concatenate([*stream, chunk.q[1:]])
        judge.motion(executed, "executed")
        judge.hand(executed, "executed")
    except (Breach, LimitViolationError) as error:
        raise Breach(f"round seed {seed} ({scene}), cycle {totals.cycles}: {error}") from error
    totals.rounds += 1
    totals.scenes[scene] += 1


def _require_refusal(planner: Planner, rng: np.random.Generator) -> None:
    """Commands that are no numbers are refused and change nothing."""
    before = planner.command_position
    bad = np.array(planner.command_position)
    bad[rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    for target, duration in ((bad, 0.1), (before, float("nan")), (before, 0.0), (before, -1.0)):
        try:
            planner.set_target(target, duration)
        except LimitViolationError:
            continue
        raise Breach(f"the target {target} in {duration} s was accepted")
    if not np.array_equal(before, planner.command_position):
        raise Breach("a refused target changed the command")


def fuzz(cycles: int, seed: int, press_start: Array, seconds: float = np.inf) -> Totals:
    """Rounds until the number of cycles or the time is reached."""
    tool = tool_positions()
    totals = Totals()
    begin = last = time.monotonic()
    while totals.cycles < cycles and time.monotonic() - begin < seconds:
        try:
            run_round(seed + totals.rounds, tool, press_start, totals)
        except ConfigurationError as error:
            raise Breach(f"round seed {seed + totals.rounds}: {error}") from error
        if time.monotonic() - last > 10.0:
            last = time.monotonic()
            common.progress(f"{totals.cycles} cycles, {totals.rounds} rounds")
    return totals


def main() -> int:
    parser = common.argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cycles", type=int, default=20_000, help="planner cycles of 20 ms")
    options = parser.parse_args()
    begin = time.monotonic()
    totals = fuzz(options.cycles, options.seed, np.array(yumi.PRESS_START_CONFIGURATION))
    figures: dict[str, Any] = {
        "cycles": totals.cycles,
        "rounds": totals.rounds,
        "breaches": 0,
        "fractions_of_limits": {k: round(v, 6) for k, v in sorted(totals.usage.items())},
        "checker_fractions": totals.checker.as_dict(),
        "continued_previous_stop": dict(totals.continued),
        "scenes": dict(totals.scenes),
        "worst_return_mm": totals.worst_return_mm,
        "wall_s": round(time.monotonic() - begin, 1),
    }
    document = common.write_result(
        "planner_fuzz", figures, options.out, seed=options.seed, config={"cycles": options.cycles}
    )
    common.print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
