"""Planner cycle: each stage alone, the whole cycle, and the quality of the path.

    python benchmarks/planner.py --out results/planner.json

`ratio_to_sum` is the whole cycle (plan, check, guard) over the sum of its stages measured
alone, medians of the processor time (other programs on the machine do not count): what the glue
between them costs. Path quality is measured for steps of 150 mm/s along several directions.
"""

from __future__ import annotations

import gc
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import common
from planner_fuzz import press_workspace

from skewmi.deploy.guard import Guard
from skewmi.deploy.limits import ChunkChecker
from skewmi.deploy.motion.cartesian_shaper import CartesianShaper, Reference
from skewmi.deploy.motion.differential_ik import DifferentialIk
from skewmi.deploy.motion.joint_shaper import JointShaper
from skewmi.deploy.motion.planner import PlannedChunk, Planner
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.frames import rotation_vector
from skewmi.robot_models.kinematics import ArmKinematics

Array = NDArray[np.float64]
GRID_DT = 0.004
STEPS = 5
START = np.array(yumi.PRESS_START_CONFIGURATION)


Times = dict[str, list[tuple[float, float]]]
"""Wall and processor seconds per call, by name."""


def percentiles(seconds: list[tuple[float, float]]) -> dict[str, float]:
    """Wall time p50, p99, p99.9 and maximum, and processor time p50, in ms."""
    wall, cpu = 1e3 * np.array(seconds).T
    p50, p99, p999 = np.percentile(wall, [50, 99, 99.9])
    return {
        "p50_ms": round(float(p50), 4),
        "p99_ms": round(float(p99), 4),
        "p99_9_ms": round(float(p999), 4),
        "max_ms": round(float(wall.max()), 4),
        "cpu_p50_ms": round(float(np.median(cpu)), 4),
    }


def timed(function: Callable[[], object], times: list[tuple[float, float]]) -> Any:
    cpu, wall = time.thread_time(), time.perf_counter()
    result = function()
    times.append((time.perf_counter() - wall, time.thread_time() - cpu))
    return result


class Stages:
    """Each stage of `Planner.step` alone, on the states that occur; one call is one cycle."""

    def __init__(self, seed: int) -> None:
        self._workspace, bounds = press_workspace(START), limits.profile("lab")
        hand = Planner(self._workspace, bounds).hand_bounds
        low, high = np.array(self._workspace.low), np.array(self._workspace.high)
        self._box = low, high
        self._shaper = CartesianShaper(
            low,
            high,
            speed=hand.speed,
            acceleration=hand.acceleration,
            jerk=hand.jerk,
            grid_dt=GRID_DT,
        )
        start = np.array(self._workspace.start)
        self._reference = Reference(start, round(hand.lag_s / GRID_DT))
        self._shaper.reseed(start, np.zeros(3))
        self._ik = DifferentialIk(START, frames.HAND_DOWN, GRID_DT)
        self._joints = JointShaper(bounds, GRID_DT)
        self._kinematics = ArmKinematics("right")
        self._rng = np.random.default_rng(seed)
        self._chunk: PlannedChunk | None = None

    def run(self, chunk: PlannedChunk, cycle: int, times: Times) -> None:
        self._chunk = chunk
        if cycle % STEPS == 0:
            step = self._rng.uniform(-0.015, 0.015, 3)
            self._reference.set_target(np.clip(self._reference.position_w + step, *self._box), 0.1)
        self._joints.restore(*chunk.state(0))
        for name, stage in (
            ("cartesian", self._cartesian),
            ("inverse_kinematics", self._solve),
            ("joint", self._shape),
            ("stop", self._stop),
            ("position_guard", self._position_guard),
        ):
            timed(partial(stage, chunk), times[name])

    def _cartesian(self, chunk: PlannedChunk) -> None:
        for _ in range(STEPS):
            self._reference.advance(GRID_DT)
            self._shaper.step(self._reference, self._shaper.position_w, 0.01)

    def _solve(self, chunk: PlannedChunk) -> None:
        velocity = np.array([0.0, 0.05, 0.02])
        for q in chunk.q[:STEPS]:
            position = self._ik.place(q)
            self._ik.solve(position, velocity, -self._joints.velocity, self._joints.velocity)

    def _shape(self, chunk: PlannedChunk) -> None:
        for v in chunk.v[1 : STEPS + 1]:
            self._joints.step(v, *self._joints.velocity_bounds())

    def _stop(self, chunk: PlannedChunk) -> None:
        stop = self._joints.stop()
        stop.sample(GRID_DT)
        stop.extent()

    def _position_guard(self, chunk: PlannedChunk) -> None:
        position, _ = self._kinematics.forward(chunk.q)
        low, high = self._box
        float(np.maximum(low - position, position - high).max())


def run_cycles(cycles: int, seed: int) -> tuple[Times, int]:
    """Planner, checker and guard as the daemon runs them, and between them each stage alone.

    Both take turns, so that whatever else the machine does meets both.

    Returns:
        Seconds per name, and how often the planner continued its previous stop.
    """
    workspace, bounds = press_workspace(START), limits.profile("lab")
    planner = Planner(workspace, bounds)
    planner.reset(START)
    checker = ChunkChecker(bounds, workspace, ArmKinematics("right").forward)
    guard = Guard(bounds, workspace)
    rng = np.random.default_rng(seed)
    stages = Stages(seed + 1)
    times: Times = defaultdict(list)
    continued, state = 0, (START, np.zeros(7), np.zeros(7))
    for cycle in range(cycles):
        # A new command every fifth cycle, as a policy of 10 Hz gives.
        if cycle % STEPS == 0:
            target = planner.command_position + rng.uniform(-0.015, 0.015, 3)
            planner.set_target(np.clip(target, workspace.low, workspace.high), 0.1)
        cpu, wall = time.thread_time(), time.perf_counter()
        chunk: PlannedChunk = timed(planner.step, times["plan"])
        timed(partial(checker.check, chunk.q, chunk.v, chunk.a, state), times["check"])
        timed(partial(guard.check, chunk.q, chunk.v, chunk.a), times["guard"])
        times["cycle"].append((time.perf_counter() - wall, time.thread_time() - cpu))
        state = chunk.state(STEPS)
        continued += chunk.continued is not None
        stages.run(chunk, cycle, times)
    return times, continued


def path_quality(direction: tuple[float, ...], profile: str, speed: float) -> dict[str, Any]:
    """A velocity step of the command, held for 70 mm or the box, then a sudden stop."""
    workspace = press_workspace(START)
    planner = Planner(workspace, limits.profile(profile))
    planner.reset(START)
    way = np.array(direction) / np.linalg.norm(direction)
    start = np.array(workspace.start)
    room = np.where(way > 0, workspace.high - start, start - np.array(workspace.low))
    reach = min(0.15, float((room[way != 0] / np.abs(way[way != 0])).min()))
    steps = max(1, int(reach / (0.1 * speed)))
    q, command = [], []
    for cycle in range(STEPS * steps + 75):
        if cycle % STEPS == 0 and cycle < STEPS * steps:
            planner.set_target(start + 0.1 * speed * (cycle // STEPS + 1) * way, 0.1)
        begin = planner.command_position
        chunk = planner.step()
        q.append(chunk.q[:STEPS])
        command.append(
            begin + np.arange(STEPS)[:, None] / STEPS * (planner.command_position - begin)
        )
    position, rotation = planner.forward(np.vstack(q))
    offset = position - start
    along, commanded = offset @ way, (np.vstack(command) - start) @ way
    lateral = np.linalg.norm(offset - along[:, None] * way, axis=1)
    tilt = rotation_vector(np.swapaxes(rotation, -1, -2) @ frames.HAND_DOWN)
    half = commanded.max() / 2
    return {
        "profile": profile,
        "direction": [round(float(x), 3) for x in way],
        "speed_mm_s": 1e3 * speed,
        "way_mm": round(1e3 * 0.1 * speed * steps, 1),
        "lateral_mm": round(1e3 * float(lateral.max()), 3),
        "lag_ms": float(4 * (np.argmax(along > half) - np.argmax(commanded > half))),
        "overshoot_mm": round(1e3 * float(along.max() - commanded.max()), 3),
        "final_error_mm": round(1e3 * float(np.linalg.norm(offset[-1] - commanded.max() * way)), 4),
        "tilt_deg": round(float(np.degrees(np.linalg.norm(tilt, axis=1).max())), 4),
    }


def main() -> int:
    parser = common.argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cycles", type=int, default=3000, help="timed cycles of 20 ms")
    options = parser.parse_args()
    run_cycles(200, options.seed)
    gc.collect()
    gc.freeze()
    gc.disable()
    times, continued = run_cycles(options.cycles, options.seed)
    figures = {name: percentiles(seconds) for name, seconds in times.items()}
    cycle, plan = figures.pop("cycle"), figures.pop("plan")
    parts = sum(stage["cpu_p50_ms"] for stage in figures.values())
    document_figures = {
        "cycle": cycle,
        "plan": plan,
        "stages": figures,
        "ratio_to_sum": round(cycle["cpu_p50_ms"] / parts, 3),
        "continued": continued,
        "path": [
            path_quality(direction, "lab", 0.15)
            for direction in ((0, 1, 0), (0, 1, 0.4), (0, 0, 1), (0, 0.6, -0.4), (1, 0, 0))
        ]
        + [path_quality((0, 1, 0), "careful", 0.04)],
    }
    document = common.write_result(
        "planner",
        document_figures,
        options.out,
        seed=options.seed,
        config={"cycles": options.cycles},
    )
    common.print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
