"""A recording of a known motion, with a scene, a policy and a success."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from skewmi.deploy.recording.reader import METADATA_NAME, run_metadata
from skewmi.deploy.recording.writer import RecordingWriter
from skewmi.deploy.robot.backends.mujoco.scene_geometry import scene_geometry
from skewmi.deploy.wire import messages, topics
from skewmi.deploy.wire.messages import JointStates, Status
from skewmi.policy_io import ActionField, Ball, Field, PolicyLayout, Workspace
from skewmi.robot_models import limits, yumi
from skewmi.trajectory import JointTrajectory, TrajectoryChunk

GRID_NS = 4_000_000
CYCLE_NS = 20_000_000
EPOCH_NS = 3_000_000_000
"""Robot server clock at the start of the recording."""
DURATION_S = 2.0
SUCCESS_S = 1.2
Q_MIDDLE = np.array([0.9, -1.6, -1.2, 0.5, 0.3, 1.0, 0.2])
PROFILE = limits.profile("lab")

LAYOUT = PolicyLayout(
    task="test",
    observation=(
        Field("hand_x", "m", "world", -0.1, 0.5),
        Field("button_depth", "m", "world", 0.0, 0.02),
    ),
    action=tuple(ActionField(f"v{axis}", "m", "world", 0.01) for axis in "xyz"),
    reward_region=(Ball(("button_depth",), (0.015,), 0.005),),
    control_dt=0.1,
    episode_steps=20,
    success_hold_steps=3,
    workspace=Workspace(
        low=(-0.1, -0.6, 0.0),
        high=(0.5, 0.2, 0.6),
        start=(0.1, 0.0, 0.3),
        base_position=(-0.4, 0.0, 0.0),
        hand_quaternion_wxyz=(0.0, 1.0, 0.0, 0.0),
        free_following_error=1.0,
        held_following_error=0.3,
        stop_blockage=0.45,
        start_configuration=tuple(Q_MIDDLE),
        gripper_opening=0.01,
    ),
)

SCENE = """
<mujoco><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body name="yumi_link_1_r"><geom type="box" size="9 9 9"/></body>
  <body name="box" pos="0.1 0 0"><geom name="wall" type="box" size="0.1 0.01 0.05"/>
    <body name="lid" pos="0 0.1 0.05">
      <joint name="lid_hinge" type="hinge" axis="1 0 0"/>
      <geom name="plate" type="box" size="0.1 0.1 0.001" pos="0 -0.1 0" rgba="0 0 1 1"/>
    </body>
    <body name="button"><joint name="button_slide" type="slide" axis="0 0 -1"/>
      <geom name="knob" type="cylinder" size="0.02 0.01"/></body>
  </body>
</worldbody></mujoco>
"""


def motion(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sine on all joints: q, v, a. Shapes (n, 7)."""
    amplitude, rate = 0.15, 2.0
    phase = rate * time_s[:, None] + np.arange(7)
    q = Q_MIDDLE + amplitude * np.sin(phase)
    return q, amplitude * rate * np.cos(phase), -amplitude * rate**2 * np.sin(phase)


def write_recording(path: Path, *, metadata: bool = True) -> None:
    """Two seconds: chunks with tails every 20 ms, states, observations, events, success."""
    names = yumi.joint_names("right")
    finger = yumi.finger_names("right")[0]
    model = mujoco.MjModel.from_xml_string(SCENE)
    with RecordingWriter(path) as writer:
        if metadata:
            bounds = {
                name: getattr(PROFILE, name)
                for name in ("position_lower", "position_upper", "velocity", "acceleration", "jerk")
            }
            content = run_metadata(
                layout_json=LAYOUT.to_json(),
                limits=bounds,
                scene=scene_geometry(model).to_json(),
            )
            writer.add_metadata(METADATA_NAME, content)
        for cycle in range(int(DURATION_S * 50)):
            stamp_ns = EPOCH_NS + cycle * CYCLE_NS
            now_s = cycle * 0.02
            chunk_s = now_s + np.arange(20) * 0.004
            chunk = TrajectoryChunk.of(stamp_ns, names, JointTrajectory(*motion(chunk_s)))
            writer.write(topics.YUMI_TRAJECTORY, messages.encode_chunk(chunk))
            q, v, _ = motion(np.array([now_s - 0.01]))
            measured = JointStates(
                stamp_ns,
                (*names, finger),
                np.append(q[0], 0.014),
                np.append(v[0], 0.0),
                np.zeros(0),
            )
            writer.write(topics.YUMI_JOINT_STATES, messages.encode_joint_states(measured))
            depth = 0.012 if now_s > SUCCESS_S - 0.25 else 0.0
            scene = np.array([0.5 * now_s, depth])
            joints = ("lid_hinge", "button_slide")
            writer.write(
                topics.YUMI_SCENE_STATES,
                messages.encode_joint_states(
                    JointStates(stamp_ns, joints, scene, scene[:0], scene[:0])
                ),
            )
            if cycle % 5 == 0:
                for topic, names_, values in (
                    (topics.POLICY_OBSERVATION, LAYOUT.observation_names, [0.2, depth]),
                    (topics.POLICY_ACTION, ("vx", "vy", "vz"), [0.1, -0.2, 1.0]),
                ):
                    vector = np.array(values)
                    states = JointStates(stamp_ns, names_, vector, vector[:0], vector[:0])
                    writer.write(topic, messages.encode_joint_states(states))
            state = "executing" if cycle > 10 else "holding"
            status = Status(stamp_ns, "endpoint", messages.OK, state)
            writer.write(topics.YUMI_STATUS, messages.encode_status(status))
