"""Progress: fits into 80 columns, a line every 30 s elsewhere, and a line that is rewritten."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from skewmi.progress import EVERY_S, LiveLine, ProgressBar, count_text, time_text

_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("width", [40, 80, 200])
def test_a_bar_fits_into_any_width_and_tells_what_is_left(width: int) -> None:
    shown, clock = Terminal(), Clock()
    console = Console(file=shown, width=width, force_terminal=True, color_system=None)
    with ProgressBar("training", console=console, clock=clock) as bar:
        clock.now = 60.0
        bar(250, 1000, "steps  " + "words that are far too long for a line " * 4)
    lines = [_ESCAPES.sub("", line) for line in re.split(r"[\r\n]", shown.getvalue())]
    assert max(map(len, lines)) <= width
    if width >= 80:
        assert any("250 of 1,000, 3:00 left" in line for line in lines)


def test_without_a_terminal_there_is_a_line_now_and_then() -> None:
    shown, clock = io.StringIO(), Clock()
    with ProgressBar("drawing", "frames", console=Console(file=shown), clock=clock) as bar:
        for second in range(65):
            clock.now = float(second)
            bar(second, 100, "words")
        bar.note("a note")
    assert EVERY_S == 30.0
    assert shown.getvalue().splitlines() == [
        "drawing: 30 of 100 frames, 1:10 left  words",
        "drawing: 60 of 100 frames, 0:40 left  words",
        "a note",
    ]


def test_what_is_not_wanted_is_silent() -> None:
    shown, clock = io.StringIO(), Clock()
    console = Console(file=shown, force_terminal=True)
    with ProgressBar("drawing", enabled=False, console=console, clock=clock) as bar:
        clock.now = 100.0
        bar(1, 2)
        bar.note("a note")
    assert shown.getvalue() == ""


def test_a_live_line_is_rewritten_and_gives_way_to_notes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    shown, words = Terminal(), ["running, step 1", "", "a line much longer than the terminal is"]
    line = LiveLine(lambda: words[0], file=shown)
    line.say()
    line.note("episode 1: success")
    del words[0]
    line.say()
    del words[0]
    line.say()
    clear = "\r\x1b[K"
    assert shown.getvalue() == f"running, step 1{clear}episode 1: success\na line much longer "


def test_a_live_line_elsewhere_is_a_line_now_and_then() -> None:
    shown, clock = io.StringIO(), Clock()
    line = LiveLine(lambda: "running", file=shown, clock=clock)
    for second in range(95):
        clock.now = float(second)
        line.say()
    assert shown.getvalue() == "running\n" * 3


def test_a_terminal_that_is_gone_disturbs_nobody() -> None:
    shown = Terminal()
    with LiveLine(lambda: "running", file=shown) as line:
        shown.close()
        line.say()
        line.note("episode 1: success")


def test_counts_and_times() -> None:
    assert count_text(1.5, 10.0, "min", 510.0) == "1.5 of 10.0 min, 8:30 left"
    assert count_text(3, None, "", None) == "3"
    assert [time_text(s) for s in (-1.0, 7.4, 750.0, 11100.0)] == [
        "0:00",
        "0:07",
        "12:30",
        "3:05:00",
    ]
