"""The matrix products of one update of soft actor-critic, bare: nothing between them, no result.

What is left if everything but the products cost nothing. They are those that the update needs, with
an actor and two critics, forward and backward: no gradient that nobody asks for.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor

CRITICS = 2


class UpdateProducts:
    """`run` multiplies. Operands are random, results go where memory is ready.

    Args:
        input_dim, action_dim: Of the networks.
        hidden: Units of the hidden layers of actor and critics.
        batch_size: Transitions.

    Attributes:
        products: (left, right, result) of each. The critics' are batches of two.
    """

    def __init__(
        self, input_dim: int, action_dim: int, hidden: tuple[int, ...], batch_size: int
    ) -> None:
        self.products: list[tuple[Tensor, Tensor, Tensor]] = []
        self._made: dict[tuple[str, tuple[int, ...]], Tensor] = {}
        self._batch = batch_size
        actor = [*pairwise((input_dim, *hidden, 2 * action_dim))]
        critics = [*pairwise((input_dim + action_dim, *hidden, 1))]
        # Targets: next actions, and what the target critics say of them.
        self._forward(actor, 1)
        self._forward(critics, CRITICS)
        # Loss of the critics: nobody asks for the gradient of their inputs.
        self._forward(critics, CRITICS)
        self._weights(critics, CRITICS)
        self._inputs(critics[1:], CRITICS)
        # Loss of the actor: through the critics, whose weights need no gradient.
        self._forward(actor, 1)
        self._forward(critics, CRITICS)
        self._inputs(critics, CRITICS)
        self._weights(actor, 1)
        self._inputs(actor[1:], 1)

    @property
    def flops(self) -> int:
        """Of one update: two for each multiplication with its addition."""
        return sum(2 * left.numel() * right.shape[-1] for left, right, _ in self.products)

    def run(self) -> None:
        """All of them once."""
        for left, right, result in self.products:
            torch.matmul(left, right, out=result)

    def _forward(self, layers: list[tuple[int, int]], members: int) -> None:
        for i, o in layers:
            self._add(self._rows(i, members), self._weight(i, o, members), members)

    def _weights(self, layers: list[tuple[int, int]], members: int) -> None:
        for i, o in layers:
            self._add(self._rows(i, members).mT, self._rows(o, members), members)

    def _inputs(self, layers: list[tuple[int, int]], members: int) -> None:
        for i, o in layers:
            self._add(self._rows(o, members), self._weight(i, o, members).mT, members)

    def _add(self, left: Tensor, right: Tensor, members: int) -> None:
        result = self._memory("result", left.shape[-2], right.shape[-1], members)
        self.products.append((left, right, result))

    def _rows(self, size: int, members: int) -> Tensor:
        return self._memory("rows", self._batch, size, members)

    def _weight(self, i: int, o: int, members: int) -> Tensor:
        return self._memory("weight", i, o, members)

    def _memory(self, kind: str, rows: int, columns: int, members: int) -> Tensor:
        """One matrix of each kind and shape serves all: an update's operands are warm as well."""
        shape = (members, rows, columns) if members > 1 else (rows, columns)
        if (kind, shape) not in self._made:
            self._made[kind, shape] = torch.randn(shape)
        return self._made[kind, shape]
