"""Each field of the scene has an age of its own: one that falls silent stops the arm."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from skewmi.deploy.session import scene_states as scene_module
from skewmi.deploy.session.scene_states import MAX_SCENE_AGE_S, SceneStates, StaleStateError
from skewmi.deploy.wire.messages import JointStates, decode_joint_states, encode_joint_states

FIELDS = {"lid_hinge": "lid_angle", "button_slide": "button_depth"}
NEEDED = ("hand_x", "lid_angle", "button_depth", "time")
PERIOD_NS = 20_000_000
ALLOWED_NS = round(1e9 * MAX_SCENE_AGE_S)


class Scene:
    """A publisher of scene states, and what a session makes of them, in a time that tests set.

    Args:
        needed: See `SceneStates`.
        lock_step: Likewise.
    """

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        needed: tuple[str, ...] = NEEDED,
        *,
        lock_step: bool = False,
    ) -> None:
        self.now_ns = 0
        self._unread: list[Any] = []
        clock = SimpleNamespace(monotonic_ns=lambda: self.now_ns)
        patch.setattr(scene_module, "time", clock)
        self.states = SceneStates(self, FIELDS, needed, lock_step=lock_step)  # type: ignore[arg-type]

    def drain(self) -> list[Any]:
        unread, self._unread = self._unread, []
        return unread

    def others(self) -> str:
        return ""

    def tell(self, stamp_ns: int | None = None, **values: float) -> None:
        nothing = np.zeros(0)
        stamp = self.now_ns if stamp_ns is None else stamp_ns
        states = JointStates(stamp, tuple(values), np.array([*values.values()]), nothing, nothing)
        payload = encode_joint_states(states)
        self._unread.append(SimpleNamespace(payload=payload, received_ns=self.now_ns))

    def look(self, arm_stamp_ns: int | None = None) -> None:
        stamp = self.now_ns if arm_stamp_ns is None else arm_stamp_ns
        self.states.take(stamp)
        self.states.check(stamp)


def until_stopped(scene: Scene, **values: float) -> int:
    """How long it takes to stop where states go on with these values alone, ns."""
    begun_ns = scene.now_ns
    for _ in range(50):
        scene.now_ns += PERIOD_NS
        scene.tell(None, **values)
        if said := said_in(scene):
            lost = set(FIELDS) - {name for name, x in values.items() if math.isfinite(x)}
            assert f"for {sorted(FIELDS[name] for name in lost)}; at most 200 ms" in said
            return scene.now_ns - begun_ns
    pytest.fail("nobody noticed")


def said_in(scene: Scene) -> str:
    """Why the arm stops with what is known now; nothing if it does not."""
    try:
        scene.look()
    except StaleStateError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("lock_step", [False, True])
@pytest.mark.parametrize(
    "values",
    [
        {"button_slide": 0.0},
        {"lid_hinge": 0.1},
        {"button_slide": 0.0, "lid_hinge": math.nan},
        {"button_slide": math.inf, "lid_hinge": 0.1},
    ],
    ids=["no lid", "no button", "no number for the lid", "no number for the button"],
)
def test_a_field_that_falls_silent_while_another_goes_on_stops_the_arm(
    values: dict[str, float], lock_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(monkeypatch, lock_step=lock_step)
    scene.tell(lid_hinge=0.1, button_slide=0.0)
    scene.look()
    taken_ns = until_stopped(scene, **values)
    assert ALLOWED_NS < taken_ns <= ALLOWED_NS + PERIOD_NS
    assert scene.states.values == {"lid_angle": 0.1, "button_depth": 0.0}


def test_a_field_that_nobody_needs_may_fall_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch, ("hand_x", "button_depth"))
    scene.tell(lid_hinge=0.1, button_slide=0.0)
    for _ in range(50):
        scene.look()
        scene.now_ns += PERIOD_NS
        scene.tell(button_slide=0.0)
    scene.tell(lid_hinge=0.1)
    scene.now_ns += ALLOWED_NS + 1
    with pytest.raises(StaleStateError, match=r"for \['button_depth'\]"):
        scene.look()


def test_fields_may_be_told_by_turns_and_come_together(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.tell(lid_hinge=0.1)
    with pytest.raises(StaleStateError, match=r"the scene states lack \['button_depth'\]"):
        scene.look()
    for cycle in range(50):
        scene.tell(lid_hinge=0.001 * cycle)
        scene.tell(lid_hinge=0.002 * cycle)
        scene.tell(button_slide=-0.001 * cycle)
        scene.look()
        assert scene.states.values == {"lid_angle": 0.002 * cycle, "button_depth": -0.001 * cycle}
        scene.now_ns += PERIOD_NS


def test_of_many_states_the_last_alone_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    decoded: list[int] = []
    decode = decode_joint_states

    def counted(payload: bytes) -> JointStates:
        decoded.append(len(payload))
        return decode(payload)

    monkeypatch.setattr(scene_module, "decode_joint_states", counted)
    for number in range(100):
        scene.tell(lid_hinge=0.01 * number, button_slide=0.0)
    scene.look()
    assert len(decoded) == 1
    assert scene.states.values["lid_angle"] == pytest.approx(0.99)


def test_states_that_repeat_an_old_stamp_are_old_in_the_field_they_tell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch)
    scene.tell(lid_hinge=0.1, button_slide=0.0)
    scene.look()
    for cycle in range(1, 12):
        scene.now_ns += PERIOD_NS
        scene.tell(0, lid_hinge=0.1)
        scene.tell(button_slide=0.0)
        said = said_in(scene)
        assert bool(said) == (cycle * PERIOD_NS > ALLOWED_NS)
    assert "the scene state is 220 ms old for ['lid_angle']" in said


def test_silence_makes_every_field_old(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.tell(lid_hinge=0.1, button_slide=0.0)
    scene.look()
    scene.now_ns += ALLOWED_NS
    scene.look()
    scene.now_ns += 1_000_000
    with pytest.raises(
        StaleStateError, match=r"the scene state is 201 ms old for \['button_depth', 'lid_angle'\]"
    ):
        scene.look()


def test_in_lock_step_late_states_are_taken_when_their_time_has_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = Scene(monkeypatch, lock_step=True)
    scene.tell(lid_hinge=0.1, button_slide=0.0)
    scene.look()
    # None is too old however long no state came, and one of the future waits.
    scene.now_ns += 50 * PERIOD_NS
    scene.tell(scene.now_ns + 1, lid_hinge=0.2, button_slide=0.0)
    scene.look()
    assert scene.states.values["lid_angle"] == 0.1
    scene.now_ns += 1
    scene.look()
    assert scene.states.values["lid_angle"] == 0.2


def test_what_begins_anew_knows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.tell(lid_hinge=0.1, button_slide=0.0)
    scene.look()
    scene.tell(lid_hinge=0.2, button_slide=0.0)
    scene.states.begin_anew()
    with pytest.raises(StaleStateError, match="no scene state came, which the policy needs for"):
        scene.look()
    scene.tell(button_slide=0.0)
    with pytest.raises(StaleStateError, match=r"lack \['lid_angle'\]"):
        scene.look()
