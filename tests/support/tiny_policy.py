"""Policy files of untrained networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from skewmi.export.onnx_export import export_policy
from skewmi.policy_io import Array, PolicyLayout
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout


class TinyPolicy:
    """An untrained network; satisfies `ExportablePolicy`."""

    def __init__(self, layout: PolicyLayout, robot_model_hash: str) -> None:
        torch.manual_seed(0)
        self.layout = layout
        linear = torch.nn.Linear(layout.observation_dim, layout.action_dim)
        self.module = torch.nn.Sequential(linear, torch.nn.Tanh()).eval()
        self.metadata = {"method": "none", "robot_model_hash": robot_model_hash, "seed": 0}

    def reset(self) -> None:
        pass

    def act(self, observation: Array) -> Array:
        with torch.no_grad():
            return self.module(torch.tensor(observation).float()).double().numpy()


def write_policy(
    path: Path, layout: PolicyLayout | None = None, robot_model_hash: str = yumi.MODEL_HASH
) -> Path:
    layout = make_layout() if layout is None else layout
    low, high = layout.observation_low, layout.observation_high
    size = (10, 4, layout.observation_dim)
    observations = np.random.default_rng(0).uniform(low, high, size)
    export_policy(TinyPolicy(layout, robot_model_hash), path, observations)
    return path
