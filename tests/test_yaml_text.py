"""Whatever a file has, reading it ends soon, in what it says or in an error that names it."""

from __future__ import annotations

import json
import time
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.errors import ConfigurationError
from skewmi.yaml_text import LARGEST, parse_yaml, shown

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


def bomb(lists: int) -> str:
    """10 ** lists numbers in some 50 characters for each list."""
    names = [f"&a{i} [{','.join([f'*a{i - 1}' if i else '1'] * 10)}]" for i in range(lists)]
    return f"it: [{','.join(names)}]"


@pytest.mark.parametrize(
    ("text", "line"),
    [(bomb(9), 1), ("a: &b 1", 1), ("a: 1\nb: *a", 2), ("&a [*a]", 1), ("x: &x\n  <<: *x", 1)],
)
def test_anchors_and_aliases_are_refused_with_their_line(text: str, line: int) -> None:
    began = time.process_time()
    with pytest.raises(ConfigurationError, match=f"the file, line {line}: anchors .* are not read"):
        parse_yaml(text, "the file")
    assert time.process_time() - began < 5.0


def test_what_only_looks_like_an_alias_is_read() -> None:
    text = "a: '*b'\nc: \"&d\"\ne: 3*4\nf: x & y  # *g &h\n"
    assert parse_yaml(text, "it") == {"a": "*b", "c": "&d", "e": "3*4", "f": "x & y"}


@pytest.mark.parametrize("number", ["0x" + "f" * 5000, "-" + "9" * 400, "0o" + "7" * 50000])
def test_numbers_that_no_float_can_hold_are_refused(number: str) -> None:
    with pytest.raises(ConfigurationError, match="line 2: a number of more than 40 characters"):
        parse_yaml(f"a: 1\nb: {number}", "the file")
    assert parse_yaml(f"'{number}'", "it") == number
    assert parse_yaml("1" * 40, "it") == int("1" * 40)


@pytest.mark.parametrize("text", ["!!bool maybe", "!!int ''", "!!float ''", '"\\UFFFFFFFF"'])
def test_what_the_parser_stumbles_over_is_an_error_like_any_other(text: str) -> None:
    with pytest.raises(ConfigurationError, match="the file is not YAML"):
        parse_yaml(text, "the file")


def test_messages_show_values_in_bounded_time() -> None:
    many: list[object] = [1] * 10
    for _ in range(20):
        many = [many] * 10
    began = time.process_time()
    for value in (many, {"a": many}, "x" * 10**6, (many, many), 10**500):
        assert len(shown(value)) <= 80
    assert time.process_time() - began < 1.0
    for short in ("heavy", [0.1, 0.2, 0.3, 4, 5, 6, 7], {"a": True}, None, 1.5):
        assert shown(short) == repr(short)
