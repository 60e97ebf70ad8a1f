"""Time of a gradient update of soft actor-critic, beside others' in the same run.

    python benchmarks/sac.py --json

For several sizes of networks and batches, on one thread, these take turns; time is the processor's,
so that other load on the machine counts little:

- `compiled`, `eager`: our update with both engines; critics with LayerNorm, on a ready batch.
- `straightforward`: the same update in plain torch (`tests/support/plain_sac.py`), on the same
  batch, with our allocator settings. `tests/train/sac/test_witness.py` holds that it is the same.
- `gemm`: the matrix products of an update, bare (`tests/support/update_products.py`). The same
  test holds that they are those of our update.
- `compiled_plain`: as `compiled`, critics without LayerNorm.
- `with_replay`: as `compiled`, on batches drawn, relabelled and rewarded as training does.
- `stable_baselines3`: its `train`: networks of the same size without LayerNorm, one-step targets,
  batches drawn from its own, flat replay.

Ratios are of medians over the turns; `within_turns` has the smallest and the largest within a turn.
`ratio_to_eager` is `compiled` / `straightforward`, time per update; `share_of_gemm` is `gemm` /
`compiled`; `ratio_to_stable_baselines3` is how many times as many updates as that peer makes.
Compare `with_replay` for what a user gets and `compiled_plain` for the update alone. Where nothing
can be compiled, the engines are the same, and `engine` says so. Compiling takes a minute or two for
each size, which no figure counts; `seconds_to_first` says how long everybody took to start.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import torch
from common import argument_parser, print_result, progress, write_result
from plain_sac import PlainSac
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger
from update_products import UpdateProducts

from skewmi.sim import tasks
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.memory import keep_freed_memory
from skewmi.train.replay import Episodes, Replay
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.learner import SacLearner
from skewmi.train.sac.sac import Batch, Sac

Runs = dict[str, Callable[[int], None]]
"""By name: makes so many updates."""
Hidden = tuple[int, ...]

SIZES = ("128-128/256", "64-64/256", "128-128/1024")
"""Hidden layers and transitions of a batch."""
ACTIONS = 3
FIRST_UPDATES = 20
"""Before any is timed: the first few are eager, then one compiles."""


class Shape(gymnasium.Env[Any, Any]):
    """Spaces only: the peer needs an environment to be constructed."""

    def __init__(self, inputs: int) -> None:
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (inputs,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)


def random_batch(batch_size: int, inputs: int) -> Batch:
    """Transitions that are ready."""
    return Batch(
        torch.randn(batch_size, inputs),
        2 * torch.rand(batch_size, ACTIONS) - 1,
        torch.randn(batch_size),
        torch.randn(batch_size, inputs),
        torch.full((batch_size,), 0.97),
    )


def make_ours(config: SacConfig, batch: Batch) -> Callable[[int], None]:
    """Updates on a ready batch."""
    sac = Sac(config, batch.inputs.shape[1], ACTIONS, 0)

    def run(updates: int) -> None:
        for _ in range(updates):
            sac.update(batch)

    return run


def make_straightforward(config: SacConfig, batch: Batch) -> Callable[[int], None]:
    """The witness, on the same batch."""
    plain = PlainSac(
        batch.inputs.shape[1], ACTIONS, hidden=config.hidden, layer_norm=config.layer_norm,
        learning_rate=config.learning_rate, polyak=config.polyak,
        initial_temperature=config.initial_temperature, target_entropy=-float(ACTIONS),
        log_std_bounds=(config.log_std_min, config.log_std_max), seed=0,
    )  # fmt: skip
    tensors = batch.inputs, batch.actions, batch.returns, batch.next_inputs, batch.discounts

    def run(updates: int) -> None:
        for _ in range(updates):
            plain.update(*tensors)

    return run


def make_gemm(hidden: Hidden, batch: Batch) -> Callable[[int], None]:
    """The bare products."""
    products = UpdateProducts(batch.inputs.shape[1], ACTIONS, hidden, len(batch))

    def run(updates: int) -> None:
        for _ in range(updates):
            products.run()

    return run


def make_with_replay(config: SacConfig) -> tuple[Callable[[int], None], int]:
    """Updates of the learner as it trains, drawn, relabelled, 3-step; its number of inputs."""
    batch_size = config.batch_size
    layout = tasks.layout("open_press_close", time_input=True)
    rng = np.random.default_rng(0)
    exploration = SkewExplore(SkewExploreConfig(running_scale=False), layout, rng)
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


def make_peer(hidden: Hidden, batch_size: int, inputs: int) -> Callable[[int], None]:
    """Stable-Baselines3's updates."""
    model = SAC(
        "MlpPolicy", Shape(inputs), batch_size=batch_size, buffer_size=50_000, device="cpu",
        policy_kwargs={"net_arch": list(hidden)}, seed=0,
    )  # fmt: skip
    model.set_logger(Logger(None, []))  # another makes a folder and leaves it
    buffer, rng = model.replay_buffer, np.random.default_rng(0)
    for _ in range(5_000):
        x = rng.random((2, 1, inputs), dtype=np.float32)
        action = rng.uniform(-1, 1, (1, ACTIONS)).astype(np.float32)
        buffer.add(x[0], x[1], action, rng.random(1), np.zeros(1), [{}])

    def run(updates: int) -> None:
        model.train(updates, batch_size)

    return run


def make_all(hidden: Hidden, batch_size: int, engine: str) -> tuple[Runs, int]:
    """Everybody that takes turns, and how many inputs the networks have.

    Args:
        hidden, batch_size: The size.
        engine: What `compiled` is here, see `SacConfig`.
    """
    config = SacConfig(hidden=hidden, batch_size=batch_size, engine=engine, compile_after=2)
    with_replay, inputs = make_with_replay(config)
    batch = random_batch(batch_size, inputs)
    return {
        "compiled": make_ours(config, batch),
        "eager": make_ours(replace(config, engine="eager"), batch),
        "straightforward": make_straightforward(config, batch),
        "gemm": make_gemm(hidden, batch),
        "compiled_plain": make_ours(replace(config, layer_norm=False), batch),
        "with_replay": with_replay,
        "stable_baselines3": make_peer(hidden, batch_size, inputs),
    }, inputs


def take_turns(runs: Runs, updates: int, rounds: int) -> dict[str, list[float]]:
    """Processor time per update of each in every round, s."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            started = time.process_time()
            run(updates)
            times[name].append((time.process_time() - started) / updates)
    return times


def ratio(times: dict[str, list[float]], one: str, other: str) -> tuple[float, list[float]]:
    """Of the medians of two, and the smallest and the largest of those within a turn."""
    within = [a / b for a, b in zip(times[one], times[other], strict=True)]
    of_medians = statistics.median(times[one]) / statistics.median(times[other])
    return round(of_medians, 3), [round(min(within), 3), round(max(within), 3)]


def ratios(times: dict[str, list[float]]) -> dict[str, Any]:
    """Those that the document tells, and `within_turns` their spread."""
    single = {
        "ratio_to_eager": ratio(times, "compiled", "straightforward"),
        "ratio_to_own_eager": ratio(times, "compiled", "eager"),
        "share_of_gemm": ratio(times, "gemm", "compiled"),
    }
    names = ("compiled", "compiled_plain", "eager", "with_replay")
    peer = {name: ratio(times, "stable_baselines3", name) for name in names}
    to_peer = "ratio_to_stable_baselines3"
    return {
        **{name: value for name, (value, _) in single.items()},
        to_peer: {name: value for name, (value, _) in peer.items()},
        "within_turns": {
            **{name: spread for name, (_, spread) in single.items()},
            to_peer: {name: spread for name, (_, spread) in peer.items()},
        },
    }


def size_of(text: str) -> tuple[Hidden, int]:
    """Hidden layers and transitions of a batch, from what `SIZES` has.

    Raises:
        ValueError: It is no such text.
    """
    hidden, batch_size = text.split("/")
    return tuple(int(units) for units in hidden.split("-")), int(batch_size)


def compare(hidden: Hidden, batch_size: int, updates: int, rounds: int) -> dict[str, Any]:
    """What the document says of one size."""
    torch.compiler.reset()  # or what it compiles now is for shapes that change
    engine = Sac(SacConfig(), 1, 1, 0).engine
    runs, inputs = make_all(hidden, batch_size, engine)
    first = {}
    for name, run in runs.items():
        started = time.perf_counter()
        run(FIRST_UPDATES)
        first[name] = round(time.perf_counter() - started, 1)
        progress(f"  {name}: ready after {first[name]} s")
    times = take_turns(runs, updates, rounds)
    medians = {name: statistics.median(values) for name, values in times.items()}
    return {
        "hidden": hidden,
        "batch_size": batch_size,
        "inputs": inputs,
        "engine": engine,
        "milliseconds_per_update": {
            name: [round(1e3 * value, 3) for value in (min(values), medians[name], max(values))]
            for name, values in times.items()
        },
        "updates_per_second": {name: round(1.0 / value, 1) for name, value in medians.items()},
        **ratios(times),
        "seconds_to_first": first,
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=9, help="turns of each")
    parser.add_argument(
        "--transitions", type=int, default=20_000, help="in the batches of a turn: its length"
    )
    parser.add_argument(
        "--sizes", nargs="+", default=[*SIZES], help="hidden layers and transitions of a batch"
    )
    options = parser.parse_args()
    try:
        sizes = [size_of(text) for text in options.sizes]
    except ValueError:
        parser.error(f"--sizes {' '.join(options.sizes)}: they look like {SIZES[0]}")
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    keep_freed_memory()
    data: dict[str, Any] = {}
    for hidden, batch_size in sizes:
        name = f"{'-'.join(map(str, hidden))}_batch_{batch_size}"
        progress(f"{name}:")
        updates = max(1, options.transitions // batch_size)
        data[name] = compare(hidden, batch_size, updates, options.rounds)
        for figure in ("ratio_to_eager", "share_of_gemm", "ratio_to_stable_baselines3"):
            progress(f"  {figure}: {data[name][figure]}")
    config = {
        "threads": 1,
        "actions": ACTIONS,
        "rounds": options.rounds,
        "transitions_per_turn": options.transitions,
    }
    document = write_result("sac", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
