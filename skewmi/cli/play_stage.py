"""What draws the copies of an environment: in 3D where there is a robot, else by its camera."""

from __future__ import annotations

from typing import Any

from skewmi.evaluation.play import ModelStage, PictureStage, Stage
from skewmi.policy_io import Array
from skewmi.sim import tasks
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.model_fields import model_fields

PICTURE = (480, 480)
"""Pixels."""


def make_stage(env: Any, recording: Any) -> Stage:
    """The stage of a batched environment.

    Args:
        env: Of a registered task.
        recording: A `rerun.RecordingStream`.
    """
    if isinstance(env, ArmBatch):
        batch = env
        return ModelStage(
            recording,
            batch.scene.model,
            lambda: batch.batch.bind("qpos"),
            lambda: _differences(batch),
            batch.num_envs,
        )
    camera = tasks.find(env.layout.task).camera(env, *PICTURE)
    return PictureStage(recording, camera.render, env.num_envs)


def _differences(env: ArmBatch) -> dict[str, Array]:
    """Fields of the copies' models, as the last reset has drawn them."""
    sample = env.variation_sample
    if sample is None:
        return {}
    return model_fields(env.scene.model, env.task.variations.keys, sample).values
