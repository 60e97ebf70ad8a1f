"""The robot model as URDF or MJCF: printed, or written to a file.

Both are made from one table; joints, links and the flange frames tool0_r and tool0_l have the same
names in both. Lengths in m, angles in rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from skewmi.outputs import check_output, written_aside


@dataclass(frozen=True)
class ModelCommand:
    """Options of `skewmi model`."""

    format: Literal["urdf", "mjcf"] = "urdf"
    """URDF (ROS, Pinocchio) or MJCF (MuJoCo)."""
    out: Path | None = None
    """File to write; printed without."""
    left_arm: Literal["jointed", "parked", "absent"] = "jointed"
    """Whether the left arm moves, stands at ABB's home pose (MJCF only), or is left out."""
    fingers: Literal["hooked", "straight"] = "hooked"
    """Of the right hand: the publication's hooked pair, or a straight one."""
    overwrite: bool = False
    """Replace an existing file."""


def run_model(options: ModelCommand) -> int:
    """Print or write the model. Returns 0."""
    if options.out is not None:
        check_output(options.out, overwrite=options.overwrite)
    text = model_text(options)
    if options.out is None:
        print(text)
        return 0
    with written_aside(options.out) as draft:
        draft.write_text(text + "\n", encoding="utf-8")
    print(f"wrote {options.out}")
    return 0


def model_text(options: ModelCommand) -> str:
    """XML of the model.

    Raises:
        ConfigurationError: The format has no such left arm.
    """
    if options.format == "mjcf":
        from skewmi.robot_models.mjcf import build_robot

        spec = build_robot(fingers=options.fingers, left_arm=options.left_arm)
        spec.compile()
        return str(spec.to_xml()).rstrip()
    from skewmi.errors import ConfigurationError
    from skewmi.robot_models.urdf import build_urdf

    if options.left_arm == "parked":
        raise ConfigurationError(
            "--left-arm parked is for MJCF; a URDF has the left arm jointed or absent"
        )
    hooked = options.fingers == "hooked"
    if options.left_arm == "absent":
        return build_urdf(arms=("right",), hooked=hooked)
    return build_urdf(hooked=hooked)
