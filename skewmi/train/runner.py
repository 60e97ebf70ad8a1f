"""One iteration of training: episodes, densities, proposals, updates; and its whole state."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from torch import Tensor

from skewmi.batch_env import BatchEnv
from skewmi.errors import CheckpointError
from skewmi.policy_io import Array
from skewmi.train.blocks import read_blocks
from skewmi.train.checkpoint import Checkpoint
from skewmi.train.config import TrainConfig
from skewmi.train.density import RunningMeanStd, Scale, running_scale, unit_scale
from skewmi.train.exploration.skew_explore import RewardTerms, propose
from skewmi.train.inputs import InputNormalizer
from skewmi.train.metrics import CoverageMetrics
from skewmi.train.milestones import Convergence, Discoveries
from skewmi.train.replay import Episodes, Index, Replay
from skewmi.train.rollout import GoalSource, collect
from skewmi.train.sac.hindsight import make_batch, relabel
from skewmi.train.sac.sac import Sac

_BATCHES_PER_DRAW = 32
"""Batches drawn and relabelled at once: numpy's overhead per call is that of one batch."""
_REWARDED_STATES = 512
"""Rewarded states kept to be goals."""


class Trainer:
    """Everything that changes during a run; `state` and `load` carry all of it."""

    def __init__(self, config: TrainConfig, env: BatchEnv) -> None:
        layout = env.layout
        self.config, self.env, self.layout = config, env, layout
        self.inputs = InputNormalizer(layout, config.sac.normalize_input)
        self.sac = Sac(config.sac, self.inputs.dim, layout.action_dim, config.seed, config.device)
        self.replay = Replay(layout, config.replay.capacity_steps)
        self.generator = np.random.default_rng([config.seed, 1])
        self.running = RunningMeanStd(layout.state_dim)
        self.coverage = CoverageMetrics(layout, config.metrics)
        self.discoveries = Discoveries(layout, config.metrics.events)
        fraction, tolerance = (
            config.metrics.convergence_fraction,
            config.metrics.convergence_tolerance,
        )
        self.convergence = Convergence(fraction, tolerance)
        self.scale: Scale = unit_scale(layout, config.skew.field_weights)
        self.steps = self.iteration = self.rewarded_episodes = 0
        self.next_refresh, self.next_measure = config.skew.first_refresh_steps, 0
        self.update_debt = 0.0
        self.best_score: tuple[float, float] = (0.0, 0.0)
        self.converged_at: int | None = None
        low, high = layout.observation_low, layout.observation_high
        d = layout.state_dim
        # Before anything is known, goals are uniform over the nominal ranges.
        self.proposals: Array = self.generator.uniform(low[:d], high[:d], (config.skew.goals, d))
        self.rare_episodes: Index = np.zeros(0, dtype=np.int64)
        self.rewarded_states: Array = np.zeros((0, d))
        self.evaluation_goal: Array = self.proposals[0]
        first = env.reset(seed=config.seed)
        self.coverage.set_reachable(env, first[0, :d])

    @property
    def episodes(self) -> int:
        return self.replay.count

    @property
    def terms(self) -> RewardTerms:
        return RewardTerms(self.config.skew, self.scale)

    def iterate(self) -> tuple[dict[str, float], list[str]]:
        """Collect one episode per environment and learn from the replay.

        Returns:
            Figures by name, and the names of the events met for the first time.
        """
        started = time.perf_counter()
        episodes, new = self._collect()
        collected = time.perf_counter()
        if self.steps >= self.next_refresh:
            self._refresh()
            self.next_refresh = self.steps + self.config.skew.refresh_steps
        metrics = self._metrics(episodes)
        if self.steps >= self.next_measure:
            metrics |= self.coverage.entropy(self.replay, self.generator)
            self.next_measure = self.steps + self.config.metrics.every_steps
        measured = time.perf_counter()
        metrics |= self._update(episodes.rewards.size)
        self.iteration += 1
        metrics |= {
            "step": float(self.steps),
            "trajectories": float(self.episodes),
            "updates": float(self.sac.updates),
            "seconds_rollout": collected - started,
            "seconds_goals": measured - collected,
            "seconds_update": time.perf_counter() - measured,
        }
        return metrics, new

    def _collect(self) -> tuple[Episodes, list[str]]:
        c = self.config
        probability = min(
            c.rollout.rewarded_goal_max,
            c.rollout.rewarded_goal_per_success * self.rewarded_episodes,
        )
        source = GoalSource(self.proposals, self.rewarded_states, self.evaluation_goal, probability)
        episodes = collect(
            self.env,
            self.sac,
            self.inputs,
            source,
            c.rollout,
            self.generator,
            random_actions=self.steps < c.rollout.random_steps,
        )
        reached = episodes.observations[:, 1:]
        states = reached[..., : self.layout.state_dim]
        flat = states.reshape(-1, self.layout.state_dim)
        self.running.update(flat)
        if self.iteration == 0:
            self._rescale()  # the first trajectories need units too
        new = self.discoveries.add(reached, episodes.rewards, self.episodes, self.steps)
        self.replay.add(episodes, self.terms.log_p_tau(states))
        self.coverage.add(flat)
        self.steps += episodes.rewards.size
        self.rewarded_episodes += int((episodes.rewards > 0.0).any(1).sum())
        counted = c.rollout.evaluation_envs or len(episodes.rewards)
        self.convergence.add(episodes.rewards[:counted])
        if self.convergence.converged and self.converged_at is None:
            self.converged_at = self.episodes
        return episodes, new

    def _rescale(self) -> None:
        c = self.config.skew
        if c.running_scale:
            self.scale = running_scale(self.layout, self.running, c.scale_floor, c.field_weights)

    def _refresh(self) -> None:
        """New density units, proposals and evaluation goal."""
        self._rescale()
        self.proposals, self.rare_episodes = propose(
            self.replay, self.scale, self.config.skew, self.generator
        )
        self.rewarded_states = self.replay.rewarded_states(_REWARDED_STATES, self.generator)
        if len(self.rewarded_states):
            x = self.scale(self.rewarded_states, weighted=False)
            distance = np.linalg.norm(x[:, None] - x[None], axis=-1).sum(1)
            self.evaluation_goal = self.rewarded_states[int(np.argmin(distance))]
        else:
            self.evaluation_goal = self.proposals[-1]

    def _metrics(self, episodes: Episodes) -> dict[str, float]:
        rewards = episodes.rewards
        counted = self.config.rollout.evaluation_envs or len(rewards)
        return {
            "return": float(rewards.sum(1).mean()),
            "rewarded_fraction": float((rewards > 0.0).any(1).mean()),
            "evaluation_return": float(rewards[:counted].sum(1).mean()),
            "evaluation_fraction": self.convergence.fraction,
            "rewarded_episodes": float(self.rewarded_episodes),
            **self.coverage.coverage(),
        }

    def _update(self, steps: int) -> dict[str, float]:
        """Gradient updates owed for `steps` environment steps; means of their metrics."""
        c = self.config
        if self.steps < min(c.rollout.random_steps, c.total_steps):
            return {}
        self.update_debt += c.sac.updates_per_step * steps
        owed = int(self.update_debt)
        self.update_debt -= owed
        if owed == 0:
            return {}
        size, terms, sums = c.sac.batch_size, self.terms, dict[str, Tensor]()
        for begin in range(0, owed, _BATCHES_PER_DRAW):
            batches = min(_BATCHES_PER_DRAW, owed - begin)
            drawn = self.replay.draw(
                size * batches,
                c.sac.n_step,
                c.replay.rewarded_fraction,
                self.generator,
                rare=self.rare_episodes,
                rare_fraction=c.replay.rare_fraction,
            )
            goals = relabel(
                drawn,
                self.replay,
                self.proposals,
                c.replay.future_fraction,
                c.replay.proposal_fraction,
                self.generator,
            )
            batch = make_batch(drawn, goals, terms, self.inputs, c, self.sac.device)
            for k in range(batches):
                for name, value in self.sac.update(batch.part(k * size, (k + 1) * size)).items():
                    sums[name] = sums[name] + value if name in sums else value
        return {name: float(value) / owed for name, value in sums.items()}

    def improved(self) -> bool:
        """Whether the evaluation is better than ever before; remembers that it was."""
        score = self.convergence.score
        if score <= self.best_score:
            return False
        self.best_score = score
        return True

    def tensors(self) -> dict[str, Tensor]:
        """The arrays among the state."""
        arrays = {
            "proposals": self.proposals,
            "rare_episodes": self.rare_episodes,
            "rewarded_states": self.rewarded_states,
            "scale_offset": self.scale.offset,
            "scale_unit": self.scale.unit,
            "scale_weight": self.scale.weight,
            **{f"coverage_{k}": v for k, v in self.coverage.state().items()},
        }
        own = {f"trainer.{k}": torch.from_numpy(np.array(v)) for k, v in arrays.items()}
        return {**self.sac.state_tensors(), **own}

    def state(self) -> dict[str, Any]:
        """The rest of the state, JSON-serialisable."""
        return {
            "step": self.steps,
            "iteration": self.iteration,
            "episodes": self.episodes,
            "updates": self.sac.updates,
            "rewarded_episodes": self.rewarded_episodes,
            "next_refresh": self.next_refresh,
            "next_measure": self.next_measure,
            "update_debt": self.update_debt,
            "best_score": self.best_score,
            "converged_at": self.converged_at,
            "evaluation_goal": self.evaluation_goal.tolist(),
            "evaluation_fraction": self.convergence.fraction,
            "evaluation_fractions": list(self.convergence.fractions),
            "evaluation_returns": list(self.convergence.returns),
            "discoveries": self.discoveries.first,
            "running": self.running.state(),
            "numpy_random": self.generator.bit_generator.state,
            "env_random": self.env.random_state(),
            "layout_hash": self.layout.hash(),
        }

    def begin_with(self, checkpoint: Checkpoint) -> None:
        """Take networks, replay and counters from another run; what converged there has not here.

        Raises:
            CheckpointError: It is damaged or does not fit.
        """
        self.load(checkpoint, environment=False)
        self.converged_at, self.best_score = None, (0.0, 0.0)
        metrics = self.config.metrics
        self.convergence = Convergence(metrics.convergence_fraction, metrics.convergence_tolerance)

    def load(self, checkpoint: Checkpoint, *, environment: bool = True) -> None:
        """Continue exactly where `checkpoint` was written.

        Args:
            checkpoint: Of a run of this configuration.
            environment: Whether the environment's random streams continue, too.

        Raises:
            CheckpointError: It is damaged or does not fit.
        """
        s, t = checkpoint.state, checkpoint.tensors
        try:
            self.sac.load_state_tensors(
                {k: v for k, v in t.items() if not k.startswith("trainer.")}
            )
            own = {
                k.removeprefix("trainer."): v.numpy()
                for k, v in t.items()
                if k.startswith("trainer.")
            }
            self.proposals, self.rewarded_states = own["proposals"], own["rewarded_states"]
            self.rare_episodes = own["rare_episodes"]
            self.scale = Scale(own["scale_offset"], own["scale_unit"], own["scale_weight"])
            self.coverage.load({k: own[f"coverage_{k}"] for k in self.coverage.state()})
            self.steps, self.iteration = s["step"], s["iteration"]
            self.rewarded_episodes = s["rewarded_episodes"]
            self.next_refresh, self.next_measure = s["next_refresh"], s["next_measure"]
            self.update_debt, self.converged_at = s["update_debt"], s["converged_at"]
            self.best_score = (s["best_score"][0], s["best_score"][1])
            self.evaluation_goal = np.asarray(s["evaluation_goal"], dtype=np.float64)
            self.convergence.fractions.extend(s["evaluation_fractions"])
            self.convergence.returns.extend(s["evaluation_returns"])
            self.discoveries.first = s["discoveries"]
            self.running.load(s["running"])
            self.generator.bit_generator.state = s["numpy_random"]
            if environment:
                self.env.set_random_state(s["env_random"])
            read_blocks(self.replay, checkpoint.path / "replay", s["episodes"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise CheckpointError(f"checkpoint {checkpoint.path} is damaged: {error}") from error
