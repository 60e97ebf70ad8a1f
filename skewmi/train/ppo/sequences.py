"""Episodes cut into sequences that gradients flow back through."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from skewmi.train.learner import Hidden


@dataclass(frozen=True)
class Sequences:
    """Pieces of episodes, padded to one length; on the learner's device.

    Attributes:
        inputs: Network inputs. Shape (n, length, input_dim).
        actions: As drawn, before they were clipped. Shape (n, length, action_dim).
        log_density: Of the actions, under the policy that drew them. Shape (n, length).
        advantages: Shape (n, length).
        returns: What the values are regressed to. Shape (n, length).
        values: Of the network that drew the actions. Shape (n, length).
        real: Whether there is a step at all, and no padding. Shape (n, length).
        hidden: Memory before the first step of each sequence, see `ActorCritic.empty`.
    """

    inputs: Tensor
    actions: Tensor
    log_density: Tensor
    advantages: Tensor
    returns: Tensor
    values: Tensor
    real: Tensor
    hidden: Hidden

    def __len__(self) -> int:
        return len(self.inputs)

    def pick(self, index: Tensor) -> Sequences:
        """Some of them."""
        return Sequences(
            self.inputs[index],
            self.actions[index],
            self.log_density[index],
            self.advantages[index],
            self.returns[index],
            self.values[index],
            self.real[index],
            tuple(part[index] for part in self.hidden),
        )


def cut(values: Tensor, length: int) -> Tensor:
    """Cut episodes into pieces, the last one of each padded with zeros.

    Args:
        values: Shape (n, steps, ...).
        length: Steps of a piece.

    Returns:
        Pieces of an episode one after the other. Shape (n * ceil(steps / length), length, ...).
    """
    n, steps, *rest = values.shape
    missing = -steps % length
    if missing:
        values = torch.cat((values, values.new_zeros(n, missing, *rest)), dim=1)
    return values.reshape(-1, length, *rest)
