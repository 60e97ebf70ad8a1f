"""Scripted policies with which something happens on the way."""

from __future__ import annotations

from scripted_open_press_close import ScriptedOpenPressClose

from skewmi.errors import SkewmiError
from skewmi.policy_io import Array
from skewmi.sim.tasks.open_press_close.definition import make_layout


class FewSteps(ScriptedOpenPressClose):
    """The script; at one of its steps something happens."""

    def __init__(self, steps: int, what) -> None:
        super().__init__(make_layout())
        self._steps, self._what, self.count = steps, what, 0

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        if self.count == self._steps:
            self._what()
        return super().act(observation)


class EnoughError(SkewmiError):
    """What ends an episode early."""


def give_up() -> None:
    raise EnoughError("enough")


class Scripted(ScriptedOpenPressClose):
    """The script, with something that happens at one of its steps."""

    def __init__(self, at_step: int = -1, what=None) -> None:
        super().__init__(make_layout())
        self._at_step, self._what = at_step, what

    def reset(self) -> None:
        super().reset()
        self.count = 0

    def act(self, observation: Array) -> Array:
        self.count += 1
        action = super().act(observation)
        return self._what(action) if self.count == self._at_step else action
