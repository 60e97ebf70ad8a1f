"""The policy of proximal policy optimization as one module, which is what `export` writes."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from skewmi.errors import CheckpointError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.inputs import InputNormalizer
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.networks import ActorCritic
from skewmi.train.state import State


class PpoPolicyModule(nn.Module):
    """Raw observation and memory -> action in [-1, 1] and the next memory, towards one goal.

    (n, observation_dim), h and c (n, memory) -> (n, action_dim), h and c. Without a memory:
    observation -> action. Input normalizer and goal are constants of the module. The weights are
    a copy: the module stays as it is when learning goes on.

    Attributes:
        state_sizes: Units of h and of c; only there with a memory.
    """

    state_sizes: tuple[int, int]

    def __init__(self, network: ActorCritic, inputs: InputNormalizer, goal: Array) -> None:
        super().__init__()
        self.head = copy.deepcopy(network.policy).cpu()
        self.cell: nn.LSTMCell | None = None
        if network.lstm is not None:
            self.state_sizes = (network.memory, network.memory)
            self.cell = nn.LSTMCell(network.lstm.input_size, network.memory)
            # The same weights by the same names, but for the number of the layer.
            weights = network.lstm.state_dict().items()
            self.cell.load_state_dict({name.removesuffix("_l0"): w.cpu() for name, w in weights})
        center, inverse_half, scaled_goal = inputs.folded(goal)
        self.register_buffer("center", center)
        self.register_buffer("inverse_half", inverse_half)
        self.register_buffer("goal", scaled_goal)

    def forward(self, observation: Tensor, *memory: Tensor) -> Tensor | tuple[Tensor, ...]:
        scaled = (observation - self.center) * self.inverse_half  # type: ignore[operator]
        goal: Tensor = self.goal  # type: ignore[assignment]
        features = torch.cat((scaled, goal.expand(observation.shape[0], -1)), dim=-1)
        if self.cell is None:
            return self._action(features)
        h, c = memory
        h, c = self.cell(features, (h, c))
        return self._action(h), h, c

    def _action(self, features: Tensor) -> Tensor:
        return torch.clamp(self.head(features), -1.0, 1.0)


def policy_of(
    config: PpoConfig, layout: PolicyLayout, goal: Array, state: State
) -> PpoPolicyModule:
    """The policy in a learner's state; optimizer and random stream do not matter to it.

    Args:
        config: Of the learner.
        layout: Of the task.
        goal: In the task's units. Shape (goal_dim,).
        state: Of `PpoLearner`.

    Raises:
        CheckpointError: The network's weights are not there, or of another network.
    """
    inputs = InputNormalizer(layout, len(goal), normalize=config.normalize_input)
    with torch.random.fork_rng(devices=[]):
        network = ActorCritic(
            inputs.dim, layout.action_dim, config.memory, config.heads, config.initial_log_std
        )
    try:
        network.load_state_dict(state["network"])
    except (KeyError, RuntimeError) as error:
        raise CheckpointError(f"the weights do not fit this network: {error}") from error
    return PpoPolicyModule(network, inputs, goal)
