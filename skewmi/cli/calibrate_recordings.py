"""From recordings to what servo identification starts from."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skewmi.calibration.calibration_file import RecordingReference
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.deploy.recording.joint_series import executed_reference, measured_states
from skewmi.deploy.recording.reader import read_recording
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models import yumi


@dataclass(frozen=True, eq=False)
class RecordedExcitation:
    """One recording, read.

    Attributes:
        reference: Its name and hash.
        recording: Commands that were executed, positions that were measured.
    """

    reference: RecordingReference
    recording: ServoRecording


def read_excitation(path: Path) -> RecordedExcitation:
    """Read a recording of `skewmi calibrate excite`, or of any motion of the arm in free space.

    Raises:
        NotFoundError: There is no such file.
        ConfigurationError: It is no recording, is of another robot model, or lacks the executed
            reference or the joint states.
    """
    path = Path(path)
    if not path.is_file():
        raise NotFoundError(f"no recording {path}; `skewmi calibrate excite` makes one")
    recorded = read_recording(path)
    model = recorded.metadata.get("robot_model_hash")
    if model is not None and model != yumi.MODEL_HASH:
        raise ConfigurationError(
            f"{path} was recorded with robot model {model[:12]}, this skewmi has "
            f"{yumi.MODEL_HASH[:12]}; record it again"
        )
    joints = yumi.joint_names("right")
    executed = executed_reference(recorded)
    if executed.names != joints:
        raise ConfigurationError(
            f"{path} has the reference of {', '.join(executed.names)}; it must be of "
            f"{', '.join(joints)}"
        )
    first_ns, commands = executed.on_grid()
    measured = measured_states(recorded)
    missing = [name for name in joints if name not in measured.names]
    if missing:
        raise ConfigurationError(f"{path} has no positions of {', '.join(missing)}")
    columns = [measured.names.index(name) for name in joints]
    efforts = measured.effort[:, columns]
    try:
        recording = ServoRecording(
            commands,
            (measured.stamps_ns - first_ns) / 1e9,
            measured.position[:, columns],
            # A message without efforts makes them unfit for use.
            efforts if np.isfinite(efforts).all() else None,
        )
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return RecordedExcitation(RecordingReference(path.name, digest), recording)
