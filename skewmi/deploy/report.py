"""What a deployment did: outcome of each episode, limits, timing, stops."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any

from skewmi.contact import QUANTITIES
from skewmi.deploy.safety.limits import LimitUsage
from skewmi.deploy.wire.senders import Stranger
from skewmi.smoothness import LIMITS, name_of


@dataclass(frozen=True)
class RunProgress:
    """How far a run is."""

    state: str
    """Of the session."""
    episode: int
    """From 1."""
    episodes: int
    step: int
    """Control steps of the episode so far."""
    steps: int
    """That it may have."""
    missed_cycles: int
    """In which no chunk could be sent in time."""


@dataclass(frozen=True)
class EpisodeReport:
    """One episode.

    Attributes:
        index: From 0.
        outcome: `success`, `time over`, `stopped` or `fault`.
        reason: Why it ended.
        steps: Control steps that the policy was asked for.
        seed: Of the start position.
        final_observation: By field name, in the field's unit.
        contact: Largest of `skewmi.contact.QUANTITIES` in the episode, the way to the start
            included; empty if the robot cannot tell.
        smoothness: Of the motion that the policy commanded, see `skewmi.smoothness`; empty if it
            commanded none.
    """

    index: int
    outcome: str
    reason: str
    steps: int
    seed: int
    final_observation: dict[str, float]
    contact: dict[str, float] = field(default_factory=dict)
    smoothness: dict[str, float] = field(default_factory=dict)


@dataclass
class DeployReport:
    """All episodes of one `run_deploy`."""

    task: str
    robot: str
    limit_profile: str
    speed: float
    """Fraction of the training's speed at which the policy acted: control steps take whole planner
    cycles."""
    lock_step: bool
    dry_run: bool = False
    planned_episodes: int = 0
    episodes: list[EpisodeReport] = field(default_factory=list)
    velocity_fraction: float = 1.0
    """Of full velocity, that motion was planned with; `usage` is of the limits so reduced."""
    usage: LimitUsage = field(default_factory=LimitUsage)
    """Largest use of each limit over all chunks that were sent, braking tails included."""
    cycles: int = 0
    cycle_ms: dict[str, float] = field(default_factory=dict)
    stage_ms: dict[str, dict[str, float]] = field(default_factory=dict)
    missed_cycles: int = 0
    stops: list[str] = field(default_factory=list)
    """Reasons of every episode that was stopped or ended in a fault."""
    granted: list[str] = field(default_factory=list)
    """What the operating system granted to the loop."""
    broken_files: list[str] = field(default_factory=list)
    """Files that were asked for and are not whole; the notes say why."""
    files: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False
    strangers: list[Stranger] = field(default_factory=list)
    """Who else published on the run's topics, and was not believed."""

    def add_strangers(self, heard: Iterable[Stranger]) -> None:
        """Take in whom session, recorder or live view have heard; each once, with most messages."""
        known = {(s.topic, s.gid, s.copied): s for s in self.strangers}
        for stranger in heard:
            key = stranger.topic, stranger.gid, stranger.copied
            before = known.get(key)
            if before is None or stranger.messages > before.messages:
                known[key] = stranger
        self.strangers = list(known.values())

    @property
    def successes(self) -> int:
        return sum(episode.outcome == "success" for episode in self.episodes)

    @property
    def success_rate(self) -> float:
        return self.successes / len(self.episodes) if self.episodes else 0.0

    @property
    def faulted(self) -> bool:
        return any(episode.outcome == "fault" for episode in self.episodes)

    def contact(self) -> dict[str, dict[str, float]]:
        """Per quantity that the robot told: "max" over the episodes, and if it has a limit, "limit"
        and "share_of_episodes_within"."""
        metrics: dict[str, dict[str, float]] = {}
        for name, quantity in QUANTITIES.items():
            values = [e.contact[name] for e in self.episodes if name in e.contact]
            if not values:
                continue
            metrics[name] = {"max": max(values)}
            if quantity.limit is not None:
                within = sum(value <= quantity.limit for value in values) / len(values)
                metrics[name] |= {"limit": quantity.limit, "share_of_episodes_within": within}
        return metrics

    def smoothness(self) -> dict[str, dict[str, float]]:
        """Per frequency, how much of the power of the least smooth joint's acceleration lies above:
        "median" and "max" over the episodes, and "limit"; empty if nothing moved."""
        metrics: dict[str, dict[str, float]] = {}
        for frequency, limit in LIMITS.items():
            name = name_of(frequency)
            values = [e.smoothness[name] for e in self.episodes if name in e.smoothness]
            if values:
                metrics[name] = {"median": median(values), "max": max(values), "limit": limit}
        return metrics

    def as_dict(self) -> dict[str, Any]:
        """JSON-serialisable, for `--json`; limits as fractions, times in ms."""
        content = asdict(self)
        content["per_episode"] = content.pop("episodes")
        content["limit_fractions"] = content.pop("usage")
        return {
            "episodes": len(self.episodes),
            "successes": self.successes,
            "success_rate": self.success_rate,
            "faulted": self.faulted,
            "contact": self.contact(),
            "smoothness": self.smoothness(),
            **content,
        }
