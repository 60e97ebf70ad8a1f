"""Adversarial commands against the planner, judged by checks written without it.

    python tests/adversarial/planner_fuzz.py --cycles 1000000 --out results/planner_fuzz.json

Each round draws limits and a scene (`planner_scenes`), and then a second or more of commands each
of four kinds of adversary. Judged are (`planner_judge`)

- the executed stream, position samples on the 4 ms grid alone: their first, second and third
  differences against velocity, acceleration and jerk limits, position bounds, the tool's speed and
  the box by Pinocchio's kinematics;
- every chunk: it starts bit for bit where it must, its v and a are within limits and fit q, its
  tail ends at rest inside all limits, box included; and the deployed `ChunkChecker` accepts it;
- liveness: after every adversary the arm goes where it is told, and at the end back to the start.

Commands that are not numbers must be refused, leaving the planner as it was.

Round k has the seed SEED + k and depends on nothing else. Finished rounds are appended to a file
(`--rounds`, by default beside `--out`); a run that was killed and is started again goes on there.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

import result_document
from planner_fuzz_round import run_round

from skewmi.deploy.safety.limits import LimitUsage

SOURCES = (
    "skewmi/deploy/motion/*.py",
    "skewmi/deploy/safety/limits.py",
    "skewmi/robot_models/*.py",
    "tests/adversarial/planner_[fjs]*.py",
)
"""What a round's outcome depends on."""


@dataclass
class Totals:
    """What all rounds came to."""

    cycles: int = 0
    """All, the ways back included."""
    rounds: int = 0
    seconds: float = 0.0
    refused: int = 0
    breaches: list[str] = field(default_factory=list)
    adversaries: Counter[str] = field(default_factory=Counter)
    continued: Counter[str] = field(default_factory=Counter)
    scenes: Counter[str] = field(default_factory=Counter)
    faces: Counter[str] = field(default_factory=Counter)
    bounds: Counter[str] = field(default_factory=Counter)
    usage: dict[str, dict[str, float]] = field(default_factory=dict)
    checker: LimitUsage = field(default_factory=LimitUsage)
    near_singular_cycles: int = 0
    smallest_singular_value: float = np.inf
    worst_return_mm: float = 0.0

    def add(self, result: dict[str, Any]) -> None:
        """Count a round."""
        self.rounds += 1
        self.cycles += result["cycles"]
        self.seconds += result["seconds"]
        self.refused += result["refused"]
        self.adversaries.update(result["adversaries"])
        self.continued.update(result["continued"])
        self.scenes[result["scene"]] += 1
        usage = self.usage.setdefault(result["profile"], {})
        for name, fraction in result["usage"].items():
            usage[name] = max(usage.get(name, 0.0), fraction)
        self.checker = self.checker.merged(LimitUsage(**result["checker"]))
        self.worst_return_mm = max(self.worst_return_mm, result["return_mm"])
        if result["breach"] is not None:
            self.breaches.append(result["breach"])
            return
        self.faces.update(result["faces"])
        self.bounds.update(result["bounds"])
        self.near_singular_cycles += result["near_singular_cycles"]
        self.smallest_singular_value = min(
            self.smallest_singular_value, result["smallest_singular_value"]
        )

    @property
    def adversarial_cycles(self) -> int:
        """Those that an adversary commanded."""
        return sum(self.adversaries.values())

    def figures(self) -> dict[str, Any]:
        """For the result document."""
        return {
            "adversarial_cycles": self.adversarial_cycles,
            "cycles_with_ways_back": self.cycles,
            "rounds": self.rounds,
            "breaches": len(self.breaches),
            "breaches_in_words": self.breaches[:20],
            "fractions_of_limits": {
                profile: {name: round(value, 6) for name, value in sorted(usage.items())}
                for profile, usage in sorted(self.usage.items())
            },
            "checker_fractions": self.checker.as_dict(),
            "continued_previous_stop": dict(self.continued),
            "cycles_by_adversary": dict(self.adversaries),
            "refused_commands": self.refused,
            "rounds_by_scene": dict(sorted(self.scenes.items())),
            "rounds_that_reached_face": dict(sorted(self.faces.items())),
            "rounds_that_reached_joint_bound": dict(sorted(self.bounds.items())),
            "near_singular_cycles": self.near_singular_cycles,
            "smallest_singular_value_m": self.smallest_singular_value,
            "worst_return_mm": self.worst_return_mm,
            "processor_s": round(self.seconds, 1),
        }


def results(seeds: Iterator[int], processes: int) -> Iterator[dict[str, Any]]:
    """Rounds as they are finished; the consumer stops when it has enough."""
    if processes == 1:
        yield from map(run_round, seeds)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        running: set[Future[dict[str, Any]]] = set()
        try:
            while True:
                while len(running) < 2 * processes:
                    running.add(pool.submit(run_round, next(seeds)))
                done, running = wait(running, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        finally:
            for future in running:
                future.cancel()


def fingerprint() -> str:
    """Hash of the sources that rounds depend on."""
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for path in sorted(result_document.REPOSITORY.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class RoundLog:
    """Finished rounds in a file, one JSON document a line, after a line that says of what."""

    def __init__(self, path: Path, seed: int) -> None:
        self._path = path
        header = {"seed": seed, "sources": fingerprint()}
        self.done: list[dict[str, Any]] = []
        whole = path.read_text(encoding="utf-8") if path.exists() else ""
        # A line that was cut off when the run was killed does not count.
        whole = whole[: whole.rfind("\n") + 1]
        if whole:
            first, *rounds = map(json.loads, whole.splitlines())
            if first != header:
                raise SystemExit(
                    f"{path} holds rounds of {first}, this run is {header}: "
                    "remove it or give another file (--rounds)"
                )
            self.done = rounds
        else:
            whole = json.dumps(header) + "\n"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(whole, encoding="utf-8")

    def append(self, result: dict[str, Any]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")

    def remove(self) -> None:
        self._path.unlink()


def fuzz(
    cycles: int,
    seed: int,
    *,
    seconds: float = np.inf,
    processes: int = 1,
    log: RoundLog | None = None,
) -> Totals:
    """Rounds until the adversaries' cycles or the time are used up; breaches are counted."""
    totals = Totals()
    done: set[int] = set()
    for result in log.done if log else ():
        totals.add(result)
        done.add(result["seed"])
    before = totals.adversarial_cycles
    begin = last = time.monotonic()
    seeds = (number for number in range(seed, sys.maxsize) if number not in done)
    if before >= cycles:
        return totals
    for result in results(seeds, processes):
        totals.add(result)
        if log:
            log.append(result)
        if result["breach"]:
            result_document.progress(f"BREACH: {result['breach']}")
        now, count = time.monotonic(), totals.adversarial_cycles
        if count >= cycles or now - begin > seconds:
            break
        if now - last > 10.0:
            last, rate = now, (count - before) / (now - begin)
            result_document.progress(
                f"{count} of {cycles} cycles, {totals.rounds} rounds, "
                f"{len(totals.breaches)} breaches, {rate:.0f} cycles/s, "
                f"{(cycles - count) / rate / 60:.1f} min to go"
            )
    return totals


def main() -> int:
    parser = result_document.argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--cycles", type=int, default=20_000, help="cycles of 20 ms that adversaries command"
    )
    parser.add_argument("--processes", type=int, default=1, help="rounds at the same time")
    parser.add_argument(
        "--rounds", type=Path, default=None, help="file of finished rounds, to go on from"
    )
    options = parser.parse_args()
    # Of what this process has loaded: files may change before it ends.
    sources = fingerprint()
    path = options.rounds
    if path is None and options.out is not None:
        path = options.out.with_suffix(".rounds.jsonl")
    log = RoundLog(path, options.seed) if path is not None else None
    totals = fuzz(options.cycles, options.seed, processes=options.processes, log=log)
    config = {"cycles": options.cycles, "sources": sources}
    document = result_document.write_result(
        "planner_fuzz", totals.figures(), options.out, seed=options.seed, config=config
    )
    if log is not None and options.rounds is None:
        log.remove()
    result_document.print_result(document, as_json=options.json)
    return 1 if totals.breaches else 0


if __name__ == "__main__":
    sys.exit(main())
