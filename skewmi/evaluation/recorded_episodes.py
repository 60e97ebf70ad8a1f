"""Episodes of a recorded deployment, control step by control step: what was seen, done and reached.

A step is an observation of the policy and the action that answered it. The observation that
decided an episode's outcome has no action; it is what the last action led to.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.recording.believed import believed_part
from skewmi.deploy.recording.reader import Recording, read_recording
from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SessionState
from skewmi.deploy.wire import topics
from skewmi.errors import ConfigurationError
from skewmi.evaluation.film import RecordedJoints, joint_series, recorded_layout, running_stamps
from skewmi.policy_io import Array, PolicyLayout
from skewmi.success import inside_region

Stamps = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """The steps of one episode; n of them.

    Attributes:
        source: The recording.
        number: Of the episode in it, from 1.
        outcome: Of the session: `success`, `time over`, `stopping`, `fault`; empty if the recording
            ends before.
        stamps_ns: Of the steps, in the robot server's clock, rising. Shape (n,).
        observation: What the policy saw, in the fields' units. Shape (n, observation_dim).
        action: What it answered, in [-1, 1]. Shape (n, action_dim).
        joint_positions: Measured, rad, m for the finger. Shape (n, joints).
        reward: 1 where the step led into the reward region, else 0. Shape (n,).
    """

    source: Path
    number: int
    outcome: str
    stamps_ns: Stamps
    observation: Array
    action: Array
    joint_positions: Array
    reward: Array

    @property
    def success(self) -> bool:
        """Whether the task was solved."""
        return self.outcome == SessionState.SUCCESS.value


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """What one recording has of them.

    Attributes:
        recording: As the session believed it.
        layout: Of its policy.
        joint_names: Of `RecordedEpisode.joint_positions`.
        step_s: Time of a control step, s.
        episodes: Those that are whole.
        notes: What was left out, and why.
    """

    recording: Recording
    layout: PolicyLayout
    joint_names: tuple[str, ...]
    step_s: float
    episodes: tuple[RecordedEpisode, ...]
    notes: tuple[str, ...]


def read_run(path: Path) -> RecordedRun:
    """The episodes of a recording of `skewmi deploy --record`.

    Raises:
        ConfigurationError: It is no such recording, or has no step.
    """
    believed = believed_part(read_recording(path))
    recording, notes = believed.recording, list(believed.notes)
    layout = recorded_layout(recording)
    observed = joint_series(recording, topics.POLICY_OBSERVATION)
    acted = joint_series(recording, topics.POLICY_ACTION)
    joints = joint_series(recording, topics.YUMI_JOINT_STATES)
    lost = _lost_after(recording)
    episodes = []
    for number, (first, after, outcome) in enumerate(_spans(recording), start=1):
        if any(first <= stamp < after for stamp in lost):
            notes.append(f"{path.name}: episode {number} is left out, its recording has gaps")
            continue
        episode = _episode(layout, observed, acted, joints, first, after)
        if episode is None:
            notes.append(f"{path.name}: episode {number} is left out, the policy did not act in it")
            continue
        episodes.append(RecordedEpisode(path, number, outcome, *episode))
    if not episodes:
        raise ConfigurationError(f"{path} has no episode with a step of a policy")
    steps = np.concatenate([np.diff(episode.stamps_ns) for episode in episodes])
    step_s = float(np.median(steps)) / 1e9 if len(steps) else layout.control_dt
    return RecordedRun(recording, layout, joints.names, step_s, tuple(episodes), tuple(notes))


def _spans(recording: Recording) -> Iterator[tuple[int, int, str]]:
    """From where to where (excluded) each episode's policy acts, ns, and how it went."""
    starts = [*running_stamps(recording).tolist(), np.iinfo(np.int64).max]
    ends = [
        (news.stamp_ns, news.state.value)
        for message in recording.messages.get(topics.YUMI_STATUS.name, ())
        if (news := SessionNews.decode(message.payload)) is not None
        and news.source is SessionState.RUNNING
    ]
    for first, after in pairwise(starts):
        outcome = next((state for stamp, state in ends if first <= stamp < after), "")
        yield first, after, outcome


def _episode(
    layout: PolicyLayout,
    observed: RecordedJoints,
    acted: RecordedJoints,
    joints: RecordedJoints,
    first: int,
    after: int,
) -> tuple[Stamps, Array, Array, Array, Array] | None:
    """Stamps, observations, actions, joint positions and rewards; None if there is no step."""
    seen = (first <= observed.stamps_ns) & (observed.stamps_ns < after)
    stamps, values = observed.stamps_ns[seen], observed.positions[seen]
    _, rows, of_actions = np.intersect1d(stamps, acted.stamps_ns, return_indices=True)
    if not len(rows):
        return None
    # Where the episode was cut off, nobody knows what the last action led to: nothing, it counts.
    following = np.minimum(rows + 1, len(values) - 1)
    rewarded = inside_region(layout, values[following]) & (following > rows)
    return (
        stamps[rows],
        values[rows],
        acted.positions[of_actions],
        joints.at(stamps[rows]),
        np.asarray(rewarded, dtype=np.float64),
    )


def _lost_after(recording: Recording) -> list[int]:
    """Stamps of observations after which the next ones, of the same sender, are missing."""
    messages = recording.messages.get(topics.POLICY_OBSERVATION.name, ())
    stamps = joint_series(recording, topics.POLICY_OBSERVATION).stamps_ns
    return [
        int(stamp)
        for stamp, (one, other) in zip(stamps, pairwise(messages), strict=False)
        if one.sender == other.sender and other.sequence > one.sequence + 1
    ]
