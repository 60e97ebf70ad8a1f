"""A trained policy as anybody else uses it: observation in, action out, nothing else to know."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skewmi.errors import CheckpointError, LayoutMismatchError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.checkpoint import read_checkpoint, read_run_header
from skewmi.train.registry import entry_of, make_policy
from skewmi.train.state import as_array


class TorchPolicy:
    """A checkpoint's policy with its goal fixed; satisfies `policy_io.Policy`.

    Attributes:
        layout: What it was trained on.
        module: What `export` writes, see `export.exportable`.
        goal: The fixed goal, in the task's units. Shape (state_dim,), or (0,) without goals.
        metadata: Task, method, seed, steps and training metrics; JSON-serialisable.
    """

    def __init__(
        self, layout: PolicyLayout, module: nn.Module, goal: Array, metadata: dict[str, Any]
    ) -> None:
        self.layout = layout
        self.goal = goal
        self.metadata = metadata
        self.module = module.eval()
        self.module.requires_grad_(False)
        self._state_sizes: tuple[int, ...] = tuple(getattr(module, "state_sizes", ()))
        self._hidden: tuple[Tensor, ...] = ()

    def reset(self) -> None:
        """Forget the previous episode."""
        self._hidden = ()

    def act(self, observation: Array) -> Array:
        """Action in [-1, 1], shape (..., action_dim), for an observation (..., observation_dim).

        A recurrent policy advances its hidden state; between two resets, the batch may not
        change.

        Raises:
            LayoutMismatchError: The last axis has another length.
        """
        observation = np.asarray(observation)
        if observation.shape[-1] != self.layout.observation_dim:
            raise LayoutMismatchError(
                f"observation has {observation.shape[-1]} fields, this policy needs "
                f"{self.layout.observation_dim}: {', '.join(self.layout.observation_names)}"
            )
        flat = np.ascontiguousarray(observation.reshape(-1, self.layout.observation_dim))
        inputs = torch.as_tensor(flat, dtype=torch.float32)
        with torch.no_grad():
            if not self._state_sizes:
                action = self.module(inputs)
            else:
                hidden = self._hidden or tuple(torch.zeros(len(flat), n) for n in self._state_sizes)
                action, *after = self.module(inputs, *hidden)
                self._hidden = tuple(after)
        result: Array = action.double().numpy()
        return result.reshape(*observation.shape[:-1], -1)


def load_policy(run_dir: Path, which: str = "latest") -> TorchPolicy:
    """The policy of a run, ready to act.

    Its goal is the one that the run's evaluation episodes had. It acts on the CPU, wherever and
    with whatever engine the run was trained.

    Args:
        run_dir: Of the run.
        which: `latest`, or `best` by the rewarded fraction of the evaluation episodes.

    Raises:
        CheckpointError: There is no such run or checkpoint, or it is damaged.
    """
    run_dir = Path(run_dir)
    config, layout = read_run_header(run_dir)
    checkpoint = read_checkpoint(run_dir, which)
    state = checkpoint.state
    try:
        goal = as_array(state["evaluation_goal"]).astype(np.float64)
        module = make_policy(config.learner, layout, goal, state["learner"])
        metadata = {
            "task": layout.task,
            "method": entry_of(config.exploration)[0],
            "learner": entry_of(config.learner)[0],
            "preset": config.preset,
            "seed": config.seed,
            "task_options": dict(config.task_options),
            "environment_steps": state["step"],
            "updates": state["updates"],
            "evaluation_fraction": state["evaluation_fraction"],
            "checkpoint": checkpoint.path.name,
            "layout_hash": layout.hash(),
        }
    except (KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        raise CheckpointError(f"checkpoint {checkpoint.path} is damaged: {error}") from error
    return TorchPolicy(layout, module, goal, metadata)
