"""A recording as tables: joint states and the policy's steps as pandas data frames, and as Parquet.

    skewmi deploy open_press_close --lock-step --record episode.mcap
    python examples/read_recording.py episode.mcap [FOLDER]

Recordings are MCAP with ROS 2 messages, which Foxglove, `ros2 bag` and `rosbags` read as well.
"""

import sys
from pathlib import Path

import pandas as pd

from skewmi.deploy.recording.joint_series import executed_reference, measured_states
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.messages import decode_joint_states

recording = read_recording(Path(sys.argv[1]))
folder = Path(sys.argv[2]) if len(sys.argv) > 2 else None

states = measured_states(recording)
time_s = pd.Index((states.stamps_ns - states.stamps_ns[0]) / 1e9, name="time_s")
joints = pd.DataFrame(states.position, index=time_s, columns=states.names)

executed = executed_reference(recording)
late = pd.DataFrame(executed.position - executed.reference.q, columns=executed.names)

messages = recording.messages[topics.POLICY_OBSERVATION.name]
seen = [decode_joint_states(message.payload) for message in messages]
observations = pd.DataFrame([dict(zip(s.names, s.position, strict=True)) for s in seen])

print(joints.describe().T[["min", "mean", "max"]])
print("largest distance from the reference, rad:", late.abs().to_numpy().max())
print(observations.tail())
if folder is not None:
    folder.mkdir(parents=True, exist_ok=True)
    joints.to_parquet(folder / "joint_states.parquet")
    observations.to_parquet(folder / "observations.parquet")
