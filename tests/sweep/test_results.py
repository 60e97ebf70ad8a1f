"""What the runs of a sweep came to, as a table."""

from __future__ import annotations

import pytest

from skewmi.sweep.results import _all_of


@pytest.mark.parametrize(
    ("noted", "told"),
    [
        ([], None),
        ([None, None], None),
        (["avx", "avx"], "avx"),
        (["avx", "default", "avx"], "avx default"),
        ([None, "avx"], "unknown avx"),
    ],
)
def test_what_a_part_does_not_tell_is_unknown(noted: list[str | None], told: str | None) -> None:
    parts = [{"step": 0} | ({"kernels": name} if name else {}) for name in noted]
    assert _all_of(parts, "kernels") == told
