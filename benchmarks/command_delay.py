"""How late a deployed session's commands reach the arm, in terms of the batched simulation.

    python benchmarks/command_delay.py --json

The same actions, which nothing answers, go through the deployed chain (session, planner, Zenoh,
robot server, in lock-step and on the nominal arm) and through the batched simulation with
`command.delay_ms` of 0 to 200 ms; hands are compared at every control step. The delay at which they
differ least is that of the chain. Two minutes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from common import argument_parser, print_result, progress, write_result

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim import tasks
from skewmi.sim.arm.randomization import Randomization

TASKS = ("door_open", "open_press_close")
STILL = Randomization((0.0, 0.0, 0.0))
DELAYS_MS = tuple(range(0, 201, 10))
KEPT = 0.9
"""Of an action in the one that follows it."""


class OpenLoop:
    """A policy that does not look.

    Args:
        layout: Of the task.
        actions: In [-1, 1]. Shape (steps, action_dim).
    """

    def __init__(self, layout: PolicyLayout, actions: Array) -> None:
        self.layout, self.actions = layout, actions

    def reset(self) -> None:
        self.count = 0

    def act(self, observation: Array) -> Array:
        del observation
        action = self.actions[min(self.count, len(self.actions) - 1)]
        self.count += 1
        return action


def free_actions(layout: PolicyLayout, rng: np.random.Generator) -> Array:
    """Slowly changing ones that keep the hand up, where nothing is in its way."""
    noise = np.zeros((layout.episode_steps, layout.action_dim))
    for step in range(1, len(noise)):
        drawn = rng.normal(size=layout.action_dim)
        noise[step] = KEPT * noise[step - 1] + np.sqrt(1.0 - KEPT**2) * drawn
    noise[:, 2] = 0.3 + 0.2 * np.abs(noise[:, 2])
    return np.clip(noise, -1.0, 1.0)


def hand_columns(layout: PolicyLayout) -> list[int]:
    """Of an observation: x, y and z of the hand."""
    return [layout.observation_names.index(f"hand_{axis}") for axis in "xyz"]


def deployed(policy: OpenLoop, folder: Path, seed: int) -> Array:
    """Hands before every action of an episode through the chain, m. Shape (steps, 3)."""
    record = folder / f"{policy.layout.task}-{seed}.mcap"
    options = DeployOptions(lock_step=True, seed=seed, record=record, start_spread=0.0)
    run_deploy(policy, options)
    messages = read_recording(record).messages[topics.POLICY_OBSERVATION.name]
    seen = np.array([decode_joint_states(message.payload).position for message in messages])
    return seen[: len(policy.actions), hand_columns(policy.layout)]


def simulated(policy: OpenLoop, delay_ms: float) -> Array:
    """The same in the batched simulation."""
    layout = policy.layout
    keys = tasks.find(layout.task).variations
    variation = keys.parse(f"command: {{delay_ms: {delay_ms}}}", "the benchmark")
    env = tasks.make_batch(layout.task, 1, variation=variation, randomization=STILL)
    observation, seen = env.reset(0), []
    for action in policy.actions:
        seen.append(observation[0])
        observation = env.step(action[None]).observation
    return np.array(seen)[:, hand_columns(layout)]


def compare(task: str, episodes: int, seed: int) -> dict[str, Any]:
    """Root mean square difference of the hands, m, at each delay; and where it is least."""
    layout = tasks.layout(task)
    squares = np.zeros(len(DELAYS_MS))
    steps = 0
    with tempfile.TemporaryDirectory() as folder:
        for episode in range(episodes):
            progress(f"{task}: episode {episode + 1} of {episodes}")
            rng = np.random.default_rng([seed, episode])
            policy = OpenLoop(layout, free_actions(layout, rng))
            chain = deployed(policy, Path(folder), seed + episode)
            steps += len(chain)
            for at, delay_ms in enumerate(DELAYS_MS):
                batch = simulated(policy, delay_ms)[: len(chain)]
                squares[at] += ((batch - chain) ** 2).sum()
    rms = np.sqrt(squares / steps)
    best = int(rms.argmin())
    return {
        "steps": steps,
        "delay_ms": DELAYS_MS[best],
        "rms_mm": round(1e3 * float(rms[best]), 3),
        "rms_mm_without_delay": round(1e3 * float(rms[0]), 3),
        "rms_mm_by_delay_ms": {
            str(delay): round(1e3 * float(value), 3)
            for delay, value in zip(DELAYS_MS, rms, strict=True)
        },
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--episodes", type=int, default=3, help="of each task")
    options = parser.parse_args()
    measured = {task: compare(task, options.episodes, options.seed) for task in TASKS}
    document = write_result(
        "command_delay", {"tasks": measured}, options.out, seed=options.seed,
        config={"episodes": options.episodes, "delays_ms": list(DELAYS_MS)},
    )  # fmt: skip
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
