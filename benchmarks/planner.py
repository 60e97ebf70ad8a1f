"""Planner cycle and robot server tick in real time, and the quality of the planned path.

    python benchmarks/planner.py --json --out results/planner.json

The cycle is paced at 50 Hz as the session's: plan, check, guard, encode, within the session's own
real-time settings. Stages are timed inside of it; a cycle that is not done when the next is due
counts as missed. Then cycles take turns with the bare calls of the libraries on the same chunks
(`planner_bare`); `ratio_to_sum` is the cycle over their sum, medians of the processor time (other
programs do not count): what the glue costs. Then the robot server's tick at 250 Hz
(`planner_robot_server`), and paths (`planner_path`).
"""

from __future__ import annotations

import sys
import time
from typing import Any

import common
import numpy as np
import planner_path
from numpy.typing import NDArray
from planner_bare import LIBRARIES, OWN, BareCalls
from planner_judge import UrdfArm
from planner_robot_server import measure_robot_server
from planner_scenes import press_workspace
from planner_timing import Pace, Seconds, StageTimes, percentiles

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.safety.guard import Guard
from skewmi.deploy.safety.limits import ChunkChecker
from skewmi.deploy.wire.messages import encode_chunk
from skewmi.robot_models import limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import (
    CYCLE_NS,
    CYCLE_S,
    CYCLE_TICKS,
    GRID_S,
    JointPoint,
    JointTrajectory,
    TrajectoryChunk,
)

Array = NDArray[np.float64]

CYCLES_PER_COMMAND = 5
SHARE_BAR = 0.25
"""Of cycle and tick that the work may take in 99.9 % of the cases."""
RATIO_BAR = 1.3
START = np.array(yumi.TABLE_CONFIGURATION)


def watch_stages(planner: Planner, times: StageTimes) -> None:
    """Time the planner's parts where they are called."""
    for owner, method, stage in (
        (planner._hand, "step", "cartesian"),
        (planner._ik, "place", "inverse_kinematics"),
        (planner._ik, "solve", "inverse_kinematics"),
        (planner._joints, "velocity_bounds", "joint"),
        (planner._joints, "step", "joint"),
        (planner, "_breach", "position_guard"),
    ):
        times.watch(owner, method, stage)


class Cycle:
    """What the session does every 20 ms: plan, check, guard, encode.

    Args:
        times: Gets the four stages' times.
        seed: Of the commands, one every fifth cycle, as a policy of 10 Hz gives them.
    """

    def __init__(self, times: StageTimes, seed: int) -> None:
        self.workspace, self.bounds = press_workspace(START), limits.profile("lab")
        self.planner = Planner(self.workspace, self.bounds)
        self.planner.reset(START)
        self._checker = ChunkChecker(self.bounds, self.workspace, ArmKinematics("right").forward)
        self.guard = Guard(self.bounds, self.workspace)
        self._times = times
        self._names = yumi.joint_names("right")
        self._rng = np.random.default_rng(seed)
        self.count = self.continued = 0
        self.state = JointPoint(START, np.zeros(7), np.zeros(7))
        self.earlier = np.tile(START, (3, 1))
        # As the session does: the first message of each length is laid out slowly.
        for samples in range(2, 120):
            self._encode(JointTrajectory.resting(np.zeros(7), samples))

    def run(self) -> tuple[JointTrajectory, JointPoint, Array, Seconds]:
        """One cycle: its chunk, the state it started from, positions before, time it took."""
        planner, times, state, earlier = self.planner, self._times, self.state, self.earlier
        cpu, wall = time.thread_time(), time.perf_counter()
        if self.count % CYCLES_PER_COMMAND == 0:
            target = planner.command_position + self._rng.uniform(-0.015, 0.015, 3)
            planner.set_target(np.clip(target, self.workspace.low, self.workspace.high), 0.1)
        with times.of("plan"):
            chunk = planner.step()
        with times.of("check"):
            self._checker.check(chunk.q, chunk.v, chunk.a, state, earlier=earlier)
        with times.of("guard"):
            self.guard.check(chunk.q, chunk.v, chunk.a)
        with times.of("encode"):
            self._encode(chunk)
        took = time.perf_counter() - wall, time.thread_time() - cpu
        self.count += 1
        self.continued += planner.held_back is not None
        self.state, self.earlier = chunk.point(CYCLE_TICKS), chunk.q[CYCLE_TICKS - 3 : CYCLE_TICKS]
        return chunk, state, earlier, took

    def _encode(self, samples: JointTrajectory) -> None:
        encode_chunk(TrajectoryChunk.of(self.count * CYCLE_NS, self._names, samples))


def measure_cycles(cycles: int, seed: int) -> dict[str, Any]:
    """Cycles in real time."""
    times, whole = StageTimes(), []
    cycle = Cycle(times, seed)
    watch_stages(cycle.planner, times)
    times.watch(cycle.guard.clearance, "_measure", "distances (in guard)")
    with hot_loop(priority=True) as granted:
        pace = Pace(CYCLE_S)
        for _ in range(cycles):
            pace.wait()
            whole.append(cycle.run()[-1])
            pace.done()
            times.end_round()
    figures = percentiles(whole)
    return {
        "cycle": figures,
        "p99_9_share_of_cycle": round(figures["p99_9_ms"] / (1e3 * CYCLE_S), 4),
        "stages": times.figures(),
        "seconds": cycles * CYCLE_S,
        **pace.figures(),
        "continued": cycle.continued,
        "granted": granted,
    }


def measure_ratio(cycles: int, seed: int) -> dict[str, Any]:
    """Cycles and bare calls, taking turns without a pause: both meet the same machine."""
    times, bare_times, whole = StageTimes(), StageTimes(), []
    cycle = Cycle(times, seed)
    bare = BareCalls(cycle.workspace, cycle.bounds)
    with hot_loop(priority=False):
        for _ in range(cycles):
            chunk, state, earlier, took = cycle.run()
            whole.append(took)
            times.end_round()
            bare.run(chunk, state, earlier, bare_times)
            bare_times.end_round()
    calls = bare_times.figures()
    cycle_ms = percentiles(whole)["cpu_p50_ms"]
    library_ms = sum(calls[name]["cpu_p50_ms"] for name in LIBRARIES)
    own_ms = sum(calls[name]["cpu_p50_ms"] for name in OWN)
    own_ms += times.figures()["encode"]["cpu_p50_ms"]
    return {
        "ratio_to_sum": round(cycle_ms / (library_ms + own_ms), 3),
        "ratio": {
            "cycle_cpu_p50_ms": cycle_ms,
            "libraries_ms": round(library_ms, 4),
            "own_ms": round(own_ms, 4),
            "to_libraries_alone": round(cycle_ms / library_ms, 3),
            "cycles": cycles,
            "bare_calls": calls,
            "stages": times.figures(),
        },
    }


def measure_paths() -> dict[str, Any]:
    arm = UrdfArm()
    cases = {
        "steps": planner_path.steps(arm),
        "corners": planner_path.corners(arm),
        "corners_every_200_ms": planner_path.zigzags(arm),
    }
    verdicts = {kind: planner_path.verdict(found) for kind, found in cases.items()}
    return {"verdict": verdicts, **cases}


def main() -> int:
    parser = common.argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=60.0, help="real time of each loop")
    options = parser.parse_args()
    common.progress(f"cycles, {options.seconds:g} s")
    measure_cycles(100, options.seed)
    figures = measure_cycles(round(options.seconds / CYCLE_S), options.seed)
    figures |= measure_ratio(2000, options.seed)
    common.progress(f"endpoint ticks, {options.seconds:g} s")
    cold = measure_robot_server(1.0, options.seed)
    server = measure_robot_server(options.seconds, options.seed)
    server["slowest_tick_after_a_cold_start_ms"] = cold["tick"]["max_ms"]
    server["p99_9_share_of_tick"] = round(server["tick"]["p99_9_ms"] / (1e3 * GRID_S), 4)
    common.progress("paths")
    path = measure_paths()
    verdicts = path["verdict"]
    within = {
        "cycle_p99_9": figures["p99_9_share_of_cycle"] <= SHARE_BAR,
        "ratio_to_sum": figures["ratio_to_sum"] <= RATIO_BAR,
        "tick_p99_9": server["p99_9_share_of_tick"] <= SHARE_BAR,
        **{f"steps_{bar}": met for bar, met in verdicts["steps"]["within"].items()},
        # Corners are cut by what the limits ask for: that has no bar.
        "corners_orientation": verdicts["corners"]["within"]["orientation"],
    }
    document = common.write_result(
        "planner",
        {"within": within, **figures, "endpoint": server, "path": path},
        options.out,
        seed=options.seed,
        config={"seconds": options.seconds},
    )
    common.print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
