"""A trained PPO + LSTM policy through the deployed chain: every action beside torch's.

    python benchmarks/recurrent_deployed.py --folder runs/recurrent --json

Trains a preset with a memory on a target of DoorOpen until it has converged or its steps are spent
(a run in the folder goes on; `--run` takes another as it is), exports it, and deploys the file on
the simulated robot over Zenoh in lock-step, with a recording. The observations that the chain
recorded then go, an episode at a time, through the network of the checkpoint as learning has it:
one `torch.nn.LSTM` over the whole sequence, with an empty memory at the episode's start. The
recorded actions have to be its mean actions.

Two controls show that this can fail: the same network with an empty memory at every step, and with
the memory of the episode before at the start of the next. Some twenty minutes of training, some
seconds an episode.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bundled_policy import run
from common import argument_parser, print_result, progress, write_result

from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array
from skewmi.sim.tasks.door_open.targets import TARGETS
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.learner import Hidden
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.learner import PpoLearner
from skewmi.train.state import as_array

TASK = "door_open"
TOLERANCE = 1e-5
"""Of an action, which is in [-1, 1]."""
EVALUATED = 200
"""Episodes in the batched simulation, to say what the policy is worth."""
CLEARLY = 1e-2
"""A control differs by at least this."""


@dataclass(frozen=True)
class Episode:
    """What the chain saw and did at each step. Shapes (steps, observation_dim or action_dim)."""

    observations: Array
    actions: Array


class Reference:
    """The network of a checkpoint as learning has it, towards the goal that was exported."""

    def __init__(self, run_dir: Path) -> None:
        self.config, self.layout = read_run_header(run_dir)
        learner = self.config.learner
        if not isinstance(learner, PpoConfig) or not learner.memory:
            raise ConfigurationError(f"the policy of {run_dir} has no memory; take one of PPO")
        self.memory = learner.memory
        self.state = read_checkpoint(run_dir).state
        self.goal = as_array(self.state["evaluation_goal"]).astype(np.float64)
        self.learner = PpoLearner(learner, self.layout, len(self.goal), 0, "cpu")
        self.learner.load_state_dict(self.state["learner"])
        self.network = self.learner.ppo.network.eval()

    def actions(self, observations: Array, memory: Hidden | None = None) -> tuple[Array, Hidden]:
        """Mean actions along an episode, and the memory at its end; None begins empty."""
        with torch.no_grad():
            hidden = self.network.empty(1) if memory is None else memory
            means, _, after = self.network(self._inputs(observations)[None], hidden)
        return _clipped(means[0]), after

    def forgetful(self, observations: Array) -> Array:
        """Mean actions with an empty memory at every step."""
        with torch.no_grad():
            inputs = self._inputs(observations)[:, None]
            means = self.network(inputs, self.network.empty(len(inputs)))[0]
        return _clipped(means[:, 0])

    def _inputs(self, observations: Array) -> torch.Tensor:
        goals = np.broadcast_to(self.goal, (len(observations), len(self.goal)))
        return self.learner.inputs(observations, goals)


def _clipped(means: torch.Tensor) -> Array:
    actions: Array = np.clip(means.double().numpy(), -1.0, 1.0)
    return actions


def trained(options: argparse.Namespace) -> Path:
    """The run: the one that was given, or one in the folder, trained as far as it goes."""
    if options.run is not None:
        return Path(options.run)
    run_dir = Path(options.folder) / "run"
    run(
        "train", "--task", TASK, "--preset", options.preset, "--option", f"target={options.target}",
        "--seed", str(options.seed), "--steps", str(options.steps), "--stop-on-convergence",
        "--resume", "--run-dir", str(run_dir),
    )  # fmt: skip
    return run_dir


def recorded(path: Path, steps: list[int], time: int) -> list[Episode]:
    """Episodes of a recording.

    Args:
        path: The recording.
        steps: Of each episode, as the deployment tells.
        time: Index of the time within the episode in an observation, which is 0 at its start.
    """
    messages = read_recording(path).messages
    seen = [decode_joint_states(m.payload) for m in messages[topics.POLICY_OBSERVATION.name]]
    acted = [decode_joint_states(m.payload) for m in messages[topics.POLICY_ACTION.name]]
    # The observation that ends an episode is recorded, too, but not acted on.
    observation_at = {state.stamp_ns: np.array(state.position) for state in seen}
    if len(acted) != sum(steps):
        raise RuntimeError(f"{len(acted)} actions are recorded, the report tells {sum(steps)}")
    episodes, begin = [], 0
    for count in steps:
        part = acted[begin : begin + count]
        begin += count
        observations = np.stack([observation_at[action.stamp_ns] for action in part])
        if observations[0, time] != 0.0 or (observations[1:, time] <= 0.0).any():
            raise RuntimeError("an episode in the recording does not begin where the report says")
        episodes.append(Episode(observations, np.array([action.position for action in part])))
    return episodes


def compare(reference: Reference, episodes: list[Episode]) -> dict[str, Any]:
    """Largest differences of an action's component: to torch, and to torch with a wrong memory."""
    same, forgetful, kept = [], [], []
    memory: Hidden | None = None
    for episode in episodes:
        expected, _ = reference.actions(episode.observations)
        same.append(np.abs(episode.actions - expected))
        forgetful.append(np.abs(episode.actions - reference.forgetful(episode.observations)))
        going_on, memory = reference.actions(episode.observations, memory)
        kept.append(np.abs(episode.actions - going_on))
    actions = np.concatenate([episode.actions for episode in episodes])
    # The first episode begins with an empty memory either way.
    not_reset = [float(difference.max()) for difference in kept[1:]]
    not_carried = [float(difference.max()) for difference in forgetful]
    largest = max(float(difference.max()) for difference in same)
    return {
        "episodes": len(episodes),
        "steps": len(actions),
        "actions_at_bound": float((np.abs(actions) >= 1.0).mean()),
        "largest_difference_to_torch": largest,
        "largest_difference_per_episode": [float(difference.max()) for difference in same],
        "equal_within_tolerance": largest <= TOLERANCE,
        "controls": {
            "memory_not_carried": {
                "smallest_of_episodes": min(not_carried),
                "largest": max(not_carried),
                "mean": float(np.concatenate(forgetful).mean()),
            },
            "memory_not_reset": {
                "smallest_of_episodes": min(not_reset, default=None),
                "largest": max(not_reset, default=None),
                "mean": float(np.concatenate(kept[1:]).mean()) if not_reset else None,
            },
        },
        "controls_fail_clearly_in_every_episode": min(not_carried + not_reset) >= CLEARLY,
        "memory_reset_in_every_episode": largest <= TOLERANCE
        and min(not_reset, default=0.0) >= CLEARLY,
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    run_dir = trained(options)
    reference = Reference(run_dir)
    state, config = reference.state, reference.config
    options.folder.mkdir(parents=True, exist_ok=True)
    policy, record = options.folder / "policy.onnx", options.folder / "run.mcap"
    exported = run("export-onnx", str(run_dir), "--out", str(policy), "--overwrite")
    evaluated = run(
        "evaluate", str(policy), "--episodes", str(EVALUATED), "--seed", str(options.seed)
    )
    many = ("--episodes", str(options.episodes), "--seed", str(options.seed))
    report = run(
        "deploy", str(policy), *many, "--lock-step", "--record", str(record), "--overwrite"
    )
    progress("comparing with torch")
    steps = [episode["steps"] for episode in report["per_episode"]]
    time = list(reference.layout.observation_names).index("time")
    return {
        "training": {
            "task": reference.layout.task,
            "preset": config.preset,
            "task_options": dict(config.task_options),
            "seed": config.seed,
            "memory": reference.memory,
            "steps": state["step"],
            "trajectories": state["episodes"],
            "converged_at": state["converged_at"],
            "converged_at_paper": state["converged_at_paper"],
        },
        "export": {"largest_difference_to_torch": exported["max_difference"]},
        "evaluate": {key: evaluated[key] for key in ("episodes", "successes")},
        "deployed": {
            "lock_step": report["lock_step"],
            "successes": report["successes"],
            "outcomes": [episode["outcome"] for episode in report["per_episode"]],
            "steps_per_episode": steps,
            "stops": report["stops"],
        },
        "comparison": compare(reference, recorded(record, steps, time)),
    }


def main() -> int:
    parser = argument_parser(__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="of run, policy and recording")
    parser.add_argument("--run", type=Path, help="of a PPO + LSTM run; takes it as it is")
    parser.add_argument("--preset", default="paper-reduced-ppo", help="with a memory; not of --run")
    parser.add_argument("--target", choices=[*TARGETS], default="t2", help="not of --run")
    parser.add_argument("--steps", type=int, default=600_000, help="of training, environment steps")
    parser.add_argument("--episodes", type=int, default=20, help="deployed")
    options = parser.parse_args()
    keys = ("preset", "target", "steps", "episodes") if options.run is None else ("episodes",)
    config = {key: getattr(options, key) for key in keys} | {"tolerance": TOLERANCE}
    document = write_result(
        "recurrent_deployed", measure(options), options.out, seed=options.seed, config=config
    )
    print_result(document, as_json=options.json)
    found = document["comparison"]
    held = found["equal_within_tolerance"] and found["controls_fail_clearly_in_every_episode"]
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
