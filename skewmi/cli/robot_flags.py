"""What commands have in common that take a robot: its choices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from skewmi.deploy.robot.backends import BACKENDS
from skewmi.deploy.robot.process import EMULATOR
from skewmi.errors import ConfigurationError

RobotName = Annotated[str, tyro.conf.arg(metavar="{" + ",".join((*BACKENDS, EMULATOR)) + "}")]
"""One of the robots of this installation; help texts list them."""


def require_motion_options(
    lead_ms: float, variation: str | None, connect: str | None, zenoh_config: Path | None
) -> None:
    """Raise unless the options of a motion that is no policy's go together.

    Args:
        lead_ms: ms.
        variation: Of a simulated robot that is started.
        connect, zenoh_config: Where one runs already.

    Raises:
        ConfigurationError: They do not; the message says what to give.
    """
    if not (8.0 <= lead_ms <= 100.0 and (lead_ms / 4.0).is_integer()):
        raise ConfigurationError(f"--lead-ms is {lead_ms}; it must be a multiple of 4 in 8..100")
    if (connect or zenoh_config) is not None and variation:
        raise ConfigurationError(
            "--variation is of the simulated robot that is started; give it to the skewmi robot "
            "that --connect or --zenoh-config names"
        )
