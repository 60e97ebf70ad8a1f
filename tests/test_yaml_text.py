"""Whatever a file has, reading it ends soon, in what it says or in an error that names it."""

from __future__ import annotations

import json
import time
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError
from skewmi.yaml_text import LARGEST, parse_yaml

VALUES = st.recursive(
    st.integers(-1000, 1000) | st.booleans() | st.text("xyz 1:-#\"'", max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab"), inner, max_size=3),
    max_leaves=10,
)


@given(VALUES)
def test_json_is_read_back(value: object) -> None:
    assert parse_yaml(json.dumps(value), "it") == value


@pytest.mark.parametrize("part", ["[", "{a: ", "- ", "? ", "[{b: ", "!!seq [", "&a [*a, "])
@pytest.mark.parametrize("times", [500, 2000, LARGEST])
def test_nesting_without_end_is_refused_at_once(part: str, times: int) -> None:
    began = time.process_time()
    with pytest.raises(ConfigurationError, match="the file"):
        parse_yaml(part * times, "the file")
    assert time.process_time() - began < 5.0


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=300))
def test_any_text_is_read_or_refused(text: str) -> None:
    with suppress(ConfigurationError):
        parse_yaml(text, "the file")
