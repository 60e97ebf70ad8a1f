"""Frames of a recorded deployment: its episodes, and the robot and scene where they were reported.

Drawn is what the robot reported (measured joints and scene), not what was commanded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skewmi.deploy.recording.reader import LAYOUT, Recording
from skewmi.deploy.session.news import SessionNews
from skewmi.deploy.session.states import SessionState
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import JointStates, decode_joint_states
from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout

if TYPE_CHECKING:
    from skewmi.sim.arm.arm_task import ArmTask
    from skewmi.sim.task_spec import Caption


@dataclass(frozen=True)
class RecordedJoints:
    """Samples of named joints over time; stamps in ns of the robot server's clock."""

    stamps_ns: NDArray[np.int64]
    names: tuple[str, ...]
    positions: Array

    def at(self, stamps_ns: NDArray[np.int64]) -> Array:
        """The newest sample at each time. Shape (len(stamps_ns), len(names))."""
        index = np.searchsorted(self.stamps_ns, stamps_ns, side="right") - 1
        picked: Array = self.positions[np.clip(index, 0, None)]
        return picked


def recorded_layout(recording: Recording) -> PolicyLayout:
    """The layout that the recording's policy used.

    Raises:
        ConfigurationError: The recording has none, or its task has no scene to draw.
    """
    if LAYOUT not in recording.metadata:
        raise ConfigurationError(
            f"{recording.path} does not say which task it shows; record with skewmi deploy"
        )
    return PolicyLayout.from_json(recording.metadata[LAYOUT])


def joint_series(recording: Recording, topic: topics.Topic) -> RecordedJoints:
    """All samples of a JointState topic.

    Raises:
        ConfigurationError: There is none.
    """
    messages = recording.messages.get(topic.name, ())
    samples: list[JointStates] = [decode_joint_states(message.payload) for message in messages]
    if not samples:
        raise ConfigurationError(f"{recording.path} holds nothing on {topic.name}")
    names = samples[0].names
    same = [sample for sample in samples if sample.names == names]
    return RecordedJoints(
        np.array([sample.stamp_ns for sample in same], dtype=np.int64),
        names,
        np.array([sample.position for sample in same]),
    )


def running_stamps(recording: Recording) -> NDArray[np.int64]:
    """When the session gave the arm to the policy, once per episode, ns of the server's clock."""
    found = []
    for message in recording.messages.get(topics.YUMI_STATUS.name, ()):
        news = SessionNews.decode(message.payload)
        if news is not None and news.state is SessionState.RUNNING:
            found.append(news.stamp_ns)
    return np.array(found, dtype=np.int64)


def split_episodes(
    stamps_ns: NDArray[np.int64], starts_ns: NDArray[np.int64]
) -> list[tuple[int, int]]:
    """First and last observation of every episode.

    Args:
        stamps_ns: Of the observations, in order.
        starts_ns: When each episode's policy began, in order.

    Returns:
        Stamps in ns; episodes without an observation are left out.
    """
    parts = np.split(stamps_ns, np.searchsorted(stamps_ns, starts_ns[1:]))
    return [(int(part[0]), int(part[-1])) for part in parts if len(part)]


def draw(
    arm: ArmTask,
    series: list[RecordedJoints],
    times: NDArray[np.int64],
    *,
    width: int,
    height: int,
    camera: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[NDArray[np.uint8]]:
    """One frame per time, with every recorded joint where it was reported.

    Args:
        arm: Task whose scene it was.
        series: Of joints of robot and scene.
        times: ns of the robot server's clock.
        width: Of a frame, pixels.
        height: Of a frame, pixels.
        camera: Of the scene.
        progress: Told how many frames are drawn, and how many there will be.

    Raises:
        NotFoundError: The scene has no such camera.
    """
    import mujoco

    from skewmi.robot_models import yumi
    from skewmi.sim import rendering
    from skewmi.sim.arm.scene import ArmScene

    model = ArmScene(arm).model
    data = mujoco.MjData(model)
    columns = [(item, [int(model.joint(n).qposadr[0]) for n in item.names]) for item in series]
    driving, following = (int(model.joint(n).qposadr[0]) for n in yumi.finger_names("right"))
    frames = []
    with rendering.Renderer(model, width=width, height=height) as renderer:
        for t in times:
            for item, addresses in columns:
                data.qpos[addresses] = item.at(np.array([t]))[0]
            data.qpos[following] = data.qpos[driving]
            frames.append(renderer.draw(data, camera))
            progress(len(frames), len(times))
    return frames


def caption(
    captions: Sequence[Caption], names: tuple[str, ...], values: Array, seconds: float
) -> str:
    """Time and what the task tells of an observation, for people.

    Args:
        captions: Of the task.
        names: Of the observation's fields.
        values: Of these. Shape (len(names),).
        seconds: Since the episode's start.
    """
    shown = dict(zip(names, values, strict=True))
    told = [item.text(float(shown[item.field])) for item in captions if item.field in shown]
    return "  ".join([f"{seconds:4.1f} s", *told])
