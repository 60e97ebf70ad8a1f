"""The real controller as a robot: its packets are the clock, each is answered once and at once."""

from __future__ import annotations

import logging
import select
import time
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from skewmi.deploy.robot.backend import RobotBackend, RobotState
from skewmi.deploy.robot.backends import BackendOptions
from skewmi.deploy.robot.backends.egm.channel import ArmChannel, Taken
from skewmi.deploy.robot.backends.egm.clock import NOMINAL_PERIOD_NS
from skewmi.deploy.robot.backends.egm.leading import LeadingReferences
from skewmi.deploy.robot.backends.egm.left_arm import LeftArm
from skewmi.deploy.robot.backends.egm.link import UdpLink, parse_address
from skewmi.deploy.robot.backends.egm.motion import DelayEstimate, SpeedEstimate
from skewmi.deploy.robot.backends.egm.options import EgmOptions
from skewmi.deploy.robot.backends.egm.scene import EgmScene
from skewmi.deploy.robot.backends.egm.states import EgmState
from skewmi.deploy.robot.backends.egm.telling import told
from skewmi.deploy.robot.gripper.base import Gripper
from skewmi.deploy.state_machine import Transition
from skewmi.errors import CommandRefusedError, ConfigurationError, TransportError
from skewmi.robot_models import yumi
from skewmi.trajectory import Array, JointPoint

_log = logging.getLogger(__name__)

WAIT_NS = 8_000_000
"""Longest wait for a packet before commands and services have their turn: two cycles."""

SOON_NS = 1_000_000
"""Before and after the time at which the next packet is expected, it is waited for and nothing else
is begun: an answer on the link takes that long on a slow computer."""

_FOLLOWS = (EgmState.GUIDING, EgmState.OVERLOADED)
_LEFT_NAMES = yumi.joint_names("left")


class EgmBackend:
    """A YuMi behind ABB's EGM; satisfies `RobotBackend`, `GuidedByEgm` and `SendsAhead`. It
    controls the right arm.

    Args:
        options: Of the bridge.
        gripper: Of the right arm; None if there is none.
        scene: What is known of what stands before it; None if nothing is.
        leading: Of a known controller: references run ahead of the plan.
    """

    name = "egm"
    period_ns = round(NOMINAL_PERIOD_NS)
    lock_step = False

    def __init__(
        self,
        options: EgmOptions,
        gripper: Gripper | None = None,
        scene: EgmScene | None = None,
        leading: LeadingReferences | None = None,
    ) -> None:
        self.options = options
        self.gripper = gripper
        self.scene = scene
        self._leading = leading
        self.joint_names = yumi.joint_names("right")
        fingers = () if gripper is None else yumi.finger_names("right")[:1]
        self.state_names: tuple[str, ...] = (*self.joint_names, *fingers)
        self.admitted_speed = options.admitted_speed
        self.joint_speed = options.joint_speed
        self.slips = 0
        self.delay = DelayEstimate()
        self.command: JointPoint | None = None
        """What was answered last while the arm followed; None while it does not."""
        self.recent: deque[JointPoint] = deque(maxlen=options.program.remembered_cycles)
        """What was answered before it, as far back as the controller's speed depends on it."""
        self.right: ArmChannel | None = None
        self.left: LeftArm | None = None
        if scene is not None:
            scene.on_reset = self._expect_session
        self._begun = ""
        """Why a session has begun since the cycle before."""
        self._speed = SpeedEstimate()
        self._poll = select.poll()

    def open(self, may_advance: Callable[[], bool]) -> None:
        """Bind the sockets.

        Raises:
            ConfigurationError: An address is none.
            TransportError: One of them cannot be bound.
        """
        del may_advance
        options, address = self.options, parse_address(self.options.listen)
        self.right = self._channel(UdpLink.open(address), "right")
        left = self._open_left((self.right.link.address[0], self.right.link.address[1] - 1))
        self.left = None if left is None else LeftArm(self._channel(left, "left"))
        self._poll.register(self.right.link, select.POLLIN)
        if left is not None:
            self._poll.register(left, select.POLLIN)
        host, port = self.right.link.address
        _log.info(
            "EGM: right arm on %s:%d/udp, left arm %s; a flange at %.0f mm/s runs on %.0f mm",
            host,
            port,
            "not watched" if left is None else f"on {left.address[0]}:{left.address[1]}/udp",
            1e3 * self.admitted_speed,
            1e3 * options.run_on_limit,
        )

    def readiness(self) -> str | None:
        """What is missing before the arm can be commanded, in the order of what has to be done."""
        if self.right is None:
            return "the bridge is not open"
        missing = self.right.readiness() or self._begun or None
        if missing is None and self.left is not None:
            missing = self.left.misplaced()
        return missing

    def read(self) -> RobotState | None:
        """Wait for a packet of the right arm, and serve the left one meanwhile."""
        assert self.right is not None, "open it first"
        until_ns = time.monotonic_ns() + WAIT_NS
        while True:
            taken = self.right.take()
            if taken is not None:
                return self._state(taken)
            if self.left is not None:
                self.left.serve()
            left_ns = until_ns - time.monotonic_ns()
            # Milliseconds are all that poll knows, rounded up.
            if left_ns <= 0 or not self._poll.poll(left_ns / 1e6):
                return None

    def due(self) -> bool:
        """Whether a packet waits for its answer, or is about to come: then what begins now would
        hold the answer up."""
        if self.right is None:
            return False
        return self._is_expected(self.right) or self.right.link.wait(0)

    @staticmethod
    def _is_expected(arm: ArmChannel) -> bool:
        if arm.watch.newest is None:
            return False
        since_ns = arm.link.now_ns() - arm.watch.newest.arrival_ns
        return abs(since_ns - arm.watch.clock.period_ns) < SOON_NS

    def write(self, command: JointPoint) -> None:
        """Answer the packet; then the left arm's, which may have come meanwhile."""
        assert self.right is not None
        if self.right.watch.state in _FOLLOWS:
            share = self.options.feed_forward
            ahead = self._leading
            q, v = (command.q, command.v) if ahead is None else ahead.references(command)
            self.right.answer(q, share * v if share else None)
            self._note_delay(command)
            self.command = command
            # What runs on if the bridge dies is what was sent, which may be ahead of the plan.
            self.recent.append(JointPoint(command.q, v, command.a))
        else:
            self.right.hold()
            self.command = None
            self.recent.clear()
            self.delay.forget_way()
        if self.left is not None:
            self.left.serve()

    def rest_at(self, q: Array) -> None:
        """See `SendsAhead`."""
        if self._leading is not None:
            self._leading.start(q)

    def egm(self) -> Mapping[str, float]:
        """What the bridge was told of the controller's law, for `RobotDescription.egm`."""
        program = self.options.program
        return {
            "gain": program.gain,
            "low_pass_hz": program.low_pass_hz,
            "speed_share": self.options.feed_forward,
        }

    def activate(self) -> None:
        """EGM runs already: nothing is to be switched on."""

    def deactivate(self) -> None:
        """EGM goes on: the arm is held by it. Fingers that were told to move and have not been
        told yet stay where they are."""
        if self.gripper is not None:
            self.gripper.forget()

    def open_gripper(self, opening: float) -> None:
        """Move each finger to `opening` m from closed.

        Raises:
            CommandRefusedError: Not an opening, no gripper, or one that cannot.
        """
        if self.gripper is None:
            raise CommandRefusedError("this robot has no gripper; start it with --gripper")
        self.gripper.open_to(opening)

    def told(self) -> Mapping[str, str]:
        """What the status says beyond that of every robot."""
        return told(self)

    def close(self) -> None:
        """Close the sockets and leave the gripper."""
        if self.right is not None:
            self.right.link.close()
        if self.left is not None:
            self.left.channel.link.close()
        if self.gripper is not None:
            self.gripper.close()

    def _expect_session(self) -> None:
        assert self.right is not None
        self.right.watch.expect_session("the scene was reset; the program starts again")

    def _state(self, taken: Taken) -> RobotState:
        assert self.right is not None
        watch, q = self.right.watch, taken.packet.q
        self.slips += taken.skipped
        # A session that begins and ends its ramp in one cycle, after a hold-up, never shows in the
        # watch's state: who has commanded the arm does not know where it is all the same.
        self._begun = taken.begins and f"a session has begun ({taken.begins})"
        if taken.begins:
            self._speed.forget()
            self.delay.forget_way()
        velocity = self._speed.add(watch.clock.time_ns, q)
        if self.gripper is not None:
            q, velocity = np.append(q, self.gripper.opening), np.append(velocity, 0.0)
        left_q = None if self.left is None else self.left.position
        if self.left is not None and left_q is not None:
            if _LEFT_NAMES[0] not in self.state_names:
                self.state_names = (*self.state_names, *_LEFT_NAMES)
            q, velocity = np.append(q, left_q), np.append(velocity, self.left.velocity)
        return RobotState(
            time_ns=int(watch.clock.time_ns),
            position=q,
            velocity=velocity,
            effort=np.zeros(len(q)),
            guided=watch.state in _FOLLOWS and not taken.begins,
        )

    def _note_delay(self, command: JointPoint) -> None:
        assert self.right is not None
        watch = self.right.watch
        if watch.packet is not None:
            self.delay.add(watch.clock.time_ns / 1e9, command.q, watch.packet.q)

    def _open_left(self, beside: tuple[str, int]) -> UdpLink | None:
        where = self.options.listen_left
        if where == "none":
            return None
        if where is not None:
            return UdpLink.open(parse_address(where))
        try:
            return UdpLink.open(beside)
        except (TransportError, OverflowError) as error:
            _log.warning("the left arm is not watched: %s", error)
            return None

    def _channel(self, link: UdpLink, arm: str) -> ArmChannel:
        def tell(transition: Transition[EgmState]) -> None:
            _log.info("EGM, %s arm: %s", arm, transition)

        ramp_ns = round(1e9 * self.options.program.ramp_in_s)
        return ArmChannel(link, ramp_ns, self.options.controller, tell)


def make(options: BackendOptions) -> RobotBackend:
    """See `backends.make_backend`."""
    if options.lock_step:
        raise ConfigurationError("a controller has its own time; leave out --lock-step")
    if options.variation is not None:
        raise ConfigurationError(
            "a real robot is as it is; give --variation to the egm-emulator, or leave it out"
        )
    egm = EgmOptions() if options.egm is None else options.egm
    # Real controllers do not live on this computer. Beside one nobody is asked to be an emulator:
    # anybody on the link could say that he is, and would be believed what he says of the scene.
    emulated = parse_address(egm.listen)[0].startswith("127.")
    scene = (
        EgmScene.open(options.facts, options.link if emulated else None) if options.facts else None
    )
    leading = None
    if options.feed_forward is not None:
        leading = LeadingReferences(options.feed_forward, options.low_pass_s, egm.admitted_speed)
    return EgmBackend(egm, options.gripper, scene, leading)
