"""The batched simulation and a deployed episode command the same for the same hands.

Both are driven as they are in use: `CommandPath` by the simulation's looks, the session's control
loop by states that come in. Only the arm is a recording, and the planner's command takes effect at
once, as it does in training. All numbers must be equal to the digit; to rounding, if the arms are
known to be soft.
"""

from __future__ import annotations

import dataclasses
import threading
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skewmi.deploy.session.arm_delay import ArmDelay
from skewmi.deploy.session.arm_state import ArmState
from skewmi.deploy.session.control_loop import ControlLoop
from skewmi.deploy.session.policy_motion import PolicyMotion
from skewmi.deploy.session.timing import CycleTimes
from skewmi.policy_io import Array, PolicyLayout
from skewmi.sim.arm import definition
from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.command_path import CommandPath
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.tasks.open_press_close.definition import ARM, make_layout
from skewmi.trajectory import CYCLE_NS, CYCLE_TICKS

LOOKS = definition.SUBSTEPS // definition.WATCH_SUBSTEPS


def layout_of(actions: Array) -> PolicyLayout:
    """The task's, with an episode as long as there are actions, and no early success."""
    layout = make_layout(gripper_action=True)
    return dataclasses.replace(layout, reward_region=(), episode_steps=len(actions))


@dataclasses.dataclass
class Commanded:
    """What a command path held after each look. Shapes (steps * LOOKS, n, ...)."""

    position_w: Array
    blockage: Array
    opening: Array
    waits: Array
    """Whether the line has ended in this step."""


class Record:
    """Takes the state of an integrator at each look."""

    def __init__(self) -> None:
        self.rows: list[tuple[Array, Array, Array]] = []
        self.waits: list[Array] = []

    def take(self, integrator: Any, line_end_w: Array) -> None:
        """`line_end_w`: where the line of this step went when it began. Shape (n, 3)."""
        self.rows.append(
            (integrator.position_w.copy(), integrator.blockage.copy(), integrator.opening.copy())
        )
        self.waits.append((integrator.position_w != line_end_w).any(axis=1))

    def result(self) -> Commanded:
        return Commanded(*(np.array(x) for x in zip(*self.rows, strict=True)), np.array(self.waits))


def trained(
    scene: ArmScene, hands: Array, actions: Array, stiffness: Array | None = None
) -> Commanded:
    """Drive the simulation's command path.

    Args:
        scene: Its kinematics.
        hands: At each look. Shape (steps * LOOKS, n, 3); the arms start at the first.
        actions: Shape (steps, n, 4).
        stiffness: Of a hand that is known to be softer than training's. Shape (3, 3).
    """
    layout, record = layout_of(actions), Record()
    path = CommandPath(layout, scene, hands.shape[1], stiffness=stiffness)
    path.start(hands[0], scene.start_positions(layout, hands[0])[:, scene.arm_qpos])
    for look, hand_w in enumerate(hands):
        step, part = divmod(look, LOOKS)
        if part == 0:
            path.move(actions[step], hand_w)
            line_end_w = path.position_w
        else:
            path.wait_for_hands(part * definition.WATCH_SUBSTEPS, hand_w)
        record.take(path.integrator, line_end_w)
    return record.result()


class RecordedArm:
    """A recording in the place of observer, stream and planner of one arm.

    The planner's command is a straight line to each target, and the arm is commanded to be on it
    at every instant. Joint angles stand for the hand's position.
    """

    def __init__(self, hands: Array) -> None:
        self.hands, self.look, self.record = hands, 0, Record()
        self.a = np.zeros((CYCLE_TICKS + 1, 7))
        self.integrator: Any = None
        self._begin_w = self._target_w = self._line_end_w = hands[0]
        self._begin_ns, self._duration_ns = 0, 1

    def state(self) -> ArmState:
        index = min(self.look, len(self.hands) - 1)
        return ArmState(self.look * CYCLE_NS, 0, self.hands[index], np.zeros(3), 0.0)

    # As observer.
    def check_scene(self) -> None:
        pass

    def begin_episode(self) -> None:
        pass

    def hand_position(self, state: ArmState) -> Array:
        return state.q

    def hand_of(self, q: Array) -> Array:
        return q

    def observation(self, state: ArmState, hand_w: Array, step: int) -> Array:
        return np.zeros(6)

    def next_state(self) -> ArmState:
        self.look += 1
        return self.state()

    # As stream.
    def begin(self, q: Array, stamp_ns: int) -> None:
        pass

    def due(self, stamp_ns: int, received_ns: int) -> list[int]:
        return [CYCLE_TICKS]

    def send(self, chunk: Any) -> None:
        pass

    def commanded(self, stamp_ns: int) -> Array:
        done = (stamp_ns - self._begin_ns) / self._duration_ns
        if done >= 1.0:
            return self._target_w
        return self._begin_w + done * (self._target_w - self._begin_w)

    # As planner.
    @property
    def command_position(self) -> Array:
        return self.commanded(self.look * CYCLE_NS)

    def reset(self, q: Array) -> None:
        pass

    def set_target(self, position_w: Array, duration_s: float) -> None:
        now_ns = self.look * CYCLE_NS
        self._begin_w, self._begin_ns = self.commanded(now_ns), now_ns
        self._target_w, self._duration_ns = position_w, round(duration_s * 1e9)
        if self.look % LOOKS == 0:
            self._line_end_w = position_w

    def hold(self, position_w: Array) -> None:
        self.set_target(position_w, CYCLE_NS / 1e9)

    def step(self, splice: int) -> Any:
        self.record.take(self.integrator, self._line_end_w[None])
        np.testing.assert_array_equal(self._target_w, self.integrator.position_w[0])
        return self

    held_back = None
    # It moves as it is commanded, at once.
    lead_s = 0.0
    hand_bounds = SimpleNamespace(stopping_s=0.0)


def deployed(
    hands: Array, actions: Array, stiffness: Array | None = None
) -> tuple[Commanded, Array]:
    """Drive a deployed episode of one arm.

    Args:
        hands: Shape (steps * LOOKS, 3).
        actions: Shape (steps, 4).
        stiffness: As in `trained`.

    Returns:
        What was commanded, n = 1, and the openings that were published. Shape (steps,).
    """
    layout, arm, openings = layout_of(actions), RecordedArm(hands), list[float]()

    class Policy:
        def __init__(self) -> None:
            self.layout = layout

        def reset(self) -> None:
            self.left = list(actions)

        def act(self, observation: Array) -> Array:
            return self.left.pop(0)

    robot = SimpleNamespace(
        open_gripper=lambda opening, stamp_ns: openings.append(opening),
        check=lambda late_is_final: None,
        delay=ArmDelay(),
    )
    topics = SimpleNamespace(publish=lambda stamp_ns, observation, action=None: None)
    parts, times = cast(Any, arm), CycleTimes()
    motion = PolicyMotion(
        Policy(), parts, parts, parts, cast(Any, robot), cast(Any, topics), times, LOOKS, stiffness
    )
    status, end = cast(Any, SimpleNamespace(clock_ns=0)), threading.Event()
    loop = ControlLoop(cast(Any, robot), parts, parts, times, status, end, lock_step=True)
    arm.integrator = motion.commander.integrator
    loop.run(motion, hands[0], arm.state())
    assert motion.steps == len(actions)
    return arm.record.result(), np.array(openings)


def assert_equal(
    hands: Array, actions: Array, scene: ArmScene, stiffness: Array | None = None
) -> Commanded:
    """Compare training's batch with one deployment per arm; gives what was commanded."""
    ours = trained(scene, hands, actions, stiffness)
    for row in range(hands.shape[1]):
        theirs, openings = deployed(hands[:, row], actions[:, row], stiffness)
        for field in dataclasses.fields(Commanded):
            expected, got = getattr(ours, field.name)[:, row], getattr(theirs, field.name)[:, 0]
            # A product with the stiffness is rounded otherwise for one arm than for two.
            atol = 0.0 if stiffness is None else 1e-12
            np.testing.assert_allclose(got, expected, 0.0, atol, err_msg=field.name)
        np.testing.assert_array_equal(openings, ours.opening[::LOOKS, row])
    return ours


@pytest.fixture(scope="module")
def scene() -> ArmScene:
    return ArmScene(ARM)


steps, arms = 5, 2
pushes = hnp.arrays(np.float64, (steps, arms, 4), elements=st.floats(-1.5, 1.5))


@settings(deadline=None, max_examples=25)
@given(pushes, st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.booleans())
def test_any_hands_are_commanded_the_same_in_training_and_deployed(
    scene: ArmScene, push: Array, seed: int, rest: float, soft: bool
) -> None:
    """Hands that wander about the box, and rest now and then for some looks or for good."""
    workspace = make_layout().workspace
    assert workspace is not None
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-0.005, 0.005, (steps * LOOKS, arms, 3))
    rests = rng.random((steps * LOOKS, arms, 1)) < rest
    walk = np.array(workspace.start) + np.cumsum(np.where(rests, 0.0, moves), axis=0)
    stiffness = (root := rng.uniform(-0.6, 0.6, (3, 3))) @ root.T if soft else None
    assert_equal(np.clip(walk, workspace.low, workspace.high), push, scene, stiffness)


def test_a_hand_that_met_the_lid_in_training_is_commanded_the_same_deployed(
    scene: ArmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hands of a simulation in which arms run onto the lid, lean on it and come back."""
    steps, hands = 30, list[Array]()
    move, wait = CommandPath.move, CommandPath.wait_for_hands

    def recorded_move(self: CommandPath, action: Array, hand_w: Array) -> None:
        hands.append(hand_w.copy())
        move(self, action, hand_w)

    def recorded_wait(self: CommandPath, substep: int, hand_w: Array) -> Any:
        hands.append(hand_w.copy())
        return wait(self, substep, hand_w)

    monkeypatch.setattr(CommandPath, "move", recorded_move)
    monkeypatch.setattr(CommandPath, "wait_for_hands", recorded_wait)
    env = ArmBatch(ARM, 3, num_threads=1, seed=1, gripper_action=True)
    env.reset()
    actions = np.zeros((steps, 3, 4))
    actions[:5, :, 1] = 1.0
    actions[5:, :, 2] = -1.0
    actions[12:14, 1, 2] = 1.0
    actions[:, 2] = np.random.default_rng(2).uniform(-1.0, 1.0, (steps, 4)) + actions[:, 2]
    in_training = []
    for action in actions:
        env.step(action)
        in_training.append(env.command()[0])
    monkeypatch.undo()
    commanded = assert_equal(np.array(hands), actions, scene)
    assert commanded.waits.any(axis=0)[:2].all()
    assert commanded.blockage.max() > 0.45
    # What was replayed is what the simulation did, but for the starts, which have a rounding error.
    np.testing.assert_allclose(
        commanded.position_w[LOOKS - 1 :: LOOKS], np.array(in_training), atol=1e-6
    )
