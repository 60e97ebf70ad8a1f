"""From recordings to what servo identification starts from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skewmi.calibration.calibration_file import RecordingReference
from skewmi.calibration.egm_law import EgmLaw
from skewmi.calibration.egm_model import EgmRecording
from skewmi.calibration.servo_recording import ServoRecording
from skewmi.deploy.recording.joint_series import (
    ExecutedReference,
    executed_reference,
    measured_states,
)
from skewmi.deploy.recording.reader import read_recording
from skewmi.deploy.robot.description import EGM, ROBOT_CALIBRATION
from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.robot_models import yumi


@dataclass(frozen=True, eq=False)
class RecordedEgm:
    """A motion that a controller was asked for through EGM.

    Attributes:
        recording: Of each of its cycles.
        announced: The law that the robot server was told.
    """

    recording: EgmRecording
    announced: EgmLaw


@dataclass(frozen=True, eq=False)
class RecordedExcitation:
    """One recording, read.

    Attributes:
        reference: Its name and hash.
        recording: Commands that were executed, positions that were measured.
        egm: The same in cycles of a controller that was guided by EGM; None if there was none.
    """

    reference: RecordingReference
    recording: ServoRecording
    egm: RecordedEgm | None = None


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
        egm = _egm_part(recorded.metadata, executed)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return RecordedExcitation(RecordingReference(path.name, digest), recording, egm)


def _egm_part(metadata: Mapping[str, str], executed: ExecutedReference) -> RecordedEgm | None:
    """What a recording made through EGM has besides; None of one that was not."""
    if metadata.get("backend") != "egm":
        return None
    if EGM not in metadata:
        raise ConfigurationError(
            "it was made through EGM by a robot server that does not tell what law its controller "
            "has; record it again with this version"
        )
    if metadata.get(ROBOT_CALIBRATION):
        raise ConfigurationError(
            "it was made by a robot server that had a calibration, so that the controller was sent "
            "something else than was recorded; record it again without"
        )
    try:
        told = json.loads(metadata[EGM])
        share = float(told["speed_share"])
        announced = EgmLaw(float(told["gain"]), float(told["low_pass_hz"]))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"its metadata {EGM!r} cannot be read: {error}") from error
    period_ns, cycles, references = executed.by_cycles()
    recording = EgmRecording.of_cycles(
        references, cycles, executed.position, period_ns / 1e9, share
    )
    return RecordedEgm(recording, announced)
