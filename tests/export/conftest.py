"""Small real policies: torch modules with normaliser, reference point and squashing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch

from skewmi.policy_io import ActionField, Array, Ball, Field, PolicyLayout

LAYOUT = PolicyLayout(
    task="box",
    observation=(
        Field("hand_x", "m", "world", -0.019, 0.001),
        Field("lid_angle", "rad", "hinge", 0.0, 2.0 / 3.0),
        Field("button_depth", "m", "slide", 0.0, 0.017),
        Field("time", "", "episode", 0.0, 1.0),
    ),
    action=(
        ActionField("velocity_x", "m", "world", 0.005),
        ActionField("velocity_y", "m", "world", 0.1 + 0.2),
    ),
    reward_region=(Ball(("button_depth",), (0.0135,), 0.0035),),
    control_dt=0.1,
    episode_steps=20,
    success_hold_steps=3,
)
METADATA: dict[str, Any] = {
    "method": "skew-explore",
    "robot_model_hash": None,
    "seed": 3,
    "tiny": 5e-324,
    "third": 1.0 / 3.0,
    "reference_point": {"hand_x": 0.1 + 0.2, "lid_angle": -1e-17},
}


class Feedforward(torch.nn.Module):
    """Raw observation -> action, everything folded in."""

    def __init__(self, seed: int = 0, hidden: int = 32) -> None:
        super().__init__()
        torch.manual_seed(seed)
        low, high = (torch.tensor(x) for x in (LAYOUT.observation_low, LAYOUT.observation_high))
        self.register_buffer("centre", ((low + high) / 2).float())
        self.register_buffer("scale", (2 / (high - low)).float())
        self.register_buffer("reference", torch.tensor([0.3, -0.2, 0.9]))
        self.body = torch.nn.Sequential(
            torch.nn.Linear(LAYOUT.observation_dim + 3, hidden),
            torch.nn.ReLU(),
            torch.nn.Linear(hidden, LAYOUT.action_dim),
        )

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        scaled = (observation - self.centre) * self.scale
        reference = self.reference.expand(observation.shape[0], -1)
        return torch.tanh(self.body(torch.cat((scaled, reference), dim=-1)))


class Recurrent(torch.nn.Module):
    """One step of a policy with an LSTM."""

    state_sizes = (16, 16)

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(1)
        self.cell = torch.nn.LSTMCell(LAYOUT.observation_dim, 16)
        self.head = torch.nn.Linear(16, LAYOUT.action_dim)

    def forward(
        self, observation: torch.Tensor, h: torch.Tensor, c: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        h, c = self.cell(observation, (h, c))
        return torch.tanh(self.head(h)), h, c


class SmallPolicy:
    """Satisfies `ExportablePolicy`."""

    def __init__(self, module: torch.nn.Module, metadata: Mapping[str, Any] = METADATA) -> None:
        self.layout = LAYOUT
        self.module = module.eval()
        self.metadata = dict(metadata)
        self._state: tuple[torch.Tensor, ...] = ()

    def reset(self) -> None:
        self._state = ()

    def act(self, observation: Array) -> Array:
        flat = torch.tensor(observation.reshape(-1, observation.shape[-1])).float()
        sizes = getattr(self.module, "state_sizes", ())
        if sizes and not self._state:
            self._state = tuple(torch.zeros(len(flat), n) for n in sizes)
        with torch.no_grad():
            result = self.module(flat, *self._state)
        action, *state = result if sizes else (result,)
        self._state = tuple(state)
        return action.double().numpy().reshape(*observation.shape[:-1], -1)


def recorded(seed: int, n_steps: int, n: int) -> Array:
    """Observations inside the nominal range."""
    low, high = LAYOUT.observation_low, LAYOUT.observation_high
    size = (n_steps, n, LAYOUT.observation_dim)
    return np.random.default_rng(seed).uniform(low, high, size)


@pytest.fixture(scope="session")
def layout() -> PolicyLayout:
    return LAYOUT


@pytest.fixture
def feedforward() -> SmallPolicy:
    return SmallPolicy(Feedforward())


@pytest.fixture
def recurrent() -> SmallPolicy:
    return SmallPolicy(Recurrent())


@pytest.fixture
def observations() -> Array:
    return recorded(0, 20, 8)
