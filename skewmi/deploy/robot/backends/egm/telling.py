"""What the bridge tells of its controller on `/yumi/status`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skewmi.deploy.robot.status import DELAY_KEY
from skewmi.robot_models.kinematics import ArmKinematics

if TYPE_CHECKING:
    from skewmi.deploy.robot.backends.egm.backend import EgmBackend

_KINEMATICS = ArmKinematics("right")

_LOOKED_AT = 16
"""References whose speed is worked out for the status."""


def told(bridge: EgmBackend) -> dict[str, str]:
    """Keys and values for the status."""
    channel = bridge.right
    if channel is None:
        return {}
    watch, packet = channel.watch, channel.watch.packet
    statistics = watch.statistics
    values = {
        "egm": watch.state.value,
        "egm_missing": bridge.readiness() or "",
        "session": str(watch.sessions),
        "rate_hz": f"{statistics.rate_hz:.1f}",
        "jitter_ms": f"{statistics.jitter_ns / 1e6:.3f}",
        "missed": str(statistics.missed),
        "replies": str(statistics.replies),
        "late_fraction": f"{statistics.late_fraction:.6f}",
        "reply_ms": f"{statistics.reply_ns / 1e6:.3f}",
        "ignored": str(statistics.ignored),
        "unusable": str(watch.unusable),
        "unusable_reason": watch.unusable_reason,
        "runs_on_mm": f"{1e3 * runs_on(bridge):.2f}",
        "left_arm": "not watched" if bridge.left is None else bridge.left.summary,
        "gripper": "none" if bridge.gripper is None else bridge.gripper.problem() or "ready",
    }
    delay_s = bridge.delay.delay_s
    if delay_s is not None:
        values[DELAY_KEY] = f"{1e3 * delay_s:.1f}"
    if packet is not None:
        rate = packet.utilization
        values |= {
            "motors": packet.motors.name.lower(),
            "rapid": packet.rapid.name.lower(),
            "mci": packet.mci.name.lower(),
            "robotware": str(packet.robotware),
            "utilization": "unknown" if rate is None else f"{rate:.0f}",
        }
    return values


def runs_on(bridge: EgmBackend) -> float:
    """How far the flange would run on if this process died now, m: a bound, see `run_on`."""
    recent = list(bridge.recent)
    # No motion changes its speed much within so few cycles.
    shown = recent[:: -max(1, len(recent) // _LOOKED_AT)]
    if not any(point.v.any() for point in shown):
        return 0.0
    q, v = (np.array(values) for values in zip(*((p.q, p.v) for p in shown), strict=True))
    flange_v = (_KINEMATICS.jacobian(q)[:, :3] @ v[:, :, None])[:, :, 0]
    fastest = float(np.linalg.norm(flange_v, axis=1).max())
    options = bridge.options
    return fastest * options.program.runs_on_s(options.feed_forward)
