"""A policy file is loaded whole, checked and fast, or refused in one line."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from skewmi import policy_file
from skewmi.deploy.policy import OnnxPolicy
from skewmi.errors import LayoutMismatchError, PolicyFileError, SkewmiError
from skewmi.policy_io import ActionField, Array, Ball, Field, PolicyLayout

LAYOUT = PolicyLayout(
    task="box",
    observation=(
        Field("hand_x", "m", "world", -0.019, 0.001),
        Field("lid_angle", "rad", "hinge", 0.0, 2.0 / 3.0),
        Field("time", "", "episode", 0.0, 1.0),
    ),
    action=(
        ActionField("velocity_x", "m", "world", 0.005),
        ActionField("velocity_y", "m", "world", 0.1 + 0.2),
    ),
    reward_region=(Ball(("lid_angle",), (0.0,), 0.05),),
    control_dt=0.1,
    episode_steps=200,
    success_hold_steps=10,
)
WEIGHT = np.random.default_rng(0).normal(size=(3, 2)).astype(np.float32)
SIZE = 4  # of the memory in recurrent graphs


def graph(
    weight: Array = WEIGHT,
    *,
    last: str = "Tanh",
    kind: int = TensorProto.FLOAT,
    input_name: str = "observation",
    output_name: str = "action",
) -> onnx.ModelProto:
    """action = last(observation @ weight)"""
    dtype = helper.tensor_dtype_to_np_dtype(kind)
    nodes = [
        helper.make_node("MatMul", [input_name, "weight"], ["sum"]),
        helper.make_node(last, ["sum"], [output_name]),
    ]
    made = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(input_name, kind, ["batch", weight.shape[0]])],
        [helper.make_tensor_value_info(output_name, kind, ["batch", weight.shape[1]])],
        [numpy_helper.from_array(weight.astype(dtype), "weight")],
    )
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def recurrent_graph() -> onnx.ModelProto:
    """h' = tanh(observation @ a + h), c' = c + 1, action = tanh(h' @ b + 0 c')."""
    generator = np.random.default_rng(1)
    a = generator.normal(size=(3, SIZE)).astype(np.float32)
    b = generator.normal(size=(SIZE, 2)).astype(np.float32)
    nodes = [
        helper.make_node("MatMul", ["observation", "a"], ["sum"]),
        helper.make_node("Add", ["sum", "h"], ["moved"]),
        helper.make_node("Tanh", ["moved"], ["h_next"]),
        helper.make_node("Add", ["c", "one"], ["c_next"]),
        helper.make_node("MatMul", ["h_next", "b"], ["out"]),
        helper.make_node("Tanh", ["out"], ["action"]),
    ]

    def value(name: str, width: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])

    made = helper.make_graph(
        nodes,
        "policy",
        [value("observation", 3), value("h", SIZE), value("c", SIZE)],
        [value("action", 2), value("h_next", SIZE), value("c_next", SIZE)],
        [
            numpy_helper.from_array(a, "a"),
            numpy_helper.from_array(b, "b"),
            numpy_helper.from_array(np.ones(1, np.float32), "one"),
        ],
    )
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def metadata(**changes: Any) -> dict[str, Any]:
    return {
        "skewmi_policy": policy_file.FORMAT_VERSION,
        "layout": json.loads(LAYOUT.to_json()),
        "layout_hash": LAYOUT.hash(),
        "task": LAYOUT.task,
        "method": "by hand",
        "robot_model_hash": "ab" * 32,
        "control_dt": LAYOUT.control_dt,
        "third": 1.0 / 3.0,
    } | changes


def write(path: Path, model: onnx.ModelProto, document: dict[str, Any]) -> Path:
    for key, text in policy_file.encode_metadata(document).items():
        model.metadata_props.add(key=key, value=text)
    path.write_bytes(policy_file.seal(model.SerializeToString()))
    return path


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


def refuse(path: Path, kind: type[SkewmiError], match: str) -> None:
    with pytest.raises(kind, match=match) as caught:
        OnnxPolicy.load(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    refuse(tmp_path / "missing.onnx", PolicyFileError, "No such file")
    refuse(tmp_path, PolicyFileError, "cannot read")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x00" * 1000, b"\x08\x0a", b"{}" * 99])
def test_what_is_no_model_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(content)
    refuse(path, PolicyFileError, "not a whole policy file")
    path.write_bytes(policy_file.seal(content))
    refuse(path, PolicyFileError, "ONNX")


def test_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # sparse
    refuse(path, PolicyFileError, "at most 256 MiB")


def test_foreign_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(graph().SerializeToString())
    refuse(path, PolicyFileError, "export-onnx")


@pytest.mark.parametrize("key", policy_file.REQUIRED_KEYS)
def test_missing_metadata_are_named(tmp_path: Path, key: str) -> None:
    document = metadata()
    del document[key]
    refuse(write(tmp_path / "policy.onnx", graph(), document), PolicyFileError, key)


def test_other_format_version_is_refused(tmp_path: Path) -> None:
    document = metadata(skewmi_policy=2)
    refuse(write(tmp_path / "p.onnx", graph(), document), PolicyFileError, "version 2")


def test_metadata_that_are_not_json_are_refused(tmp_path: Path) -> None:
    model = graph()
    model.metadata_props.add(key="note", value="not json")
    refuse(write(tmp_path / "policy.onnx", model, metadata()), PolicyFileError, "'note'")


def test_every_truncation_is_refused(path: Path) -> None:
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(PolicyFileError):
            OnnxPolicy.load(path)
    path.write_bytes(whole + b"\x00")
    with pytest.raises(PolicyFileError):
        OnnxPolicy.load(path)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(position=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_every_flipped_bit_is_refused(path: Path, position: float, bit: int) -> None:
    whole = write(path, graph(), metadata()).read_bytes()
    damaged = bytearray(whole)
    damaged[int(position * len(whole))] ^= 1 << bit
    path.write_bytes(damaged)
    with pytest.raises(SkewmiError):
        OnnxPolicy.load(path)


def test_rewritten_weight_and_edited_metadata_are_refused(path: Path) -> None:
    model = onnx.load(path)
    weight = np.array(WEIGHT)
    weight[0, 0] = np.nextafter(weight[0, 0], np.float32(1.0))
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(weight, "weight"))
    onnx.save(model, path)
    refuse(path, PolicyFileError, "damaged or edited")
    model = graph()
    write(path, model, metadata())
    model = onnx.load(path)
    next(entry for entry in model.metadata_props if entry.key == "method").value = '"better"'
    onnx.save(model, path)
    refuse(path, PolicyFileError, "damaged or edited")


def test_file_that_another_tool_only_copied_still_loads(path: Path) -> None:
    onnx.save(onnx.load(path), path)
    assert OnnxPolicy.load(path).layout == LAYOUT


def test_layout_that_does_not_have_its_hash_is_refused(tmp_path: Path) -> None:
    other = dataclasses.replace(LAYOUT, control_dt=0.05)
    document = metadata(layout_hash=other.hash())
    refuse(write(tmp_path / "p.onnx", graph(), document), LayoutMismatchError, "hash")


@pytest.mark.parametrize(
    "layout", [None, 3, {}, {**json.loads(LAYOUT.to_json()), "layout_version": 99}]
)
def test_what_is_no_layout_is_refused(tmp_path: Path, layout: Any) -> None:
    path = write(tmp_path / "p.onnx", graph(), metadata(layout=layout))
    refuse(path, LayoutMismatchError, "layout")


@pytest.mark.parametrize("shape", [(2, 2), (4, 2), (3, 1), (3, 3)])
def test_graph_of_other_width_than_its_layout_is_refused(
    tmp_path: Path, shape: tuple[int, int]
) -> None:
    model = graph(np.ones(shape, np.float32))
    refuse(write(tmp_path / "p.onnx", model, metadata()), LayoutMismatchError, "its layout")


@pytest.mark.parametrize(
    "model",
    [
        graph(kind=TensorProto.DOUBLE),
        graph(input_name="state"),
        graph(output_name="torque"),
    ],
    ids=["double", "input", "output"],
)
def test_graph_of_another_signature_is_refused(tmp_path: Path, model: onnx.ModelProto) -> None:
    refuse(write(tmp_path / "p.onnx", model, metadata()), PolicyFileError, "a policy")


@pytest.mark.parametrize(
    ("model", "match"),
    [
        (graph(np.full((3, 2), np.nan, np.float32)), "not finite"),
        (graph(1e3 * WEIGHT, last="Identity"), r"allowed is \[-1, 1\]"),
        (graph(last="Log"), "not finite"),
    ],
    ids=["nan", "unsquashed", "log"],
)
def test_graph_without_usable_actions_is_refused(
    tmp_path: Path, model: onnx.ModelProto, match: str
) -> None:
    refuse(write(tmp_path / "p.onnx", model, metadata()), PolicyFileError, match)


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


def test_one_observation_takes_less_than_100_us(tmp_path: Path) -> None:
    """With the network of the paper's size; the median, because tests share their processor."""
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
    policy = OnnxPolicy.load(write(tmp_path / "policy.onnx", model, metadata()))
    observation = np.zeros(3)
    times = []
    for _ in range(500):
        started = time.perf_counter()
        policy.act(observation)
        times.append(time.perf_counter() - started)
    assert np.median(times) < 100e-6
