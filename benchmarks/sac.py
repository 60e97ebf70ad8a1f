"""Gradient updates per second of soft actor-critic, beside Stable-Baselines3's in the same run.

    python benchmarks/sac.py --json

Both learners get the same network (two hidden layers of 128; the peer and `plain` without
normalisation), the same batch shape and one thread, and take turns; time is the processor's,
so that other load on the machine counts little. `plain` and `layer_norm` are timed on a ready
batch. `with_replay` draws, relabels and rewards its batches, as training does; the peer's
`train` draws from its own, flat replay. Compare `with_replay` for what a user gets and `plain`
for the update alone.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from common import argument_parser, print_result, progress, write_result
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

from skewmi.sim import tasks
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.memory import keep_freed_memory
from skewmi.train.replay import Episodes, Replay
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.learner import SacLearner
from skewmi.train.sac.sac import Batch, Sac

HIDDEN = (128, 128)
ACTIONS = 3


class Shape(gymnasium.Env[Any, Any]):
    """Spaces only: the peer needs an environment to be constructed."""

    def __init__(self, inputs: int) -> None:
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (inputs,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)


def make_ours(batch_size: int, layer_norm: bool, inputs: int) -> Callable[[int], None]:
    """Updates on a ready batch."""
    sac = Sac(SacConfig(hidden=HIDDEN, layer_norm=layer_norm), inputs, ACTIONS, 0)
    batch = Batch(
        torch.randn(batch_size, inputs),
        2 * torch.rand(batch_size, ACTIONS) - 1,
        torch.randn(batch_size),
        torch.randn(batch_size, inputs),
        torch.full((batch_size,), 0.97),
    )

    def run(updates: int) -> None:
        for _ in range(updates):
            sac.update(batch)

    return run


def make_with_replay(batch_size: int) -> tuple[Callable[[int], None], int]:
    """Updates of the learner as it trains: drawn, relabelled, 3-step, LayerNorm critics."""
    layout = tasks.layout("open_press_close", time_input=True)
    rng = np.random.default_rng(0)
    exploration = SkewExplore(SkewExploreConfig(running_scale=False), layout, rng)
    config = SacConfig(hidden=HIDDEN, batch_size=batch_size)
    learner = SacLearner(config, layout, exploration.goal_dim, 0, "cpu")
    n, steps, d = 200, layout.episode_steps, layout.state_dim
    history = Replay(layout, n * steps, d)
    shape = (n, steps + 1, layout.observation_dim)
    episodes = Episodes(
        rng.random(shape),
        rng.uniform(-1, 1, (n, steps, ACTIONS)),
        rng.random((n, steps, d)),
        (rng.random((n, steps)) < 0.01).astype(float),
    )
    history.add(episodes, rng.normal(size=(n, steps)))

    def run(updates: int) -> None:
        for begin in range(0, updates, 32):
            count = min(32, updates - begin)
            batch = learner.draw(batch_size * count, history, exploration, rng)
            for k in range(count):
                learner.sac.update(batch.part(k * batch_size, (k + 1) * batch_size))

    return run, learner.inputs.dim


def make_peer(batch_size: int, inputs: int) -> Callable[[int], None]:
    """Stable-Baselines3's updates."""
    model = SAC(
        "MlpPolicy", Shape(inputs), batch_size=batch_size, buffer_size=50_000, device="cpu",
        policy_kwargs={"net_arch": list(HIDDEN)}, seed=0,
    )  # fmt: skip
    model.set_logger(configure(None, []))
    buffer, rng = model.replay_buffer, np.random.default_rng(0)
    for _ in range(5_000):
        x = rng.random((2, 1, inputs), dtype=np.float32)
        action = rng.uniform(-1, 1, (1, ACTIONS)).astype(np.float32)
        buffer.add(x[0], x[1], action, rng.random(1), np.zeros(1), [{}])

    def run(updates: int) -> None:
        model.train(updates, batch_size)

    return run


def compare(runs: dict[str, Callable[[int], None]], updates: int, rounds: int) -> dict[str, float]:
    """Median updates per second of processor time of each, taking turns."""
    speeds: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run(20)
    for _ in range(rounds):
        for name, run in runs.items():
            started = time.process_time()
            run(updates)
            speeds[name].append(updates / (time.process_time() - started))
    return {name: statistics.median(values) for name, values in speeds.items()}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="turns of each learner")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    keep_freed_memory()
    data: dict[str, Any] = {}
    for batch_size, updates in ((256, 100), (1024, 30)):
        with_replay, inputs = make_with_replay(batch_size)
        speeds = compare(
            {
                "plain": make_ours(batch_size, layer_norm=False, inputs=inputs),
                "layer_norm": make_ours(batch_size, layer_norm=True, inputs=inputs),
                "with_replay": with_replay,
                "stable_baselines3": make_peer(batch_size, inputs),
            },
            updates,
            options.rounds,
        )
        peer = speeds["stable_baselines3"]
        data[f"batch_{batch_size}"] = {
            "updates_per_second": {k: round(v, 1) for k, v in speeds.items()},
            "ratio_to_stable_baselines3": {
                k: round(v / peer, 2) for k, v in speeds.items() if k != "stable_baselines3"
            },
        }
        progress(f"batch {batch_size}: {data[f'batch_{batch_size}']}")
    config = {"hidden": HIDDEN, "threads": 1, "inputs": inputs, "actions": ACTIONS}
    document = write_result("sac", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
