"""Sequences of chunks and stops, and what they may come to at worst (see `splice_program`).

python tests/adversarial/splice_sequences.py
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from splice_program import AS_IS, Motion, Rules

ONCE = Rules(joined=False, rested=1, remembers=False)
"""The rules as they once were."""


def two_chunks(splice: int, points: int, rules: Rules = AS_IS, first: int = 20) -> Motion:
    """A chunk from rest, and one that is laid over it."""
    motion = Motion(first + points, rules=rules)
    motion.chunk(0, first)
    motion.chunk(splice, points)
    return motion


def three_chunks(
    splices: tuple[int, int], points: tuple[int, int], rules: Rules = AS_IS, first: int = 16
) -> Motion:
    """A chunk from rest, one laid over it, and one laid over that."""
    motion = Motion(first + sum(points), rules=rules)
    motion.chunk(0, first)
    for splice, count in zip(splices, points, strict=True):
        motion.chunk(splice, count)
    return motion


def stop(tick: int, rules: Rules = AS_IS, first: int = 24) -> Motion:
    """A chunk from rest, and a stop that finds the arm at rest at a tick."""
    motion = Motion(first, rules=rules)
    motion.chunk(0, first)
    motion.hold(tick)
    return motion


def stop_and_go_on(
    tick: int, later: int, points: int, rules: Rules = AS_IS, first: int = 24
) -> Motion:
    """The same, and somebody arms at once and sends a chunk that begins so many ticks later."""
    motion = Motion(first + points, rules=rules)
    motion.chunk(0, first)
    motion.hold(tick)
    motion.chunk(tick + later, points)
    return motion


def over_ends(motion: Motion) -> list[int]:
    """Ticks at which third differences begin that reach over the ends of chunks, or into a stop.

    All others lie inside a chunk, and are bounded one by one.
    """
    ends = {t for tick, points, _ in motion.chunks for t in (tick, tick + points)}
    ends |= {tick + 1 for tick in motion.held}
    return sorted({end - age for end in ends for age in (3, 2, 1)})


def sequences(points: int, rules: Rules = AS_IS) -> Iterator[Motion]:
    """Chunks of so many points laid over a longer one, and over one another, at many samples."""
    for splice in (3, 6, 12):
        yield two_chunks(splice, points, rules)
    for second in sorted({1, 2, points - 1, points, points + 1} - {0}):
        yield three_chunks((6, 6 + second), (points, points), rules)


def stops(rules: Rules = AS_IS, first: int = 24) -> Iterator[Motion]:
    """At every sample of a chunk, and the first after it."""
    for tick in range(1, first + 2):
        yield stop(tick, rules, first)


def stops_and_chunks(rules: Rules = AS_IS) -> Iterator[Motion]:
    """Stops that are followed by a chunk, long or short, at once or soon."""
    for tick in (4, 5, 6, 10, 20, 23, 24):
        for later in (0, 1, 2):
            for points in (2, 3, 12):
                yield stop_and_go_on(tick, later, points, rules)


def main() -> int:
    """Tell what sequences may come to at worst, with the rules as they once were and now."""
    kinds: list[tuple[str, Callable[[Rules], Iterable[Motion]]]] = [
        (f"chunks of {points} points", partial(sequences, points)) for points in range(1, 13)
    ]
    kinds += [("a stop", stops), ("a stop, then a chunk", stops_and_chunks)]
    for name, motions in kinds:
        before, after = (
            max(motion.worst(over_ends(motion), (3,)).share for motion in motions(rules))
            for rules in (ONCE, AS_IS)
        )
        sys.stdout.write(f"{name}: {before:.4f} of the jerk bound once, {after:.4f} now\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
