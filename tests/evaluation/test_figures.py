"""Pictures of runs of every learner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from skewmi.cli.train import train
from skewmi.cli.train_options import starting_config
from skewmi.evaluation.figures import draw_curves
from skewmi.train.ppo.config import PpoConfig


@pytest.mark.parametrize("preset", ["improved", "improved-ppo-rnd"])
def test_curves_of_any_learner_are_drawn(tmp_path: Path, preset: str) -> None:
    """A learner draws what it has told: not every one has a temperature."""
    config = starting_config("point_maze", preset)
    learner = config.learner
    if isinstance(learner, PpoConfig):
        learner = replace(learner, memory=4, epochs=1, steps_per_update=400)
    rollout = replace(config.rollout, num_envs=3, evaluation_envs=1, random_steps=0)
    config = replace(config, total_steps=1200, rollout=rollout, learner=learner)
    train(config, tmp_path / "run", progress=False)
    picture = imread(draw_curves(tmp_path / "run", tmp_path / "curves.png", dpi=40))
    assert np.ptp(picture[..., :3]) > 0.5
