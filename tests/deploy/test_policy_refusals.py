"""Policy files that are damaged, edited, foreign or contradictory are refused in one line."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, numpy_helper
from policy_graphs import LAYOUT, WEIGHT, graph, metadata, write

from skewmi import policy_file
from skewmi.deploy.policy import OnnxPolicy
from skewmi.errors import LayoutMismatchError, PolicyFileError, SkewmiError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "policy.onnx", graph(), metadata())


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
