"""What the robot server refuses: dense around every rule, starting from a chunk that it accepts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot.executor import PlanExecutor
from skewmi.deploy.safety.checks import limit_check
from skewmi.deploy.safety.validation import (
    BrokenStreamError,
    ChunkValidator,
    ValidationRules,
)
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.sim.tasks.open_press_close.definition import make_layout
from skewmi.trajectory import GRID_NS, JointTrajectory, TrajectoryChunk

LAB = joint_limits.profile("lab")
NAMES = yumi.joint_names("right")
WORKSPACE = make_layout().workspace
assert WORKSPACE is not None
START = np.array(WORKSPACE.start_configuration)
RULES = ValidationRules(joint_names=NAMES, grid_ns=GRID_NS)
VALIDATOR = ChunkValidator(RULES, limit_check(LAB, WORKSPACE))
NOW = 100
LATER = NOW + 10
NOW_NS = NOW * GRID_NS


def small_motion() -> JointTrajectory:
    """A few millimetres of hand travel, inside every limit."""
    step = np.array([0.02, -0.01, 0.0, 0.01, 0.0, 0.02, 0.0])
    return StartMotion(START, START + step, LAB).trajectory


def chunk_of(samples: JointTrajectory, tick: int = LATER) -> TrajectoryChunk:
    return TrajectoryChunk.of(tick * GRID_NS, NAMES, samples)


def good_chunk(tick: int = LATER) -> TrajectoryChunk:
    return chunk_of(small_motion(), tick)


def resting_plan() -> PlanExecutor:
    return PlanExecutor(START, NOW_NS)


def changed(field: str, row: int, column: int, by: float) -> TrajectoryChunk:
    chunk = good_chunk()
    values = getattr(chunk.trajectory, field).copy()
    values[row, column] += by
    return replace(chunk, trajectory=replace(chunk.trajectory, **{field: values}))


def test_the_chunk_that_all_tests_start_from_is_accepted() -> None:
    VALIDATOR.check(good_chunk(), resting_plan(), NOW_NS)


@pytest.mark.parametrize("tick", [NOW, NOW + 1, NOW + 125])
def test_stamps_from_now_to_half_a_second_ahead_are_accepted(tick: int) -> None:
    VALIDATOR.check(good_chunk(tick), resting_plan(), NOW_NS)


@pytest.mark.parametrize("tick", [NOW - 1, NOW - 1000])
def test_stamps_in_the_past_are_refused_as_out_of_step(tick: int) -> None:
    with pytest.raises(BrokenStreamError, match="in the past"):
        VALIDATOR.check(good_chunk(tick), resting_plan(), NOW_NS)


@pytest.mark.parametrize("tick", [NOW + 126, NOW + 10**9])
def test_stamps_too_far_ahead_are_refused(tick: int) -> None:
    with pytest.raises(CommandRefusedError, match="ahead"):
        VALIDATOR.check(good_chunk(tick), resting_plan(), NOW_NS)


@pytest.mark.parametrize("off_ns", [1, -1, GRID_NS // 2])
def test_stamps_beside_the_grid_are_refused(off_ns: int) -> None:
    chunk = replace(good_chunk(), stamp_ns=LATER * GRID_NS + off_ns)
    with pytest.raises(CommandRefusedError, match="multiple of the grid"):
        VALIDATOR.check(chunk, resting_plan(), NOW_NS)


@pytest.mark.parametrize(
    "names",
    [
        tuple(sorted(NAMES)),  # 1, 2, 3, ... instead of chain order 1, 2, 7, 3, ...
        NAMES[::-1],
        yumi.joint_names("left"),
        NAMES[:6],
        (*NAMES, "gripper_r_joint"),
        (),
    ],
)
def test_other_names_or_another_order_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(CommandRefusedError, match="in this order"):
        VALIDATOR.check(replace(good_chunk(), joint_names=names), resting_plan(), NOW_NS)


@settings(deadline=None)
@given(
    field=st.sampled_from(["q", "v", "a"]),
    value=st.sampled_from([np.nan, np.inf, -np.inf]),
    row=st.integers(0, len(small_motion().q) - 1),
    column=st.integers(0, 6),
)
def test_any_value_that_is_not_finite_is_refused(
    field: str, value: float, row: int, column: int
) -> None:
    with pytest.raises(CommandRefusedError, match="finite"):
        VALIDATOR.check(changed(field, row, column, value), resting_plan(), NOW_NS)


def test_samples_of_other_shapes_are_refused() -> None:
    q = small_motion().q
    for wrong in (q[:-1], q[:, :6], q[:0]):
        samples = JointTrajectory(wrong, 0 * wrong, 0 * wrong)
        with pytest.raises(CommandRefusedError, match="shape"):
            VALIDATOR.check(replace(good_chunk(), trajectory=samples), resting_plan(), NOW_NS)


def test_chunks_of_one_point_or_of_thousands_are_refused() -> None:
    for count in (1, 501):
        chunk = chunk_of(JointTrajectory.resting(START, count))
        with pytest.raises(CommandRefusedError, match="points"):
            VALIDATOR.check(chunk, resting_plan(), NOW_NS)


@settings(deadline=None)
@given(row=st.integers(0, len(small_motion().q) - 1), off=st.sampled_from([-1, 1, GRID_NS]))
def test_times_beside_the_grid_are_refused(row: int, off: int) -> None:
    times = good_chunk().time_from_start_ns.copy()
    times[row] += off
    with pytest.raises(CommandRefusedError, match="points must lie at"):
        VALIDATOR.check(replace(good_chunk(), time_from_start_ns=times), resting_plan(), NOW_NS)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("step", [1.1e-9, 5e-9, 1.1e-6, -1e-3, 0.1])
def test_a_chunk_that_does_not_start_on_the_plan_is_refused(joint: int, step: float) -> None:
    plan = PlanExecutor(START + step * np.eye(7)[joint], NOW_NS)
    with pytest.raises(BrokenStreamError, match=f"splice: position of {NAMES[joint]}"):
        VALIDATOR.check(good_chunk(), plan, NOW_NS)


def test_a_chunk_splices_with_a_moving_plan_only_where_it_belongs() -> None:
    motion = small_motion()
    plan = resting_plan()
    plan.splice(LATER * GRID_NS, motion, NOW_NS)
    for tick in range(NOW, LATER + len(motion)):
        chunk = chunk_of(motion.part(slice(7, None)), tick)
        if tick == LATER + 7:
            VALIDATOR.check(chunk, plan, NOW_NS)
        else:
            with pytest.raises(BrokenStreamError, match="splice"):
                VALIDATOR.check(chunk, plan, NOW_NS)


@pytest.mark.parametrize("rows", range(3, 21, 3))
def test_a_chunk_that_ends_while_moving_is_refused(rows: int) -> None:
    motion = small_motion()
    assert rows < len(motion) - 2
    with pytest.raises(CommandRefusedError, match="end at rest"):
        VALIDATOR.check(chunk_of(motion.part(slice(0, rows))), resting_plan(), NOW_NS)


def test_a_chunk_beyond_the_limits_is_refused_by_the_independent_checker() -> None:
    # The same path in three quarters of the time: velocity, acceleration and jerk rise.
    fast = joint_limits.JointLimits(
        name="fast",
        position_lower=LAB.position_lower,
        position_upper=LAB.position_upper,
        velocity=LAB.velocity,
        acceleration=1.1 * LAB.acceleration,
        jerk=1.1 * LAB.jerk,
        torque=LAB.torque,
    )
    chunk = chunk_of(StartMotion(START, START + 0.05, fast).trajectory)
    with pytest.raises(CommandRefusedError, match=r"acceleration|jerk"):
        VALIDATOR.check(chunk, resting_plan(), NOW_NS)


def test_a_motion_out_of_the_box_is_refused() -> None:
    out = StartMotion(START, START + 0.1 * (np.array(yumi.HOME["right"]) - START), LAB)
    with pytest.raises(CommandRefusedError, match="outside the workspace") as caught:
        VALIDATOR.check(chunk_of(out.trajectory), resting_plan(), NOW_NS)
    assert caught.value.args == (str(caught.value),), "the reason is text, as it goes over the wire"


def test_positions_that_jump_behind_harmless_velocities_are_refused() -> None:
    with pytest.raises(CommandRefusedError):
        VALIDATOR.check(changed("q", 20, 3, 1e-3), resting_plan(), NOW_NS)


def test_workspaces_that_can_be_granted_are_named() -> None:
    assert VALIDATOR.workspaces == ("task",)
    check = limit_check(LAB, None)
    others = {"calibration": check, "elsewhere": check}
    assert ChunkValidator(RULES, check, others).workspaces == (
        "task",
        "calibration",
        "elsewhere",
    )
