"""Adversarial commands against the planner, judged by checks written without it.

    python benchmarks/planner_fuzz.py --cycles 1000000 --out results/planner_fuzz.json

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

sys.path.insert(0, str(Path(__file__).resolve().parent))

import common
from planner_judge import Breach, Judge, UrdfArm
from planner_scenes import ADVERSARIES, Command, commands, draw_scene, not_numbers

from skewmi.deploy.limits import ChunkChecker, LimitUsage
from skewmi.deploy.motion.planner import Planner
from skewmi.errors import LimitViolationError, SkewmiError
from skewmi.robot_models.kinematics import ArmKinematics

CYCLES_PER_ADVERSARY = 50
ADVERSARIES_PER_ROUND = 4
ARRIVED = 1e-3
"""Distance from its target at which the hand has arrived, m."""

SOURCES = (
    "skewmi/deploy/motion/*.py",
    "skewmi/deploy/limits.py",
    "skewmi/robot_models/*.py",
    "benchmarks/planner_[fjs]*.py",
)
"""What a round's outcome depends on."""


class _Episode:
    """One planner under attack."""

    def __init__(self, rng: np.random.Generator, arm: UrdfArm) -> None:
        self.rng, self._arm = rng, arm
        kinematics = ArmKinematics("right")
        self.scene, self.workspace, bounds = draw_scene(rng, kinematics)
        self.profile = bounds.name
        self.planner = Planner(self.workspace, bounds)
        start = np.array(self.workspace.start_configuration)
        self.planner.reset(start)
        self.judge = Judge(bounds, self.workspace, arm, executed=[start[None]])
        self._checker = ChunkChecker(bounds, self.workspace, kinematics.forward)
        self.usage = LimitUsage()
        self._chunk = self.planner.step(0)
        self.cycles = self.refused = 0
        self.kinds: Counter[str] = Counter()
        self.continued: Counter[str] = Counter()
        self.worst_return = 0.0
        # The longest way in the box, at half the speed it is planned with.
        travel = np.linalg.norm(np.array(self.workspace.high) - np.array(self.workspace.low))
        self._patience = int((2.0 * travel / self.planner.hand_bounds.speed + 3.0) / 0.02)

    def cycle(self, splice: int = 5) -> None:
        """Execute the present chunk up to sample `splice`, and plan on from there."""
        chunk = self._chunk
        state = chunk.state(splice)
        rows = np.minimum(np.arange(1, splice + 1), len(chunk.q) - 1)
        self.judge.executed.append(chunk.q[rows])
        self._chunk = chunk = self.planner.step(None if splice == 5 else splice)
        parts = chunk.q, chunk.v, chunk.a
        self.judge.add(parts, state)
        self.usage = self.usage.merged(self._checker.check(*parts, state))
        if chunk.continued:
            self.continued[chunk.continued] += 1
        self.cycles += 1

    def attack(self, kind: str) -> None:
        """Give the commands of an adversary."""
        source = commands(kind, self.workspace, self.rng)
        for _ in range(CYCLES_PER_ADVERSARY):
            command = next(source)
            if command is not None:
                self._command(command)
            splice = 5
            if kind == "late" and self.rng.random() < 0.3:
                splice = int(self.rng.integers(1, 45))
            self.cycle(splice)
        self.kinds[kind] += CYCLES_PER_ADVERSARY
        self._command(not_numbers(self.planner.command_position, self.rng))

    def _command(self, command: Command) -> None:
        """What is no number must be refused and change nothing; all else must be taken."""
        target, duration = command
        if np.isfinite(target).all() and np.isfinite(duration) and duration > 0.0:
            self.planner.set_target(target, duration)
            return
        before = self.planner.command_position
        try:
            self.planner.set_target(target, duration)
        except LimitViolationError:
            if not np.array_equal(before, self.planner.command_position):
                raise Breach("a refused target changed the command") from None
            self.refused += 1
            return
        raise Breach(f"the target {target} in {duration} s was accepted")

    def _off_start(self) -> float:
        hand = self._arm.positions(self._chunk.q[-1:])[0] + self.workspace.base_position
        return float(np.linalg.norm(hand - np.array(self.workspace.start)))

    def go_back(self, share: float) -> None:
        """Ask for the start position, and wait until the given share of the way is left."""
        off = self._off_start()
        goal = max(ARRIVED, share * off)
        self.planner.set_target(np.array(self.workspace.start), 0.5)
        for _ in range(self._patience):
            if off <= goal:
                break
            self.cycle()
            off = self._off_start()
        if off > goal:
            raise Breach(
                f"the hand is {1e3 * off:.2f} mm away from where it was told to go, "
                f"not {1e3 * goal:.2f} mm"
            )
        if share == 0.0:
            self.worst_return = off

    def finish(self) -> dict[str, object]:
        self.judge.executed.append(self._chunk.q[1:])
        return self.judge.finish()


_ARM: list[UrdfArm] = []


def run_round(seed: int) -> dict[str, Any]:
    """One scene, several adversaries, after each a part of the way back, at last all of it.

    Returns:
        What came of it, fit for JSON; `breach` says what was broken, None if nothing was.
    """
    if not _ARM:
        _ARM.append(UrdfArm())
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    breach, kind, reached = None, "start", {}
    episode = _Episode(rng, _ARM[0])
    try:
        for kind in map(str, rng.choice(ADVERSARIES, ADVERSARIES_PER_ROUND, replace=False)):
            episode.attack(kind)
            episode.go_back(0.5)
            episode.judge.settle()
        kind = "return"
        episode.go_back(0.0)
        reached = episode.finish()
    except (Breach, SkewmiError) as error:
        breach = (
            f"round seed {seed} ({episode.scene}, {episode.profile}, {kind}), "
            f"cycle {episode.cycles}: {error}"
        )
    return {
        "seed": seed,
        "breach": breach,
        "scene": f"{episode.scene} {episode.profile}",
        "profile": episode.profile,
        "cycles": episode.cycles,
        "adversaries": dict(episode.kinds),
        "refused": episode.refused,
        "usage": episode.judge.usage,
        "checker": episode.usage.as_dict(),
        "continued": dict(episode.continued),
        "return_mm": 1e3 * episode.worst_return,
        "seconds": time.perf_counter() - begin,
        **reached,
    }


@dataclass
class Totals:
    """What all rounds came to."""

    cycles: int = 0
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

    def figures(self) -> dict[str, Any]:
        """For the result document."""
        return {
            "cycles": self.cycles,
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
        for path in sorted(common.REPOSITORY.glob(pattern)):
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
    """Rounds until the number of cycles or the time is reached; breaches are counted."""
    totals = Totals()
    done: set[int] = set()
    for result in log.done if log else ():
        totals.add(result)
        done.add(result["seed"])
    before = totals.cycles
    begin = last = time.monotonic()
    seeds = (number for number in range(seed, sys.maxsize) if number not in done)
    if totals.cycles >= cycles:
        return totals
    for result in results(seeds, processes):
        totals.add(result)
        if log:
            log.append(result)
        if result["breach"]:
            common.progress(f"BREACH: {result['breach']}")
        now = time.monotonic()
        if totals.cycles >= cycles or now - begin > seconds:
            break
        if now - last > 10.0:
            last, rate = now, (totals.cycles - before) / (now - begin)
            common.progress(
                f"{totals.cycles} of {cycles} cycles, {totals.rounds} rounds, "
                f"{len(totals.breaches)} breaches, {rate:.0f} cycles/s, "
                f"{(cycles - totals.cycles) / rate / 60:.1f} min to go"
            )
    return totals


def main() -> int:
    parser = common.argument_parser(__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cycles", type=int, default=20_000, help="planner cycles of 20 ms")
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
    document = common.write_result(
        "planner_fuzz", totals.figures(), options.out, seed=options.seed, config=config
    )
    if log is not None and options.rounds is None:
        log.remove()
    common.print_result(document, as_json=options.json)
    return 1 if totals.breaches else 0


if __name__ == "__main__":
    sys.exit(main())
