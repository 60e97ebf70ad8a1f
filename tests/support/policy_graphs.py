"""Policy files with graphs made by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from skewmi import policy_file
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
