"""Time of a gradient update of soft actor-critic on a GPU, by engine, beside the CPU's best.

    python benchmarks/sac_gpu.py --json

On a ready batch, for several sizes of networks and batches, these take turns:

- `eager`: operation by operation, on the GPU.
- `captured`: as one CUDA graph, what training takes there.
- `captured_fused`: the same, of kernels that torch's inductor has fused; left out where it cannot.
- `cpu`: the best engine of the device cpu, on one thread, in the same process.
- `captured_replay`: as `captured`, on batches drawn, relabelled and rewarded as training does.

Time is the wall's, from the first call to the end of the GPU's work. Ratios are of medians over the
turns. Errors are the largest relative differences of the networks from `eager`'s after 50 updates
with the same batches and random numbers.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from common import argument_parser, print_result, progress, write_result

from skewmi.sim import tasks
from skewmi.train.exploration.skew_explore import SkewExplore, SkewExploreConfig
from skewmi.train.replay import Episodes, Replay
from skewmi.train.sac.captured import CapturedUpdate
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.learner import SacLearner
from skewmi.train.sac.sac import Batch, Sac
from skewmi.train.sac.update_function import state_of

SIZES = (((64, 64), 256), ((128, 128), 256), ((128, 128), 1024), ((256, 256), 1024))
INPUTS, ACTIONS = 13, 3
FIRST_UPDATES = 20

Run = Callable[[int], None]


def random_batch(size: int, device: str) -> Batch:
    """Transitions that are ready."""
    g = torch.Generator().manual_seed(size)
    return Batch(
        torch.randn(size, INPUTS, generator=g).to(device),
        (2 * torch.rand(size, ACTIONS, generator=g) - 1).to(device),
        torch.randn(size, generator=g).to(device),
        torch.randn(size, INPUTS, generator=g).to(device),
        torch.full((size,), 0.97, device=device),
    )


def make_sac(config: SacConfig, device: str, backend: str | None = None) -> Sac:
    """A learner that has its engine; with a backend, the captured one with fused kernels."""
    sac = Sac(config, INPUTS, ACTIONS, 0, device)
    batch = random_batch(config.batch_size, device)
    for _ in range(config.compile_after):
        sac.update(batch)
    if backend is not None:
        sac._whole = CapturedUpdate(sac, backend)
    return sac


def repeated(sac: Sac, batch: Batch) -> Run:
    """Updates on one batch, until the GPU is done."""

    def run(updates: int) -> None:
        for _ in range(updates):
            sac.update(batch)
        if sac.device.type == "cuda":
            torch.cuda.synchronize()

    return run


def with_replay(config: SacConfig) -> Run:
    """Updates of the learner as it trains on the GPU, drawn from a history on the CPU."""
    layout = tasks.layout("open_press_close", time_input=True)
    rng = np.random.default_rng(0)
    exploration = SkewExplore(SkewExploreConfig(running_scale=False), layout, rng)
    learner = SacLearner(config, layout, exploration.goal_dim, 0, "cuda")
    n, steps, d = 200, layout.episode_steps, layout.state_dim
    history = Replay(layout, n * steps, d)
    episodes = Episodes(
        rng.random((n, steps + 1, layout.observation_dim)),
        rng.uniform(-1, 1, (n, steps, ACTIONS)),
        rng.random((n, steps, d)),
        (rng.random((n, steps)) < 0.01).astype(float),
    )
    history.add(episodes, rng.normal(size=(n, steps)))

    def run(updates: int) -> None:
        size = config.batch_size
        for begin in range(0, updates, 32):
            count = min(32, updates - begin)
            batch = learner.draw(size * count, history, exploration, rng)
            for k in range(count):
                learner.sac.update(batch.part(k * size, (k + 1) * size))
        torch.cuda.synchronize()

    return run


def error(sac: Sac, reference: Sac) -> float:
    """Largest relative difference of a group of tensors (networks, moments) of two learners."""
    found = 0.0
    for group, expected in zip(state_of(sac)[0], state_of(reference)[0], strict=True):
        away = sum(float((a - b).square().sum()) for a, b in zip(group, expected, strict=True))
        size = sum(float(b.square().sum()) for b in expected)
        found = max(found, (away / size) ** 0.5)
    return found


def compare(hidden: tuple[int, ...], size: int, updates: int, rounds: int) -> dict[str, Any]:
    """All engines in turns."""
    torch.compiler.reset()
    eager = SacConfig(hidden=hidden, batch_size=size, engine="eager", compile_after=2)
    captured = replace(eager, engine="captured")
    learners = {"eager": make_sac(eager, "cuda"), "captured": make_sac(captured, "cuda")}
    try:
        learners["captured_fused"] = make_sac(captured, "cuda", "inductor")
        learners["captured_fused"].update(random_batch(size, "cuda"))
        learners["captured_fused"] = make_sac(captured, "cuda", "inductor")
    except Exception as problem:  # no compiler for it: any error of torch's
        learners.pop("captured_fused", None)
        progress(f"  captured_fused is left out: {str(problem).splitlines()[0]}")
    batch = random_batch(size, "cuda")
    for sac in learners.values():
        repeated(sac, batch)(50)
    errors = {name: error(sac, learners["eager"]) for name, sac in learners.items()}
    runs = {name: repeated(sac, batch) for name, sac in learners.items()}
    runs["captured_replay"] = with_replay(captured)
    runs["cpu"] = repeated(
        make_sac(replace(eager, engine="auto"), "cpu"), random_batch(size, "cpu")
    )
    times: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run(FIRST_UPDATES)
    for _ in range(rounds):
        for name, run in runs.items():
            started = time.perf_counter()
            run(updates)
            times[name].append((time.perf_counter() - started) / updates)
    medians = {name: statistics.median(values) for name, values in times.items()}
    return {
        "hidden": hidden,
        "batch_size": size,
        "microseconds_per_update": {
            name: [round(1e6 * v, 1) for v in (min(values), medians[name], max(values))]
            for name, values in times.items()
        },
        "times_as_fast_as_eager": {n: round(medians["eager"] / v, 2) for n, v in medians.items()},
        "relative_error": {name: float(f"{value:.2g}") for name, value in errors.items()},
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=9, help="turns of each")
    parser.add_argument("--updates", type=int, default=200, help="in a turn")
    options = parser.parse_args()
    if not torch.cuda.is_available():
        parser.error("this machine has no CUDA GPU that torch can use")
    torch.set_num_threads(1)
    data: dict[str, Any] = {"gpu": torch.cuda.get_device_name()}
    for hidden, size in SIZES:
        name = f"{'-'.join(map(str, hidden))}_batch_{size}"
        data[name] = compare(hidden, size, options.updates, options.rounds)
        progress(f"{name}: {data[name]['microseconds_per_update']} {data[name]['relative_error']}")
    config = {"threads": 1, "updates_per_turn": options.updates, "rounds": options.rounds}
    document = write_result("sac_gpu", data, options.out, seed=options.seed, config=config)
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
