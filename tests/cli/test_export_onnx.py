"""`skewmi export-onnx` on a real run: file, figures, exit codes."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from skewmi.cli.export_onnx import robot_metadata
from skewmi.cli.main import main
from skewmi.deploy.policy import OnnxPolicy
from skewmi.robot_models import yumi
from skewmi.sim import tasks
from skewmi.sim.arm.batch import ArmBatch
from skewmi.train.policy import load_policy


@pytest.fixture(scope="module")
def exported(maze_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "new" / "policy.onnx"
    assert main(["export-onnx", str(maze_run), "--out", str(out), "--episodes", "3"]) == 0
    return out


def test_file_is_the_policy_of_the_run(maze_run: Path, exported: Path) -> None:
    policy, original = OnnxPolicy.load(exported), load_policy(maze_run)
    assert policy.layout == original.layout
    low, high = policy.layout.observation_low, policy.layout.observation_high
    given = np.random.default_rng(0).uniform(low, high, (500, low.size))
    np.testing.assert_allclose(policy.act(given), original.act(given), rtol=0.0, atol=1e-5)


def test_file_says_where_it_came_from(maze_run: Path, exported: Path) -> None:
    metadata = OnnxPolicy.load(exported).metadata
    original = load_policy(maze_run)
    weights = maze_run / "checkpoints" / metadata["checkpoint"] / "weights.safetensors"
    assert metadata["checkpoint_sha256"] == hashlib.sha256(weights.read_bytes()).hexdigest()
    names = [field.name for field in original.layout.state_fields]
    assert metadata["reference_point"] == dict(zip(names, original.goal, strict=True))
    assert metadata["task"] == "point_maze"
    assert metadata["method"] == "return-then-explore"
    assert metadata["seed"] == 0
    assert metadata["environment_steps"] == original.metadata["environment_steps"]
    assert metadata["training_config"]["rollout"]["num_envs"] == 4
    assert metadata["robot_model_hash"] is None
    assert metadata["evaluation"]["episodes"] == 3
    assert metadata["evaluation"]["successes"] == 0


def test_json_is_one_document_with_both_success_rates(
    maze_run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "policy.onnx"
    arguments = ["export-onnx", str(maze_run), "--out", str(out), "--episodes", "2", "--json"]
    assert main([*arguments, "--which", "best", "--option", "start_noise=0.2"]) == 0
    stdout, stderr = capfd.readouterr()
    figures = json.loads(stdout)
    assert stderr == ""
    assert figures["sha256"] == hashlib.sha256(out.read_bytes()).hexdigest()
    assert figures["success_rate_torch"] == figures["torch"]["success_rate"] == 0.0
    assert figures["success_rate_onnx"] == figures["onnx"]["success_rate"] == 0.0
    assert figures["max_difference"] <= 1e-5
    assert figures["observations"] == 400
    starts = figures["torch"]["final_state"]["x"]
    assert starts["min"] != starts["max"]  # the option reached the task


def test_bad_input_is_one_line_and_code_2(
    maze_run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "policy.onnx")
    for arguments, reason in (
        ([str(tmp_path / "nothing"), "--out", out], "no run directory"),
        ([str(maze_run), "--out", out, "--episodes", "0"], "--episodes is 0"),
        ([str(maze_run), "--out", out, "--num-envs", "-1"], "--num-envs is -1"),
        ([str(maze_run), "--out", out, "--option", "nothing=1"], "nothing"),
        ([str(maze_run), "--out", out, "--option", "start_noise"], "NAME=VALUE"),
        ([str(maze_run), "--out", out, "--option", "seed=1"], "use --seed"),
        ([str(maze_run), "--out", str(tmp_path), "--episodes", "1"], "cannot write"),
    ):
        assert main(["export-onnx", *arguments]) == 2
        stdout, stderr = capfd.readouterr()
        assert stdout == ""
        assert reason in stderr
        assert stderr.count("\n") == 1
    assert not Path(out).exists()


def test_run_with_broken_weights_is_refused_with_code_1(
    maze_run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    copy, out = tmp_path / "run", tmp_path / "policy.onnx"
    shutil.copytree(maze_run, copy)
    (weights,) = (copy / "checkpoints").glob("0*/weights.safetensors")
    tensors = load_file(weights)
    steady = "learner/steady_actor"  # what is exported: the average of the actor's weights
    name = next(key for key in tensors if key.startswith(steady) and key.endswith("bias"))
    tensors[name][0] = -np.inf  # behind a ReLU: no action shows it
    save_file(tensors, weights)
    assert main(["export-onnx", str(copy), "--out", str(out), "--episodes", "1"]) == 1
    assert "not finite" in capfd.readouterr().err
    assert not out.exists()


def test_arm_tasks_name_robot_and_limits_and_the_maze_has_none() -> None:
    maze = robot_metadata(tasks.make_batch("point_maze", 1))
    assert set(maze.values()) == {None}
    env = tasks.make_batch("open_press_close", 1)
    assert isinstance(env, ArmBatch)
    layout = env.layout
    assert layout.workspace is not None
    arm = robot_metadata(env)
    assert set(arm) == set(maze)
    assert arm["robot_model_hash"] == yumi.MODEL_HASH
    limits = arm["limits"]
    assert len(limits["joint_position_lower"]) == len(limits["joint_force"]) == 7
    model = env.scene.physics_model
    np.testing.assert_array_equal(
        limits["joint_force"], model.actuator_forcerange[env.scene.arm_ctrl, 1]
    )
    assert limits["free_lead"] == layout.workspace.free_following_error
    assert limits["held_lead"] == layout.workspace.held_following_error
    speed = list(limits["command_speed"].values())
    np.testing.assert_array_equal(speed, layout.action_scale / layout.control_dt)
    json.dumps(arm, allow_nan=False)
