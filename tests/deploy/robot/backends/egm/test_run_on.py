"""The bound on running on, against the emulated control law: no history of references beats it.

The bound is worked out from the law's impulse response; here the law itself is run, cycle by
cycle, and falls silent.
"""

from __future__ import annotations

from math import ceil, degrees, radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.packets import ReferencePacket
from skewmi.deploy.robot.backends.egm.program import ProgramSettings
from skewmi.deploy.robot.backends.egm.run_on import CYCLE_S
from skewmi.deploy.robot.egm_emulator.control_law import ControlLaw
from skewmi.robot_models import yumi
from skewmi.robot_models.kinematics import ArmKinematics
from skewmi.trajectory import Array

UNBOUNDED = {"max_speed_deviation_deg_s": 1e6, "max_position_deviation_deg": 1e6}
SETTLED = 300
"""Cycles after which a motion is steady, but for small gains."""
ROUNDING = 1e-9
SPEED = 0.2
"""rad/s: so slow that no joint has to be slowed down, whatever it is told."""

PROGRAMS = {
    "rapid": ProgramSettings(**UNBOUNDED),  # type: ignore[arg-type]
    "abb": ProgramSettings(gain=5.0, comm_timeout_s=1.0, ramp_out_s=0.5, **UNBOUNDED),  # type: ignore[arg-type]
    # Its low-pass is so slow that it swings.
    "swings": ProgramSettings(gain=20.0, low_pass_hz=1.0, comm_timeout_s=0.3, **UNBOUNDED),  # type: ignore[arg-type]
    "no gain": ProgramSettings(gain=0.0, comm_timeout_s=0.2, **UNBOUNDED),  # type: ignore[arg-type]
}


def silence(
    program: ProgramSettings, speeds: Array, feed_forward: float
) -> tuple[Array, Array, Array]:
    """Follow references, and then none.

    Args:
        program: Of the controller.
        speeds: Of the references, rad/s, from rest. Shape (n, 7).
        feed_forward: Fraction of them that is sent.

    Returns:
        Desired positions from the moment on at which the last reference was read, rad, shape
        (m, 7); the last reference, rad, shape (7,).
    """
    law = ControlLaw(program, np.zeros(7), CYCLE_S, 0.0)
    q = np.zeros(7)
    for number in range(ceil(program.ramp_in_s / CYCLE_S)):
        law.step(ReferencePacket(number, 0, q, np.zeros(7)))
    for number, v in enumerate(speeds):
        q = q + v * CYCLE_S
        before = law.desired.copy()
        law.step(ReferencePacket(number, 0, q, feed_forward * v))
    path = [before, law.desired.copy()]
    # Silence is counted in cycles; that in which it is noticed is followed, too.
    for _ in range(ceil(program.comm_timeout_s / CYCLE_S - 1e-9)):
        law.step(None)
        path.append(law.desired.copy())
    while law.speed.any():
        law.brake()
        path.append(law.desired.copy())
    return np.array(path), q


def beyond(path: Array, last: Array) -> float:
    """How far a joint leaves the way between where it was and its last reference, rad."""
    low, high = np.minimum(path[0], last), np.maximum(path[0], last)
    return float(np.maximum(low - path, path - high).max())


@st.composite
def histories(draw: st.DrawFn) -> Array:
    """Speeds of at most `SPEED`, other ones for each joint: pieces that are steady, that swing, or
    that jump about. Shape (n, 7)."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pieces = []
    for _ in range(draw(st.integers(1, 4))):
        count = draw(st.integers(1, 80))
        columns = (
            np.tile(rng.choice([-1.0, 0.0, 1.0, rng.uniform(-1, 1)], 7), (count, 1)),
            np.sin(rng.uniform(0.01, 3.0, 7) * np.arange(count)[:, None]),
            rng.uniform(-1.0, 1.0, (count, 7)),
            np.sign(rng.uniform(-1.0, 1.0, (count, 7))),
        )
        pieces.append(np.choose(rng.integers(len(columns), size=7), columns))
    return SPEED * np.concatenate(pieces)


@st.composite
def programs(draw: st.DrawFn) -> ProgramSettings:
    return ProgramSettings(
        gain=draw(st.floats(0.1, 20.0) | st.sampled_from((0.0, 1.0, 5.0, 20.0))),
        low_pass_hz=draw(st.floats(0.5, 100.0) | st.just(20.0)),
        comm_timeout_s=draw(st.floats(0.02, 1.5) | st.just(0.1)),
        ramp_out_s=draw(st.floats(0.005, 1.0) | st.just(0.1)),
        **UNBOUNDED,  # type: ignore[arg-type]
    )


@settings(deadline=None, max_examples=20)
@given(programs(), st.just(1.0) | st.floats(0.0, 1.0), histories())
def test_no_history_of_references_beats_the_bound(
    program: ProgramSettings, feed_forward: float, speeds: Array
) -> None:
    path, last = silence(program, speeds, feed_forward)
    fastest = float(np.abs(speeds).max())
    assert beyond(path, last) <= fastest * program.runs_on_s(feed_forward) + ROUNDING


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("feed_forward", [0.0, 0.5, 1.0])
def test_no_switching_beats_the_bound(name: str, feed_forward: float) -> None:
    """Full speed one way or the other, switched once at any time before the silence, or twice."""
    program = PROGRAMS[name]
    bound = program.runs_on_s(feed_forward)
    switched = []
    for first in (1, 3, 6, 10, 20, 60, 150):
        for second in (0, 1, 4, 12):
            speeds = np.ones(SETTLED)
            speeds[-first - second :] = -1.0
            if second:
                speeds[-second:] = 1.0
            switched.append(SPEED * speeds)
    for seven in np.array(switched).reshape(-1, 7, SETTLED):
        path, last = silence(program, seven.T, feed_forward)
        assert beyond(path, last) <= SPEED * bound + ROUNDING


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_bound_is_that_of_a_steady_motion_or_little_more(name: str) -> None:
    """A bound that is far from what happens would admit too little speed."""
    program = PROGRAMS[name]
    path, last = silence(program, np.full((SETTLED, 7), SPEED), 1.0)
    slack = 2.2 if name == "swings" else 1.25
    assert SPEED * program.runs_on_s(1.0) <= slack * beyond(path, last)


@pytest.mark.parametrize("name", PROGRAMS)
def test_less_feed_forward_runs_on_less(name: str) -> None:
    bounds = [PROGRAMS[name].runs_on_s(share) for share in (0.0, 0.3, 0.6, 1.0)]
    assert bounds == sorted(bounds)


@pytest.mark.parametrize(("speed_deg", "beyond_deg"), [(10, 1.99), (28, 5.57), (60, 11.94)])
def test_abbs_usual_values_run_on_by_speed_over_gain(speed_deg: float, beyond_deg: float) -> None:
    # Figures of an independent model of the same law: k = 5, CommTimeout 1 s.
    program = ProgramSettings(gain=5.0, comm_timeout_s=1.0)
    path, last = silence(program, np.full((SETTLED, 7), radians(speed_deg)), 1.0)
    assert degrees(beyond(path, last)) == pytest.approx(beyond_deg, abs=0.03)
    bound = degrees(radians(speed_deg) * program.runs_on_s(1.0))
    assert beyond_deg <= bound <= 1.1 * beyond_deg


def test_no_gain_runs_on_at_full_speed() -> None:
    program = ProgramSettings(gain=0.0, comm_timeout_s=0.5, ramp_out_s=0.1)
    assert program.runs_on_s(1.0) == pytest.approx(0.55 + CYCLE_S, abs=2 * CYCLE_S)


def test_without_feed_forward_a_steady_motion_ends_at_its_last_reference() -> None:
    program = ProgramSettings(gain=5.0)
    path, last = silence(program, np.full((SETTLED, 7), 0.5), 0.0)
    assert beyond(path, last) <= 1e-6


@settings(deadline=None, max_examples=6)
@given(st.integers(0, 2**32 - 1), st.sampled_from(("rapid", "abb")), st.floats(0.0, 1.0))
def test_the_flange_runs_on_no_farther_than_is_allowed(
    seed: int, name: str, feed_forward: float
) -> None:
    """At the admitted speed of the flange, wherever the arm is and whichever way it goes."""
    options = EgmOptions(program=PROGRAMS[name], feed_forward=feed_forward)
    rng = np.random.default_rng(seed)
    kinematics = ArmKinematics("right")
    room = 0.4 * (yumi.POSITION_UPPER - yumi.POSITION_LOWER)
    middle = 0.5 * (yumi.POSITION_UPPER + yumi.POSITION_LOWER)
    q = middle + rng.uniform(-1, 1, 7) * room
    # A direction that goes over into another one.
    ways = rng.standard_normal((2, 7))
    share = np.clip((np.arange(SETTLED) - rng.integers(SETTLED)) / 60.0, 0.0, 1.0)
    speeds = np.empty((SETTLED, 7))
    at = q.copy()
    for number in range(SETTLED):
        way = ways[0] + share[number] * (ways[1] - ways[0])
        flange = float(np.linalg.norm(kinematics.jacobian(at)[:3] @ way))
        v = way * min(options.admitted_speed / flange, 0.5 / np.abs(way).max())
        speeds[number], at = v, at + v * CYCLE_S
    path, last = silence(options.program, speeds, feed_forward)
    points = kinematics.forward(q + np.vstack([last, path[[0, -1]]]))[0]
    told, was, end = points
    if feed_forward == 1.0:
        assert np.linalg.norm(end - told) <= options.run_on_limit + CYCLE_S * 0.5
    along = np.clip((end - told) @ (was - told) / max(((was - told) ** 2).sum(), 1e-12), 0.0, 1.0)
    nearest = told + along * (was - told)
    assert np.linalg.norm(end - nearest) <= options.run_on_limit
