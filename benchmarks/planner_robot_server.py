"""The server's tick of 4 ms in real time: the deployed controller and physics, without the wires.

Every fifth tick states are measured and encoded as they would be published. At the tick after it,
when the session has answered, a chunk arrives that was planned and encoded beforehand: it is
decoded, judged and laid over the plan. At every tick the plan's sample is commanded and the physics
makes a step.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from planner_timing import Pace, StageTimes, percentiles

from skewmi.deploy.motion.planner import Planner
from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.robot.backend import RobotState
from skewmi.deploy.robot.backends.mujoco.backend import MujocoBackend
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.requests import RobotRequests
from skewmi.deploy.safety.checks import limit_check
from skewmi.deploy.safety.validation import ChunkValidator, ValidationRules
from skewmi.deploy.wire.messages import (
    JointStates,
    encode_chunk,
    encode_joint_states,
)
from skewmi.policy_io import Workspace
from skewmi.robot_models import limits, yumi
from skewmi.trajectory import CYCLE_S, CYCLE_TICKS, GRID_NS, GRID_S, TrajectoryChunk

GID = bytes(range(16))
LEAD_TICKS = 5


def plan_chunks(workspace: Workspace, profile: str, cycles: int, seed: int) -> list[bytes]:
    """Chunks of a policy that gives a random command every 100 ms, encoded."""
    planner = Planner(workspace, limits.profile(profile))
    planner.reset(np.array(workspace.start_configuration))
    rng = np.random.default_rng(seed)
    names = yumi.joint_names("right")
    messages = []
    for cycle in range(cycles):
        if cycle % 5 == 0:
            target = planner.command_position + rng.uniform(-0.015, 0.015, 3)
            planner.set_target(np.clip(target, workspace.low, workspace.high), 0.1)
        chunk = planner.step()
        stamp_ns = (LEAD_TICKS + CYCLE_TICKS * cycle) * GRID_NS
        messages.append(encode_chunk(TrajectoryChunk.of(stamp_ns, names, chunk)))
    return messages


def measure_robot_server(seconds: float, seed: int, profile: str = "lab") -> dict[str, Any]:
    """Ticks for the given time.

    Raises:
        RuntimeError: A chunk was refused: then nothing was measured that matters.
    """
    # It neither sleeps nor waits: the benchmark's own pace does.
    backend = MujocoBackend(lock_step=True)
    backend.open(lambda: True)
    workspace = backend.scene.workspace
    bounds = limits.profile(profile)
    cycles = round(seconds / CYCLE_S)
    messages = plan_chunks(workspace, profile, cycles, seed)
    rules = ValidationRules(joint_names=backend.joint_names, grid_ns=GRID_NS)
    validator = ChunkValidator(rules, limit_check(bounds, workspace))
    controller = RobotController(backend, validator)
    times = StageTimes()
    times.watch(backend.simulation, "step", "physics")
    ticks: list[tuple[float, float]] = []
    with hot_loop(priority=True) as granted:
        _cycle(backend, controller)
        RobotRequests(backend, controller).arm(GID, time.monotonic_ns())
        pace = Pace(GRID_S)
        for tick in range(1, 1 + cycles * CYCLE_TICKS):
            pace.wait()
            cpu, wall = time.thread_time(), time.perf_counter()
            state = _cycle(backend, controller)
            if tick % CYCLE_TICKS == 0:
                with times.of("states"):
                    _encode_states(backend, controller.clock_ns, state)
            if tick % CYCLE_TICKS == 1:
                cycle = tick // CYCLE_TICKS
                with times.of("chunk"):
                    controller.receive(messages[cycle], GID, cycle + 1, time.monotonic_ns())
            ticks.append((time.perf_counter() - wall, time.thread_time() - cpu))
            pace.done()
            times.end_round()
    if controller.accepted != cycles:
        refused, first = cycles - controller.accepted, controller.refusals.take()[0]
        raise RuntimeError(f"{refused} chunks refused, the first: {first.reason}")
    physics = times.rounds["physics"]
    rest = [(w - p, 0.0) for (w, _), (p, _) in zip(ticks, physics, strict=True)]
    return {
        "seconds": seconds,
        "tick": percentiles(ticks),
        "tick_without_physics": percentiles(rest),
        "stages": times.figures(),
        **pace.figures(),
        "chunks_accepted": controller.accepted,
        "granted": granted,
    }


def _cycle(backend: MujocoBackend, controller: RobotController) -> RobotState:
    state = backend.read()
    assert state is not None
    controller.cycle(state, time.monotonic_ns())
    return state


def _encode_states(backend: MujocoBackend, stamp_ns: int, state: RobotState) -> None:
    """Joint and scene states as the server publishes them."""
    scene = backend.scene.state()
    nothing = scene.position[:0]
    told = JointStates(stamp_ns, scene.names, scene.position, scene.velocity, nothing)
    encode_joint_states(told)
    names = backend.state_names
    joints = JointStates(stamp_ns, names, state.position, state.velocity, state.effort)
    encode_joint_states(joints)
