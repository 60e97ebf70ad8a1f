"""A policy with a memory on the simulated robot: torch's actions at every step of every episode."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.policy import OnnxPolicy
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.run import run_deploy
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states
from skewmi.export.onnx_export import TOLERANCE, export_policy
from skewmi.policy_io import Array
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.train.policy import TorchPolicy
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.ppo.learner import PpoLearner

EPISODES = 2


def untrained() -> TorchPolicy:
    """The learner's policy before it has learned anything: its memory matters all the same."""
    layout = make_layout()
    low, high = layout.observation_low, layout.observation_high
    learner = PpoLearner(PpoConfig(memory=16, heads=(8,)), layout, layout.state_dim, 0, "cpu")
    goal = (0.3 * low + 0.7 * high)[: layout.state_dim]
    metadata = {"method": "none", "robot_model_hash": yumi.MODEL_HASH, "seed": 0}
    return TorchPolicy(layout, learner.policy_module(goal), goal, metadata)


def recorded(path: Path, topic: str) -> tuple[list[int], Array]:
    """Times and values of what was published on a topic."""
    told = [decode_joint_states(m.payload) for m in read_recording(path).messages[topic]]
    return [t.stamp_ns for t in told], np.array([t.position for t in told])


@pytest.fixture(scope="module")
def policy() -> TorchPolicy:
    return untrained()


@pytest.fixture(scope="module")
def exported(policy: TorchPolicy, tmp_path_factory: pytest.TempPathFactory) -> OnnxPolicy:
    """Made before the robot is there, which would wait for it."""
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    layout = policy.layout
    size = (10, 4, layout.observation_dim)
    some = np.random.default_rng(0).uniform(layout.observation_low, layout.observation_high, size)
    export_policy(policy, path, some)
    return OnnxPolicy.load(path)


@pytest.mark.slow
def test_deployed_actions_are_torchs_over_whole_episodes(
    policy: TorchPolicy, exported: OnnxPolicy, lock_step_robot: str, tmp_path: Path
) -> None:
    record = tmp_path / "run.mcap"
    report = run_deploy(
        exported,
        DeployOptions(
            seed=3, connect=lock_step_robot, lock_step=True, episodes=EPISODES, record=record
        ),
    )
    assert report.stops == []
    seen_at, seen = recorded(record, topics.POLICY_OBSERVATION.name)
    acted_at, acted = recorded(record, topics.POLICY_ACTION.name)
    steps = policy.layout.episode_steps
    assert len(acted) == EPISODES * steps
    # The observation that ends an episode is recorded, too, but not acted on.
    observations = dict(zip(seen_at, seen, strict=True))
    for episode in range(EPISODES):
        policy.reset()
        for step in range(episode * steps, (episode + 1) * steps):
            expected = policy.act(observations[acted_at[step]])
            np.testing.assert_allclose(
                acted[step], expected, rtol=0.0, atol=TOLERANCE, err_msg=f"step {step}"
            )
    # Without its memory it would have acted otherwise.
    forgetful = np.stack([(policy.reset(), policy.act(o))[1] for o in seen[: steps // 2]])
    assert np.abs(forgetful - acted[: steps // 2]).max() > 1e-2
