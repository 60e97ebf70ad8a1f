"""The planner's parts against closed forms, libraries and each other; corners; resumed fuzzing."""

import json
from dataclasses import replace
from pathlib import Path

import mink
import numpy as np
import planner_fuzz
import planner_path
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planner_fuzz_round import run_round
from planner_judge import Breach, Judge, UrdfArm

from skewmi.deploy.motion.brake import (
    ApproachSpeed,
    approach_speed_of,
    plan_stop,
    stop_extent_of,
)
from skewmi.deploy.motion.differential_ik import (
    FEEDBACK_RATE,
    ORIENTATION_COST,
    POSITION_COST,
    POSTURE_COST,
    POSTURE_RATE,
    DifferentialIk,
    _arm_model,
)
from skewmi.deploy.motion.faces import Faces
from skewmi.deploy.motion.hand_bounds import HandBounds
from skewmi.deploy.motion.planner import Planner
from skewmi.robot_models import frames, limits, yumi
from skewmi.robot_models.kinematics import ArmKinematics

START = np.array(yumi.TABLE_CONFIGURATION)
NUMBER = st.floats(-1.0, 1.0)


@settings(max_examples=300, deadline=None)
@given(
    q=NUMBER,
    v=NUMBER,
    a_share=NUMBER,
    acceleration=st.floats(0.01, 20.0),
    steepness=st.floats(2.0, 200.0),
)
def test_scalar_stop_agrees_with_the_batched_one(
    q: float, v: float, a_share: float, acceleration: float, steepness: float
) -> None:
    jerk, a = steepness * acceleration, a_share * acceleration
    batched = plan_stop(*(np.array([x]) for x in (q, v, a, acceleration, jerk))).extent()
    single = stop_extent_of(q, v, a, acceleration, jerk)
    np.testing.assert_allclose(single, np.ravel(batched), rtol=1e-9, atol=1e-12)
    speed = ApproachSpeed(np.array([acceleration]), np.array([jerk]))(np.array([q]))
    assert approach_speed_of(q, acceleration, jerk) == pytest.approx(float(speed[0]), abs=1e-12)


class _HandVelocity(mink.Limit):
    """Bounds on the hand's velocity in six directions, with Pinocchio's Jacobian."""

    def __init__(self, most: np.ndarray) -> None:
        self._most = most
        self._kinematics = ArmKinematics("right")

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        rows = self._kinematics.jacobian(configuration.q)[:3]
        bounded = np.isfinite(self._most)
        return mink.Constraint(np.concatenate((-rows, rows))[bounded], dt * self._most[bounded])


@pytest.mark.parametrize("beyond_faces", [False, True])
def test_inverse_kinematics_solves_minks_program(beyond_faces: bool) -> None:
    """Put together here or by mink, with bounds that bind: the same velocities."""
    rng = np.random.default_rng(0)
    model, dt = _arm_model(), 0.004
    ik = DifferentialIk(START, frames.HAND_DOWN)
    hand = mink.FrameTask(
        yumi.tool_name("right"),
        "site",
        position_cost=POSITION_COST,
        orientation_cost=ORIENTATION_COST,
        gain=FEEDBACK_RATE * dt,
    )
    posture = mink.PostureTask(model, cost=POSTURE_COST, gain=POSTURE_RATE * dt)
    posture.set_target(START)
    rotation = mink.SO3.from_matrix(frames.HAND_DOWN)
    binding = kept_in = 0
    for _ in range(50):
        q = START + rng.uniform(-0.1, 0.1, 7)
        bound = rng.uniform(0.05, 0.5, 7)
        # Less than 1 mm away: further away the hand gives way to the posture.
        position = ik.place(q) + rng.uniform(-5e-4, 5e-4, 3)
        velocity = rng.uniform(-0.2, 0.2, 3)
        most = np.full(6, np.inf)
        if beyond_faces:
            # The face that the hand would pass, at first its only one, with a way back or none.
            axis = int(np.argmax(np.abs(velocity)))
            most[axis + 3 * (velocity[axis] > 0.0)] = rng.uniform(-0.005, 0.02)
        outwards = most if beyond_faces else None
        found = ik.solve(position, velocity, -bound, bound, outwards=outwards)
        assert found is not None
        target = mink.SE3.from_rotation_and_translation(rotation, position + velocity / 5.0)
        hand.set_target(target)
        speeds = dict(zip(yumi.joint_names("right"), bound.tolist(), strict=True))
        expected = mink.solve_ik(
            mink.Configuration(model, q),
            (hand, posture),
            dt,
            "daqp",
            damping=0.0,
            limits=[mink.VelocityLimit(model, speeds), _HandVelocity(most)],
        )
        np.testing.assert_allclose(found, expected, atol=2e-3)
        binding += int((np.abs(found) > 0.999 * bound).any())
        kept = ArmKinematics("right").jacobian(q)[:3] @ found
        kept_in += int((np.concatenate((-kept, kept)) > most - 1e-4).any())
    assert binding > 10
    assert kept_in > 30 or not beyond_faces


def test_no_way_back_inwards_is_no_reason_to_go_on_outwards() -> None:
    """Joints that may not move at all cannot bring the hand back: rest, not a failure."""
    ik = DifferentialIk(START, frames.HAND_DOWN)
    position = ik.place(START)
    outwards = np.full(6, np.inf)
    outwards[3] = -0.01
    none = np.zeros(7)
    found = ik.solve(position, np.array([0.1, 0.0, 0.0]), none, none, outwards=outwards)
    assert found is not None
    np.testing.assert_allclose(found, 0.0, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_hand_beyond_a_face_may_go_as_far_as_it_can_stop(data: st.DataObject) -> None:
    """From the highest admitted velocity the fastest stop ends inside the tolerance."""
    tolerance = data.draw(st.floats(1e-4, 0.02))
    bounds = HandBounds(0.2, data.draw(st.floats(0.05, 5.0)), data.draw(st.floats(1.0, 100.0)))
    low, high = np.array([-0.1, -0.2, 0.1]), np.array([0.1, 0.3, 0.4])
    share = np.array(data.draw(st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3)))
    position = (low + high) / 2.0 + share * (high - low) / 2.0
    outwards = Faces(low, high, tolerance, bounds).outwards(position)
    beyond = np.array([*(low - position), *(position - high)])
    if outwards is None:
        assert (beyond < 0.5 * tolerance).all()
        return
    for k in range(6):
        if np.isinf(outwards[k]):
            assert beyond[k] < 0.5 * tolerance
        elif outwards[k] > 0.0:
            _, furthest = stop_extent_of(
                float(beyond[k]), float(outwards[k]), 0.0, bounds.acceleration, bounds.jerk
            )
            assert furthest < tolerance
        else:
            assert beyond[k] > 0.9 * tolerance


@pytest.mark.parametrize(("profile", "speed"), [("lab", 0.15), ("careful", 0.04)])
def test_corners_are_cut_by_no_more_than_the_limits_ask_for(profile: str, speed: float) -> None:
    """An eighth of the way that is made while the velocity turns."""
    workspace = planner_path.wide_workspace()
    middle = (np.array(workspace.low) + np.array(workspace.high)) / 2.0
    x, y, z = 0.03 * np.eye(3)
    for first, second in ((z, y), (x, y)):
        corner = middle + first - second
        vertices = np.stack([corner - 2 * first, corner, corner + 2 * second])
        found = planner_path.path_quality(UrdfArm(), workspace, vertices, profile, speed)
        bounds = Planner(workspace, limits.profile(profile)).hand_bounds
        turning = speed / bounds.acceleration + bounds.acceleration / bounds.jerk
        assert found["lateral_mm"] < 1e3 * speed * turning / 8.0 + 0.3
        assert found["tilt_deg"] < 0.2
        # The smoothed command turns a little sooner than the bounds of the hand allow.
        assert found["overshoot_mm"] < 2.0


def test_slow_limits_do_not_make_the_hand_swing() -> None:
    """Feedback that is faster than the limits let the arm answer swings around every target."""
    lab = limits.profile("lab")
    slow = replace(lab, acceleration=np.full(7, 0.5), jerk=np.full(7, 4.0))
    workspace = planner_path.press_workspace(START)
    planner = Planner(workspace, slow)
    planner.reset(START)
    start = np.array(workspace.start)
    planner.set_target(start + np.array([0.0, 0.05, 0.0]), 0.4)
    q = np.stack([planner.step().q[0] for _ in range(500)])
    along = planner.forward(q)[0][:, 1] - start[1]
    assert along.max() < 0.0525
    assert np.abs(along[-50:] - 0.05).max() < 1e-3


def test_an_arm_that_is_caught_gives_way_to_its_posture() -> None:
    """Near a singular posture with a joint at its bound the hand once swung around its target."""
    result = run_round(280)
    assert result["breach"] is None
    assert result["scene"] == "singular careful"
    assert result["return_mm"] < 1.0


def test_an_arm_that_rests_beside_a_bound_finds_a_slower_way_out() -> None:
    """The same attempt was refused for ever: a joint beside its bound wanted to be too fast."""
    result = run_round(3795)
    assert result["breach"] is None
    assert result["scene"] == "tight lab"
    assert result["return_mm"] < 1.0


def test_fuzzing_goes_on_from_finished_rounds(tmp_path: Path) -> None:
    file = tmp_path / "rounds.jsonl"
    log = planner_fuzz.RoundLog(file, seed=7)
    first = planner_fuzz.fuzz(1, 7, log=log)
    assert first.rounds == 1
    with file.open("a", encoding="utf-8") as stream:
        stream.write('{"seed": 8, "cyc')  # killed while writing
    resumed = planner_fuzz.RoundLog(file, seed=7)
    assert [result["seed"] for result in resumed.done] == [7]
    assert planner_fuzz.fuzz(1, 7, log=resumed).figures() == first.figures()
    assert len(file.read_text(encoding="utf-8").splitlines()) == 2
    header = json.loads(file.read_text(encoding="utf-8").splitlines()[0])
    assert header["sources"] == planner_fuzz.fingerprint()
    with pytest.raises(SystemExit, match="this run is"):
        planner_fuzz.RoundLog(file, seed=8)


@pytest.mark.parametrize("broken", ["jerk", "start", "rest", "box"])
def test_the_judge_sees_what_is_broken(broken: str) -> None:
    """The checks behind the fuzzing fail where they should: each on a chunk spoilt in one way."""
    workspace, bounds = planner_path.press_workspace(START), limits.profile("lab")
    planner = Planner(workspace, bounds)
    planner.reset(START)
    planner.set_target(np.array(workspace.start) + np.array([0.0, 0.05, 0.0]), 0.4)
    for _ in range(10):
        chunk = planner.step()
    q, v, a = chunk.q.copy(), chunk.v.copy(), chunk.a.copy()
    state = tuple(part[0].copy() for part in (q, v, a))
    judge = Judge(bounds, workspace, UrdfArm())
    judge.add((q, v, a), state)
    judge.settle()
    if broken == "jerk":
        q[3] += 1e-4
    elif broken == "start":
        state = state[0] + 1e-9, *state[1:]
    elif broken == "rest":
        v[-1] += 1e-6
    else:
        # The whole motion, moved out of the box by turning the base joint.
        q[:, 0] += 1.0
        state = q[0].copy(), *state[1:]
    judge.add((q, v, a), state)
    with pytest.raises(Breach):
        judge.settle()
