"""One iteration of training: episodes, goals, metrics, updates; and its whole state.

Knows neither learner nor exploration by name: `registry` makes them from their configurations.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from skewmi.batch_env import BatchEnv
from skewmi.errors import CheckpointError
from skewmi.policy_io import Array, Policy
from skewmi.train.beginnings import Beginnings
from skewmi.train.blocks import read_blocks
from skewmi.train.checkpoint import Checkpoint
from skewmi.train.compatibility import require_explored, require_own_actions
from skewmi.train.config import MetricsConfig, TrainConfig
from skewmi.train.convergence import Convergence
from skewmi.train.learner import Learner, Rollout
from skewmi.train.metrics import CoverageMetrics
from skewmi.train.milestones import Discoveries
from skewmi.train.registry import make_exploration, make_learner
from skewmi.train.replay import Replay
from skewmi.train.rollout import collect
from skewmi.train.state import State


class Runner:
    """Everything that changes during a run; `state_dict` and `load` carry all of it.

    Args:
        config: Of the run.
        env: As many environments as it says.
        teacher: Of a run that is taught, see `needs_teacher`.

    Raises:
        ConfigurationError: Learner, exploration, environment and metrics do not go together.
    """

    def __init__(self, config: TrainConfig, env: BatchEnv, teacher: Policy | None = None) -> None:
        layout = env.layout
        self.config, self.env, self.layout = config, env, layout
        self.beginnings = Beginnings(config.rollout, teacher, taught=bool(config.taught_by))
        self.generator = np.random.default_rng([config.seed, 1])
        self.exploration = make_exploration(config.exploration, layout, self.generator)
        goal_dim = self.exploration.goal_dim
        self.learner = self._new_learner(config.seed)
        if self.learner.on_policy:
            require_own_actions(config, self.exploration)
        self.history = Replay(layout, config.rollout.history_steps, goal_dim)
        self.coverage = CoverageMetrics(layout, config.task_metrics, config.metrics)
        self.discoveries = Discoveries(layout, config.task_metrics.events)
        self.convergence = _new_convergence(self.config.metrics)
        self.steps = self.iteration = self.rewarded_episodes = self.next_measurement = 0
        self.rewarded_share = 0.0  # of the latest iteration's episodes
        self.best_score: tuple[float, float] = (0.0, 0.0)
        first = env.reset(seed=config.seed)
        self.coverage.set_reachable(env, first[0, : layout.state_dim])

    @property
    def needs_teacher(self) -> bool:
        """Whether a teacher acts in the next episodes."""
        return self.beginnings.need_teacher(self.steps, self.convergence.at is not None)

    @property
    def episodes(self) -> int:
        """Finished so far."""
        return self.history.count

    def iterate(
        self, improved: Callable[[], None] | None = None
    ) -> tuple[dict[str, float], list[str]]:
        """Collect one episode per environment and learn from what was visited.

        Args:
            improved: Called if the evaluation was better than ever before, while goal and networks
                are those that were evaluated.

        Returns:
            Metrics by name, and the names of the events met for the first time.
        """
        c = self.config
        started = time.perf_counter()
        beginning = self.beginnings.next(self.steps, self.convergence.at is not None)
        rollout = collect(
            self.env,
            self.learner,
            self.exploration,
            self.generator,
            config=c.rollout,
            evaluation=self._evaluation_envs(),
            beginning=beginning,
            rewarded=c.rewarded,
        )
        term, new = self._keep(rollout, own=beginning is None or not beginning.whole)
        collected = time.perf_counter()
        if self._improved() and improved is not None:
            improved()
        evaluated = time.perf_counter()
        refreshes = self.exploration.refreshes
        metrics = self.exploration.refresh(self.history, self.steps, self.generator)
        metrics |= self._measure(rollout, refreshed=self.exploration.refreshes > refreshes)
        refreshed = time.perf_counter()
        if self.beginnings.over(self.steps):
            metrics |= self._learn(rollout, term)
        metrics |= {
            "step": float(self.steps),
            "trajectories": float(self.episodes),
            "updates": float(self.learner.updates),
            "seconds_rollout": collected - started,
            "seconds_goals": refreshed - evaluated,
            "seconds_update": time.perf_counter() - refreshed,
        }
        return metrics, new

    def _evaluation_envs(self) -> int:
        """How many of the next episodes run the deterministic action."""
        rollout = self.config.rollout
        done = self.convergence.latest >= self.config.metrics.convergence_fraction
        nearly = rollout.evaluation_from < 1.0 and self.rewarded_share >= rollout.evaluation_from
        return rollout.most_evaluation_envs if done or nearly else rollout.evaluation_envs

    def _keep(self, rollout: Rollout, *, own: bool) -> tuple[Array, list[str]]:
        """Remember finished episodes; their trajectory term, and events met for the first time.

        Args:
            rollout: As collected.
            own: Whether the evaluated episodes are the learner's own.
        """
        episodes = rollout.episodes
        term = self.exploration.observe(episodes)
        reached = episodes.observations[:, 1:]
        new = self.discoveries.add(reached, episodes.rewards, self.episodes, self.steps)
        self.history.add(episodes, term)
        d = self.layout.state_dim
        self.coverage.add(reached[..., :d].reshape(-1, d))
        self.steps += episodes.rewards.size
        self.iteration += 1
        rewarded = (episodes.rewards > 0.0).any(1)
        self.rewarded_episodes += int(rewarded.sum())
        self.rewarded_share = float(rewarded.mean())
        # What a teacher or chance can do is not what this run has learned. Where nothing is
        # evaluated all trajectories count, as in the publication.
        if own or rollout.evaluation == 0:
            counted = _counted(rollout)
            self.convergence.add(
                episodes.observations[counted], episodes.rewards[counted], self.episodes
            )
        return term, new

    def _measure(self, rollout: Rollout, *, refreshed: bool) -> dict[str, float]:
        rewards = rollout.episodes.rewards
        metrics = {
            "return": float(rewards.sum(1).mean()),
            "rewarded_fraction": self.rewarded_share,
            "evaluation_return": float(rewards[_counted(rollout)].sum(1).mean()),
            "rewarded_episodes": float(self.rewarded_episodes),
            "refresh": float(self.exploration.refreshes),
            **self.convergence.metrics(),
            **self.coverage.coverage(),
        }
        due = self.steps >= self.next_measurement if self.config.rewarded else refreshed
        if due:
            # A stream of its own, that no continuation has to keep.
            own = np.random.default_rng([self.config.seed, 2, self.steps])
            metrics |= self.coverage.entropy(self.history, self.generator, own)
            self.next_measurement = self.steps + self.config.metrics.every_steps
        return metrics

    def _learn(self, rollout: Rollout, trajectory_term: Array) -> dict[str, float]:
        self.learner.hurry = self.rewarded_episodes > 0 and self.convergence.at is None
        self.learner.observe(rollout, trajectory_term)
        return self.learner.update(self.history, self.exploration, self.generator)

    def _improved(self) -> bool:
        """Whether the evaluation is better than ever before; remembers that it was."""
        score = self.convergence.score
        if score <= self.best_score:
            return False
        self.best_score = score
        return True

    def state_dict(self) -> State:
        """Everything but the episodes, which are the history's."""
        return {
            # Counters first: they are what people look for in the file.
            "step": self.steps,
            "iteration": self.iteration,
            "episodes": self.episodes,
            "updates": self.learner.updates,
            "rewarded_episodes": self.rewarded_episodes,
            "rewarded_share": self.rewarded_share,
            "next_measurement": self.next_measurement,
            "refreshes": self.exploration.refreshes,
            "converged_at": self.convergence.at,
            "converged_at_paper": self.convergence.published_at,
            "best_score": self.best_score,
            "evaluation_goal": self.exploration.evaluation_goal,
            "evaluation_fraction": self.convergence.fraction,
            "layout_hash": self.layout.hash(),
            "learner": self.learner.state_dict(),
            "exploration": self.exploration.state_dict(),
            "coverage": self.coverage.state_dict(),
            "discoveries": self.discoveries.state_dict(),
            "convergence": self.convergence.state_dict(),
            "generator": self.generator.bit_generator.state,
            "env_random": self.env.random_state(),
        }

    def begin_with(self, checkpoint: Checkpoint) -> None:
        """Take networks, episodes and counters from another run; what converged there has not here.

        What is random from here on comes from this run's seed, and from how far the other one had
        come: the same seed does not repeat what that began with.

        Raises:
            CheckpointError: It is damaged or does not fit.
            ConfigurationError: It has met a reward, and this run is to have none.
        """
        s = checkpoint.state
        with _reading(checkpoint):
            require_explored(self.config, s["rewarded_episodes"])
            stream = np.random.default_rng([self.config.seed, 1, s["step"]])
            fresh = self._new_learner(int(stream.integers(2**63 - 1))).state_dict()
            streams = {name: value for name, value in fresh.items() if name == "generator"}
            learner = {**s["learner"], **streams}
        own = {"learner": learner, "generator": stream.bit_generator.state}
        self.load(replace(checkpoint, state={**s, **own}), environment=False)
        self.best_score = (0.0, 0.0)
        self.convergence = _new_convergence(self.config.metrics)

    def load(self, checkpoint: Checkpoint, *, environment: bool = True) -> None:
        """Continue exactly where `checkpoint` was written.

        Args:
            checkpoint: Of a run of this configuration.
            environment: Whether the environment's random streams continue, too.

        Raises:
            CheckpointError: It is damaged or does not fit.
        """
        s = checkpoint.state
        with _reading(checkpoint):
            self.learner.load_state_dict(s["learner"])
            self.exploration.load_state_dict(s["exploration"])
            self.coverage.load_state_dict(s["coverage"])
            self.discoveries.load_state_dict(s["discoveries"])
            self.convergence.load_state_dict(s["convergence"])
            self.steps, self.iteration = s["step"], s["iteration"]
            self.rewarded_episodes = s["rewarded_episodes"]
            self.rewarded_share = float(s.get("rewarded_share", 0.0))
            self.next_measurement = s["next_measurement"]
            self.best_score = (s["best_score"][0], s["best_score"][1])
            self.generator.bit_generator.state = s["generator"]
            if environment:
                self.env.set_random_state(s["env_random"])
            read_blocks(self.history, checkpoint.path / "replay", s["episodes"])

    def _new_learner(self, seed: int) -> Learner:
        c, goal_dim = self.config, self.exploration.goal_dim
        return make_learner(c.learner, self.layout, goal_dim, seed, c.device)


@contextmanager
def _reading(checkpoint: Checkpoint) -> Iterator[None]:
    """What goes wrong inside is the checkpoint's fault."""
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise CheckpointError(f"checkpoint {checkpoint.path} is damaged: {error}") from error


def _new_convergence(m: MetricsConfig) -> Convergence:
    return Convergence(m.convergence_fraction, m.convergence_tolerance, m.convergence_trajectories)


def _counted(rollout: Rollout) -> slice:
    """The episodes that tell whether the task is learned: evaluated ones, or all without any."""
    return slice(rollout.evaluation or None)
