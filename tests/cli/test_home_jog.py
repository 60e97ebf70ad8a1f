"""`skewmi home` and `skewmi jog`: what they refuse without a robot."""

from __future__ import annotations

import pytest

from skewmi.cli.main import main

NOBODY = ["--connect", "tcp/127.0.0.1:1"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["jog"], "nothing to do: give --x"),
        (["jog", "--x", "51"], "--x is 51.0; it must be in -50..50"),
        (["jog", "--x", "nan"], "--x is nan; it must be in -50..50"),
        (["jog", "--x", "40", "--y", "40"], "it must be in 0.1..50"),
        (["jog", "--z", "0.01"], "it must be in 0.1..50"),
        (["jog", "--degrees", "3"], "give --joint, too"),
        (["jog", "--joint", "3"], "--joint needs --degrees"),
        (["jog", "--joint", "8", "--degrees", "1"], "1..7"),
        (["jog", "--joint", "2", "--degrees", "11"], "--degrees"),
        (["jog", "--joint", "2", "--degrees", "nan"], "--degrees"),
        (["jog", "--joint", "2", "--degrees", "1", "--x", "1"], "give one of them"),
        (["home", "--lead-ms", "9"], "multiple of 4"),
        (["home", "--limits", "wild"], "wild"),
    ],
)
def test_bad_options_are_told(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, *NOBODY]) == 2
    assert message in capsys.readouterr().err
