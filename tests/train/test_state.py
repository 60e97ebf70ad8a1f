"""States in two files."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from skewmi.train.state import as_array, merge, split


def test_a_state_comes_back_from_its_two_parts() -> None:
    state = {
        "weight": torch.arange(3.0),
        "inner": {"array": np.array([True, False]), "deeper": {"x.y": torch.zeros(2, 0)}},
        "count": 3,
        "first": {"a name with / in it": {"step": 1}},
        "nothing": None,
    }
    tensors, rest = split(state)
    assert sorted(tensors) == ["inner/array", "inner/deeper/x.y", "weight"]
    back = merge(tensors, json.loads(json.dumps(rest)))
    assert back["count"] == 3
    assert back["nothing"] is None
    assert back["first"] == state["first"]
    assert torch.equal(back["weight"], state["weight"])
    assert back["inner"]["deeper"]["x.y"].shape == (2, 0)
    np.testing.assert_array_equal(as_array(back["inner"]["array"]), [True, False])
    assert as_array(back["inner"]["array"]).dtype == np.bool_


def test_a_tensor_whose_path_would_be_ambiguous_is_refused() -> None:
    with pytest.raises(AssertionError):
        split({"a/b": torch.zeros(1)})


def test_arrays_are_copies() -> None:
    tensor = torch.zeros(2)
    array = as_array(tensor)
    array[0] = 1.0
    assert tensor[0] == 0.0
