"""The policy of soft actor-critic as one module, which is what `export` writes."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from skewmi.errors import CheckpointError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.inputs import InputNormalizer
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.networks import Actor
from skewmi.train.state import State


class SacPolicyModule(nn.Module):
    """Raw observation (n, observation_dim) float32 -> action in [-1, 1] (n, action_dim).

    The input normalizer and the goal are constants of the module, so exporting it exports the
    whole policy. The action is the mode of the squashed policy's Gaussian, tanh(mean). The
    weights are a copy: the module stays as it is when learning goes on.
    """

    def __init__(self, actor: Actor, inputs: InputNormalizer, goal: Array) -> None:
        super().__init__()
        self.body = copy.deepcopy(actor.body).cpu()
        self.action_dim = actor.body[-1].out_features // 2  # type: ignore[operator]
        center, inverse_half, scaled_goal = inputs.folded(goal)
        self.register_buffer("center", center)
        self.register_buffer("inverse_half", inverse_half)
        self.register_buffer("goal", scaled_goal)

    def forward(self, observation: Tensor) -> Tensor:
        scaled = (observation - self.center) * self.inverse_half  # type: ignore[operator]
        goal: Tensor = self.goal  # type: ignore[assignment]
        whole = torch.cat((scaled, goal.expand(observation.shape[0], -1)), dim=-1)
        mean: Tensor = self.body(whole)[:, : self.action_dim]
        return torch.tanh(mean)


def policy_of(
    config: SacConfig, layout: PolicyLayout, goal: Array, state: State
) -> SacPolicyModule:
    """The policy in a learner's state; engine, optimizers and random stream do not matter to it.

    Args:
        config: Of the learner.
        layout: Of the task.
        goal: In the task's units. Shape (goal_dim,).
        state: Of `SacLearner`.

    Raises:
        CheckpointError: The actor's weights are not there, or of another network.
    """
    inputs = InputNormalizer(layout, len(goal), normalize=config.normalize_input)
    bounds = (config.log_std_min, config.log_std_max)
    with torch.random.fork_rng(devices=[]):
        actor = Actor(inputs.dim, layout.action_dim, config.hidden, bounds)
    averaged = config.actor_average > 0.0 and "steady_actor" in state
    try:
        actor.load_state_dict(state["steady_actor" if averaged else "actor"])
    except (KeyError, RuntimeError) as error:
        raise CheckpointError(f"the weights do not fit this network: {error}") from error
    return SacPolicyModule(actor, inputs, goal)
