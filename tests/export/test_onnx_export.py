"""The exported graph is the policy, and an export that is not is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from skewmi.errors import OutputError, PolicyFileError, VerificationError
from skewmi.export.onnx_export import TOLERANCE, export_policy, max_difference
from skewmi.export.onnx_graph import build_model
from skewmi.policy_io import Array, PolicyLayout


def run(path: Path, observation: Array) -> Array:
    session = onnxruntime.InferenceSession(path.read_bytes())
    (action,) = session.run(["action"], {"observation": observation.astype(np.float32)})
    return action


def metadata_of(path: Path) -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load(path).metadata_props}


def test_graph_equals_torch_over_many_and_extreme_observations(
    tmp_path: Path, feedforward: Any, observations: Array, layout: PolicyLayout
) -> None:
    report = export_policy(feedforward, tmp_path / "policy.onnx", observations)
    assert report.max_difference <= TOLERANCE
    assert report.observations == 160
    assert report.size_bytes == (tmp_path / "policy.onnx").stat().st_size
    low, high = layout.observation_low, layout.observation_high
    many = np.random.default_rng(1).uniform(low, high, (5000, len(low)))
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, len(low))
    for given in (many, corners, corners * 1e3, np.zeros((1, 4)), np.full((3, 4), -1e9)):
        action = run(report.path, given)
        np.testing.assert_allclose(action, feedforward.act(given), rtol=0.0, atol=TOLERANCE)
        assert np.abs(action).max() <= 1.0
    assert np.abs(run(report.path, corners * 1e3)).max() > 0.99  # squashing is inside


def test_saturated_actions_are_one_to_the_last_bit(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    """onnxruntime's own tanh of large numbers is above 1 by one bit for some of them."""
    with torch.no_grad():
        for parameter in feedforward.module.parameters():
            parameter.mul_(30.0)
    path = export_policy(feedforward, tmp_path / "policy.onnx", observations).path
    many = np.random.default_rng(2).uniform(-2.0, 2.0, (20_000, 4))
    action = run(path, many)
    assert np.abs(action).max() == 1.0


def test_every_batch_size_gives_the_same(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    path = export_policy(feedforward, tmp_path / "policy.onnx", observations).path
    rows = observations.reshape(-1, 4)
    alone = np.concatenate([run(path, row[None]) for row in rows])
    np.testing.assert_allclose(run(path, rows), alone, rtol=0.0, atol=1e-6)


def test_reference_point_and_normaliser_are_folded_in(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    """Changing either in torch changes the exported actions as it does torch's."""
    before = export_policy(feedforward, tmp_path / "a.onnx", observations).path
    feedforward.module.reference += 1.0
    feedforward.module.centre += 0.01
    after = export_policy(feedforward, tmp_path / "b.onnx", observations).path
    assert np.abs(run(before, observations[0]) - run(after, observations[0])).max() > 1e-3
    assert [value.name for value in onnx.load(after).graph.input] == ["observation"]


def test_policy_with_memory_is_exported_step_by_step(
    tmp_path: Path, recurrent: Any, observations: Array
) -> None:
    report = export_policy(recurrent, tmp_path / "policy.onnx", observations)
    session = onnxruntime.InferenceSession(report.path.read_bytes())
    assert [value.name for value in session.get_inputs()] == ["observation", "h", "c"]
    assert [value.name for value in session.get_outputs()] == ["action", "h_next", "c_next"]
    memory = json.loads(metadata_of(report.path)["memory"])
    assert memory["sizes"] == {"h": 16, "c": 16}
    assert memory["next"] == {"h": "h_next", "c": "c_next"}
    assert "zeros" in memory["initial"]


def test_metadata_come_back_at_full_precision(
    tmp_path: Path, feedforward: Any, observations: Array, layout: PolicyLayout
) -> None:
    path = tmp_path / "policy.onnx"
    extra = {"seed": 4, "limits": {"velocity": [0.1 + 0.2, 1e308]}, "note": "Grüße \N{DEGREE SIGN}"}
    report = export_policy(feedforward, path, observations, metadata=extra)
    found = {key: json.loads(text) for key, text in metadata_of(path).items()}
    for key, value in {**feedforward.metadata, **extra}.items():
        assert found[key] == value
    assert PolicyLayout.from_json(metadata_of(path)["layout"]) == layout
    assert found["layout_hash"] == report.layout_hash == layout.hash()
    assert found["control_dt"] == layout.control_dt
    assert found["task"] == "box"
    assert found["versions"]["torch"] == torch.__version__
    assert found["verification"]["max_difference"] == report.max_difference


def test_same_policy_gives_the_same_bytes_without_paths_of_this_machine(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    first = export_policy(feedforward, tmp_path / "a.onnx", observations)
    second = export_policy(feedforward, tmp_path / "b.onnx", observations)
    assert first.sha256 == second.sha256
    data = first.path.read_bytes()
    assert data == second.path.read_bytes()
    assert str(Path(__file__).parent).encode() not in data
    assert b".py" not in data


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused(
    tmp_path: Path, feedforward: Any, observations: Array, value: float
) -> None:
    feedforward.module.body[0].weight.data[3, 2] = value
    with pytest.raises(VerificationError, match=r"not finite in body\.0\.weight"):
        export_policy(feedforward, tmp_path / "policy.onnx", observations)
    assert list(tmp_path.iterdir()) == []


def test_actions_that_are_not_finite_are_refused(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    feedforward.module.scale *= 1e30
    feedforward.module.body[0].weight.data *= 1e30
    with pytest.raises(VerificationError, match="differs from torch by nan"):
        export_policy(feedforward, tmp_path / "policy.onnx", observations)
    assert list(tmp_path.iterdir()) == []


def test_graph_that_is_not_the_policy_is_refused_and_the_old_file_stays(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    path = tmp_path / "policy.onnx"
    export_policy(feedforward, path, observations)
    before = path.read_bytes()

    class Off(torch.nn.Module):
        def forward(self, observation: torch.Tensor) -> torch.Tensor:
            return original(observation) * (1.0 - 1e-4)

    original = feedforward.module
    act = feedforward.act
    feedforward.module = Off()
    feedforward.act = lambda observation: (
        original(torch.tensor(observation).float()).detach().double().numpy()
    )
    with pytest.raises(VerificationError, match="allowed 1e-05"):
        export_policy(feedforward, path, observations)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["policy.onnx"]
    assert act(observations[0]).shape == (8, 2)


def test_difference_sees_every_rewritten_weight(
    feedforward: Any, observations: Array, layout: PolicyLayout
) -> None:
    model = build_model(feedforward.module, layout)
    assert max_difference(feedforward, model.SerializeToString(), observations) <= TOLERANCE
    for index, tensor in enumerate(model.graph.initializer):
        values = onnx.numpy_helper.to_array(tensor)
        if values.dtype != np.float32 or values.ndim == 0:  # the bounds of the clamp are scalars
            continue
        changed = onnx.ModelProto()
        changed.CopyFrom(model)
        noise = np.random.default_rng(index).normal(0.0, 0.05, values.shape)
        changed.graph.initializer[index].CopyFrom(
            onnx.numpy_helper.from_array(values + noise.astype(np.float32), tensor.name)
        )
        difference = max_difference(feedforward, changed.SerializeToString(), observations)
        assert difference > TOLERANCE, tensor.name


@pytest.mark.parametrize("missing", ["method", "robot_model_hash"])
def test_missing_metadata_are_named(
    tmp_path: Path, feedforward: Any, observations: Array, missing: str
) -> None:
    del feedforward.metadata[missing]
    with pytest.raises(PolicyFileError, match=missing):
        export_policy(feedforward, tmp_path / "policy.onnx", observations)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {1, 2}, b"bytes"])
def test_metadata_that_are_not_json_are_refused(
    tmp_path: Path, feedforward: Any, observations: Array, value: Any
) -> None:
    with pytest.raises(PolicyFileError, match="'figure'"):
        export_policy(
            feedforward, tmp_path / "policy.onnx", observations, metadata={"figure": value}
        )


def test_metadata_cannot_replace_what_the_export_knows(
    tmp_path: Path, feedforward: Any, observations: Array, layout: PolicyLayout
) -> None:
    claim = {"layout_hash": "0" * 64, "task": "other"}
    path = export_policy(feedforward, tmp_path / "p.onnx", observations, metadata=claim).path
    assert json.loads(metadata_of(path)["layout_hash"]) == layout.hash()
    assert json.loads(metadata_of(path)["task"]) == "box"


@pytest.mark.parametrize("shape", [(5, 3), (2, 5, 3), (0, 4), (4,), (2, 2, 2, 4)])
def test_observations_of_another_shape_are_refused(
    tmp_path: Path, feedforward: Any, shape: tuple[int, ...]
) -> None:
    with pytest.raises(PolicyFileError, match="observations"):
        export_policy(feedforward, tmp_path / "policy.onnx", np.zeros(shape))


def test_module_that_torch_cannot_export_is_one_line(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    class DataDependent(torch.nn.Module):
        def forward(self, observation: torch.Tensor) -> torch.Tensor:
            if observation.sum() > 0:
                return observation[:, :2]
            return -observation[:, :2]

    feedforward.module = DataDependent()
    with pytest.raises(PolicyFileError, match="torch cannot write") as caught:
        export_policy(feedforward, tmp_path / "policy.onnx", observations)
    assert "\n" not in str(caught.value)


def test_path_that_cannot_be_written_is_one_line(
    tmp_path: Path, feedforward: Any, observations: Array
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        export_policy(feedforward, tmp_path / "file" / "policy.onnx", observations)
    with pytest.raises(OutputError, match="cannot write"):
        export_policy(feedforward, tmp_path, observations)


def test_export_is_quiet(
    tmp_path: Path, feedforward: Any, observations: Array, capfd: pytest.CaptureFixture[str]
) -> None:
    export_policy(feedforward, tmp_path / "policy.onnx", observations)
    assert capfd.readouterr() == ("", "")
