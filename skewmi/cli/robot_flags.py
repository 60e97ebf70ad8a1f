"""What commands have in common that take a robot: its choices."""

from __future__ import annotations

from typing import Annotated

import tyro

from skewmi.deploy.robot.backends import BACKENDS
from skewmi.deploy.robot.process import EMULATOR

RobotName = Annotated[str, tyro.conf.arg(metavar="{" + ",".join((*BACKENDS, EMULATOR)) + "}")]
"""One of the robots of this installation; help texts list them."""
