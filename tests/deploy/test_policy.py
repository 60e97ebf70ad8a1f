"""A policy file is loaded whole and acts, fast, as its graph says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from costs import cost_ratio
from onnx import helper, numpy_helper
from policy_graphs import LAYOUT, SIZE, WEIGHT, graph, metadata, recurrent_graph, write

from skewmi import policy_file
from skewmi.deploy.policy import OnnxPolicy
from skewmi.errors import LayoutMismatchError
from skewmi.policy_io import Array


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "policy.onnx", graph(), metadata())


def expect(observation: Array) -> Array:
    return np.tanh(observation @ WEIGHT.astype(np.float64))


def test_acts_as_the_graph_says_for_every_leading_shape(path: Path) -> None:
    policy = OnnxPolicy.load(path)
    assert policy.layout == LAYOUT
    assert not policy.recurrent
    for shape in ((3,), (1, 3), (7, 3), (2, 5, 3), (0, 3)):
        observation = np.random.default_rng(2).normal(size=shape)
        action = policy.act(observation)
        assert action.dtype == np.float64
        assert action.shape == (*shape[:-1], 2)
        np.testing.assert_allclose(action, expect(observation), atol=1e-6)


def test_does_not_write_into_the_observation_nor_share_its_result(path: Path) -> None:
    policy = OnnxPolicy.load(str(path))
    observation = np.ones(3, dtype=np.float32)
    first = policy.act(observation)
    kept = first.copy()
    policy.act(-observation)
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(observation, 1.0)


def test_metadata_come_back_at_full_precision(path: Path) -> None:
    found = OnnxPolicy.load(path).metadata
    for key, value in metadata().items():
        assert found[key] == value


def test_memory_goes_on_until_reset(tmp_path: Path) -> None:
    path = write(tmp_path / "policy.onnx", recurrent_graph(), metadata())
    policy = OnnxPolicy.load(path)
    assert policy.recurrent
    observation = np.array([0.1, 0.2, 0.3])
    first, second = policy.act(observation), policy.act(observation)
    assert np.abs(first - second).max() > 1e-3
    policy.reset()
    np.testing.assert_array_equal(policy.act(observation), first)
    np.testing.assert_array_equal(policy.act(observation), second)
    policy.reset()
    batch = np.stack([policy.act(np.tile(observation, (4, 1))) for _ in range(2)])
    np.testing.assert_allclose(batch, np.stack([[first] * 4, [second] * 4]), atol=1e-6)


def test_memory_that_does_not_fit_itself_or_its_description_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    right = policy_file.memory_document({"h": SIZE, "c": SIZE})
    write(path, recurrent_graph(), metadata(memory=right))
    assert OnnxPolicy.load(path).metadata["memory"] == right
    wrong = policy_file.memory_document({"h": SIZE, "c": SIZE + 1})
    for model, described in ((recurrent_graph(), wrong), (graph(), right), (graph(), "none")):
        write(path, model, metadata(memory=described))
        with pytest.raises(LayoutMismatchError, match="export the policy again"):
            OnnxPolicy.load(path)
    narrow = recurrent_graph()
    less = numpy_helper.from_array(np.ones((SIZE, SIZE - 1), np.float32), "less")
    narrow.graph.initializer.append(less)
    narrow.graph.node[3].CopyFrom(helper.make_node("MatMul", ["c", "less"], ["c_next"]))
    narrow.graph.output[2].type.tensor_type.shape.dim[1].dim_value = SIZE - 1
    write(path, narrow, metadata())
    with pytest.raises(LayoutMismatchError, match="c has 4 numbers, but what follows it, c_next"):
        OnnxPolicy.load(path)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_observation_that_is_not_finite_is_refused_by_name(path: Path, bad: float) -> None:
    policy = OnnxPolicy.load(path)
    with (
        np.errstate(over="ignore"),
        pytest.raises(LayoutMismatchError, match=r"not finite in lid_angle$"),
    ):
        policy.act(np.array([[0.0, 0.0, 0.0], [0.0, bad, 0.0]]))


@pytest.mark.parametrize("shape", [(), (2,), (4,), (3, 2)])
def test_observation_of_another_width_is_refused(path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(LayoutMismatchError, match="hand_x, lid_angle, time"):
        OnnxPolicy.load(path).act(np.zeros(shape))


def test_file_that_another_tool_only_copied_still_loads(path: Path) -> None:
    onnx.save(onnx.load(path), path)
    assert OnnxPolicy.load(path).layout == LAYOUT


def test_loads_without_torch_and_onnx(path: Path) -> None:
    script = (
        "import sys; from skewmi.deploy.policy import OnnxPolicy; import numpy as np; "
        f"print(OnnxPolicy.load({str(path)!r}).act(np.zeros(3)).shape); "
        "print(sorted({'torch', 'onnx', 'google.protobuf'} & set(sys.modules)))"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert result.stdout.split("\n")[:2] == ["(2,)", "[]"]
    assert result.stderr == ""


def test_one_observation_costs_little_more_than_onnxruntime(tmp_path: Path) -> None:
    """With the network of the paper's size, 1.6 to 1.7 times; 50 us of a quick computer."""
    wide = np.random.default_rng(3).normal(size=(128, 128)).astype(np.float32) / 12
    model = graph(np.random.default_rng(4).normal(size=(3, 128)).astype(np.float32))
    nodes = list(model.graph.node)
    nodes[-1].output[0] = "a"
    nodes += [
        helper.make_node("MatMul", ["a", "wide"], ["b"]),
        helper.make_node("Relu", ["b"], ["c"]),
        helper.make_node("MatMul", ["c", "head"], ["d"]),
        helper.make_node("Tanh", ["d"], ["action"]),
    ]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    model.graph.initializer.append(numpy_helper.from_array(wide, "wide"))
    model.graph.initializer.append(numpy_helper.from_array(wide[:, :2], "head"))
    model.graph.output[0].type.tensor_type.shape.dim[1].dim_value = 2
    path = write(tmp_path / "policy.onnx", model, metadata())
    policy = OnnxPolicy.load(path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    bare = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    feed = {"observation": np.zeros((1, 3), np.float32)}
    observation = np.zeros(3)
    assert cost_ratio(lambda: policy.act(observation), lambda: bare.run(None, feed)) < 3.0
