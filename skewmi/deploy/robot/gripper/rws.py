"""A SmartGripper behind Robot Web Services: a RAPID task moves it, we set its target and read it.

`rapid/SkewmiGrip.mod` runs in a task of its own, since EGMRunJoint blocks the motion task: it
calibrates the fingers, moves them to `skewmi_target` and writes what it sees into `skewmi_state`.
RWS is slow and its time is not bounded: a thread does the talking, and the newest target wins.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from skewmi.deploy.robot.gripper.base import check_opening
from skewmi.deploy.robot.gripper.rws_client import RwsClient
from skewmi.errors import CommandRefusedError, SkewmiError, TransportError

_log = logging.getLogger(__name__)

TASK, MODULE = "T_SKEWMI_GRIP", "SkewmiGrip"
TARGET, STATE = "skewmi_target", "skewmi_state"

PERIOD_S = 0.1
"""Between two looks at the gripper: RWS is not made for more."""
TOLD_WITHIN_S = 0.5
"""A target that cannot be told so long is given up: fingers must not close on their own when a
cable is plugged in again."""
SILENT_S = 2.0
"""A gripper that has not been heard of for so long is not there."""


@dataclass(frozen=True)
class GripperState:
    """What the RAPID task says.

    Attributes:
        opening: Travel of each finger from closed, m.
        calibrated: Whether the fingers know where they are.
        error: The gripper's own error number; 0 for none.
        beats: Counts the task's rounds: one that stands still does not run.
    """

    opening: float
    calibrated: bool
    error: int
    beats: int

    @staticmethod
    def parse(text: str) -> GripperState:
        """The RAPID value of `skewmi_state`: [mm, calibrated, error, rounds].

        Raises:
            TransportError: It is not one.
        """
        try:
            mm, calibrated, error, beats = (float(x) for x in text.strip("[] \t").split(","))
            return GripperState(mm / 1e3, calibrated > 0.5, int(error), int(beats))
        except ValueError:
            raise TransportError(
                f"{STATE} is {text[:60]!r}; [mm, calibrated, error, rounds] is expected: is "
                f"{MODULE}.mod of this version loaded?"
            ) from None


class RwsGripper:
    """Satisfies `Gripper`; `open` makes one and starts its thread.

    Args:
        client: Of the controller; used by this gripper's thread alone.
        opening: What to tell before the gripper has told, m.
    """

    def __init__(self, client: RwsClient, opening: float) -> None:
        self._client = client
        self._opening = opening
        self._lock = threading.Lock()
        self._target: tuple[float, float] | None = None
        """The newest one that has not been told, m, and until when it may be, s."""
        self._forgets = 0
        self._state: GripperState | None = None
        self._trouble = "the gripper has not answered yet"
        self._beat_s = time.monotonic()
        self._ended = threading.Event()
        self._woken = threading.Event()
        self._thread = threading.Thread(target=self._run, name="skewmi-gripper", daemon=True)

    @staticmethod
    def open(client: RwsClient, opening: float) -> RwsGripper:
        """Begin to talk to the controller; see the class."""
        gripper = RwsGripper(client, opening)
        gripper._thread.start()
        return gripper

    @property
    def opening(self) -> float:
        with self._lock:
            return self._opening if self._state is None else self._state.opening

    def problem(self) -> str | None:
        """Not there, not calibrated, in error, or its task stands still."""
        with self._lock:
            state, trouble = self._state, self._trouble
            silent_s = time.monotonic() - self._beat_s
        if trouble:
            return f"gripper not there: {trouble}"
        if state is None or silent_s > SILENT_S:
            return f"gripper not there: task {TASK} does not run; start it together with the others"
        if state.error:
            return f"the gripper reports error {state.error}; see the controller's event log"
        if not state.calibrated:
            return (
                "gripper not calibrated; close the fingers by hand or with the FlexPendant and "
                f"start {TASK} again"
            )
        return None

    def open_to(self, opening: float) -> None:
        """Set a new target.

        Raises:
            CommandRefusedError: Not an opening, or the gripper cannot.
        """
        check_opening(opening)
        problem = self.problem()
        if problem is not None:
            raise CommandRefusedError(problem)
        with self._lock:
            self._target = (opening, time.monotonic() + TOLD_WITHIN_S)
        self._woken.set()

    def forget(self) -> None:
        """See `Gripper`."""
        with self._lock:
            self._target = None
            self._forgets += 1

    def close(self) -> None:
        """End the thread; the fingers stay where they are."""
        self._ended.set()
        self._woken.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                self._talk()
                trouble = ""
            except SkewmiError as error:
                trouble = str(error)
            except Exception as error:
                # Whatever a controller answers must not end this thread in silence.
                _log.exception("talking to the gripper failed")
                trouble = f"internal error: {error!r}"
            with self._lock:
                if trouble and trouble != self._trouble:
                    _log.warning("gripper: %s", trouble)
                self._trouble = trouble
            self._woken.wait(PERIOD_S)
            self._woken.clear()

    def _talk(self) -> None:
        with self._lock:
            target, self._target = self._target, None
            forgets = self._forgets
        if target is not None and time.monotonic() < target[1]:
            try:
                self._client.write_symbol(TASK, MODULE, TARGET, f"{1e3 * target[0]:.2f}")
            except TransportError:
                with self._lock:
                    # Once more, unless there is a newer one by then, or nobody wants it any more.
                    if self._target is None and self._forgets == forgets:
                        self._target = target
                raise
        state = GripperState.parse(self._client.read_symbol(TASK, MODULE, STATE))
        with self._lock:
            if self._state is None or state.beats != self._state.beats:
                self._beat_s = time.monotonic()
            self._state = state
