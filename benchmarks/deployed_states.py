"""The states of an episode, deployed and in the batched simulation, side by side.

    python benchmarks/deployed_states.py --policy open_press_close

Runs a policy through the deployed chain (planner, limits, guard, Zenoh, simulated robot in its own
process, in lock-step) and in the batched simulation, some episodes each, and draws every observed
state over time: what the chain adds (lag, shaping, other contact) shows where the bundles part.
Writes a document with the times of each stage and, beside it, the picture. About a minute.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from common import REPOSITORY, argument_parser, print_result, progress, write_result
from numpy.typing import NDArray

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.policy import OnnxPolicy
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.evaluation.rollout import run_episodes
from skewmi.policy_io import PolicyLayout
from skewmi.sim import tasks

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Array = NDArray[np.float64]


def simulated(policy: OnnxPolicy, episodes: int, seed: int) -> list[Array]:
    """Observations up to success, an episode each. Shapes (steps, observation_dim)."""
    trained_with = policy.metadata.get("task_options") or {}
    switches = tasks.find(policy.layout.task).layout_switches
    options = {name: value for name, value in trained_with.items() if name in switches}
    env = tasks.make_batch(policy.layout.task, episodes, num_threads=1, seed=seed, **options)
    run = run_episodes(policy, env, episodes, seed)
    ends = np.where(run.success, run.first_success_step, policy.layout.episode_steps)
    return [run.observation[:end, i] for i, end in enumerate(ends)]


def deployed(policy: OnnxPolicy, episodes: int, seed: int) -> list[Array]:
    """The same through the deployed chain."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        run_deploy(policy, DeployOptions(episodes=episodes, seed=seed, lock_step=True, record=path))
        messages = read_recording(path).messages[topics.POLICY_OBSERVATION.name]
    names = list(policy.layout.observation_names)
    time = names.index("time")
    runs: list[list[Array]] = []
    for message in messages:
        state = decode_joint_states(message.payload)
        values = np.array([state.position[state.names.index(name)] for name in names])
        if values[time] == 0.0:
            runs.append([])
        runs[-1].append(values)
    return [np.array(run) for run in runs]


def stages(layout: PolicyLayout, runs: list[Array]) -> dict[str, Any]:
    """When what happened, s: median over episodes, None where it did not in half of them."""
    names, dt = layout.observation_names, layout.control_dt
    lid, button = names.index("lid_angle"), names.index("button_depth")

    def first(hits: NDArray[np.bool_]) -> float:
        return float(np.argmax(hits)) * dt if hits.any() else float("inf")

    times = {
        "lid above 90 deg": [first(run[:, lid] > np.pi / 2) for run in runs],
        "button pressed": [first(run[:, button] > 0.010) for run in runs],
        "success": [
            len(run) * dt if len(run) < layout.episode_steps else float("inf") for run in runs
        ],
    }
    medians = {name: float(np.median(values)) for name, values in times.items()}
    return {name: value if np.isfinite(value) else None for name, value in medians.items()}


def draw(layout: PolicyLayout, sim: list[Array], real: list[Array], path: Path) -> None:
    """One panel per state field."""
    fields = layout.state_fields
    figure, axes = plt.subplots(2, (len(fields) + 1) // 2, figsize=(13, 6), sharex=True)
    for i, (field, axis) in enumerate(zip(fields, axes.flat, strict=False)):
        for runs, colour, label in ((sim, "tab:blue", "simulated"), (real, "tab:red", "deployed")):
            for k, run in enumerate(runs):
                time = np.arange(len(run)) * layout.control_dt
                name = label if k == 0 else None
                axis.plot(time, run[:, i], color=colour, alpha=0.5, linewidth=0.9, label=name)
        axis.set_title(f"{field.name} [{field.unit}]", fontsize=10)
        axis.grid(alpha=0.3)
    axes.flat[0].legend()
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def main() -> int:
    parser: argparse.ArgumentParser = argument_parser(__doc__)
    parser.set_defaults(out=REPOSITORY / "results" / "deployed_states.json")
    parser.add_argument("--policy", default="open_press_close", help="bundled name or file")
    parser.add_argument("--episodes", type=int, default=10, help="of each kind")
    options = parser.parse_args()
    policy = OnnxPolicy.load(options.policy)
    progress("simulated episodes")
    sim = simulated(policy, options.episodes, options.seed)
    progress("deployed episodes")
    real = deployed(policy, options.episodes, options.seed)
    draw(policy.layout, sim, real, options.out.with_suffix(".png"))
    data = {
        "policy": options.policy,
        "median_time_s": {
            "simulated": stages(policy.layout, sim),
            "deployed": stages(policy.layout, real),
        },
        "steps": {
            "simulated": [len(run) for run in sim],
            "deployed": [len(run) for run in real],
        },
    }
    config = {"policy": options.policy, "episodes": options.episodes}
    document = write_result("deployed_states", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
