"""Receives the states of the arm: waits for the next one, and notices that none comes."""

from __future__ import annotations

import time

from skewmi.deploy.session.arm_state import ArmState, ArmStateDecoder
from skewmi.deploy.session.scene_states import StaleStateError
from skewmi.deploy.session.timing import BUSY_ADVICE
from skewmi.deploy.wire.transport import LatestReader, Sample

LOCK_STEP_PATIENCE_S = 30.0
"""In lock-step nothing is ever old; a robot server that says nothing for so long is gone."""

_POLL_S = 250e-6
_CALM_S = 0.005
_EARLY_S = 0.002


class ArmStates:
    """The states of one arm, each taken once.

    Args:
        joints: Of `topics.YUMI_JOINT_STATES`, of the robot server alone. It keeps all.
        decoder: Finds the arm in them.
        lock_step: Take every state in order, however old, instead of the newest.
        state_period_s: How often the robot server publishes, s.
        max_age_s: Of a state, s.

    Attributes:
        last: The state that was returned last; None after `forget`.
    """

    def __init__(
        self,
        joints: LatestReader,
        decoder: ArmStateDecoder,
        *,
        lock_step: bool,
        state_period_s: float,
        max_age_s: float,
    ) -> None:
        self._joints, self._decoder = joints, decoder
        self._lock_step, self._max_age_s = lock_step, max_age_s
        self._period_ns = round(state_period_s * 1e9)
        self._queue: list[Sample] = []
        self.last: ArmState | None = None

    def next(self) -> ArmState | None:
        """Wait for a state that is newer than the last one returned.

        Sleeps until shortly before it is due: no busy waiting.

        Returns:
            None if the robot server repeats the last one: in lock-step, time stands still, and
            this is the moment to find out why.

        Raises:
            StaleStateError: None came in time.
            TransportError: A state is malformed.
        """
        last = self.last
        patience_s = LOCK_STEP_PATIENCE_S if self._lock_step else self._max_age_s
        started_ns = time.monotonic_ns()
        since_ns = started_ns if last is None else max(last.received_ns, 0)
        if last is not None and not self._lock_step:
            early_s = (last.received_ns + self._period_ns - started_ns) / 1e9 - _EARLY_S
            if early_s > 0.0:
                time.sleep(early_s)
        while True:
            state = self._take()
            if state is not None:
                if last is not None and state.stamp_ns <= last.stamp_ns:
                    return None
                self.last = state
                return state
            waited_s = (time.monotonic_ns() - since_ns) / 1e9
            if waited_s > patience_s:
                advice = "" if self._lock_step else f"; {BUSY_ADVICE}"
                raise StaleStateError(
                    f"no new joint state for {1e3 * waited_s:.0f} ms; at most "
                    f"{1e3 * patience_s:.0f} ms are allowed{advice}{self._joints.others()}"
                )
            # In lock-step a state comes as soon as the robot server has its time.
            time.sleep(20e-6 if self._lock_step and waited_s < _CALM_S else _POLL_S)

    def drop_unread(self) -> None:
        """Drop whatever has come and was not returned."""
        self._joints.drain()
        self._queue.clear()

    def _take(self) -> ArmState | None:
        """The next unread state: the oldest in lock-step, else the newest."""
        self._queue += self._joints.drain()
        if not self._queue:
            return None
        sample = self._queue.pop(0 if self._lock_step else -1)
        if not self._lock_step:
            self._queue.clear()
        return self._decoder.decode(sample)
