"""What a robot server tells without being asked: states, what it executed, status."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from skewmi.deploy.robot.backend import LinkErrors, LinkVaries, RobotBackend, RobotState
from skewmi.deploy.robot.bad_link import BadLink
from skewmi.deploy.robot.contact_log import ContactLog
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.states import ServerEvent, ServerState
from skewmi.deploy.robot.status import RobotStatus
from skewmi.deploy.state_machine import Transition
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import Publisher
from skewmi.deploy.wire.controller_state import ControllerState, encode_controller_state
from skewmi.deploy.wire.messages import JointStates, encode_joint_states
from skewmi.deploy.wire.transport import Link
from skewmi.trajectory import CYCLE_NS

_STATUS_PERIOD_NS = 500_000_000
_OTHERS_PERIOD_NS = 50_000_000
"""Refusals of others than the commander are told no more often: a flood of them shall not become
a flood of statuses."""
_POSTPONED_NS = 20_000_000
"""By which a status may be later for the sake of the robot's next cycle."""
_SHOWN_REFUSALS = 3


class StatePublisher:
    """Publishes in the robot server's time.

    Args:
        backend: The robot.
        controller: Of that robot.
        link: An open one.
    """

    def __init__(self, backend: RobotBackend, controller: RobotController, link: Link) -> None:
        self._backend = backend
        self._controller = controller
        self._joint_states = link.publisher(topics.YUMI_JOINT_STATES)
        self._scene_states = link.publisher(topics.YUMI_SCENE_STATES)
        self._controller_states = link.publisher(topics.YUMI_CONTROLLER_STATE)
        self._status = link.publisher(topics.YUMI_STATUS)
        self._link_varies = backend if isinstance(backend, LinkVaries) else None
        self._bad_link: BadLink | None = None
        self._next_ns = self._stamp_ns = self._executed_ns = -1
        self._cycles_untold = 0
        self._told_ns = -_STATUS_PERIOD_NS
        self._refused_told = 0
        self._told: Mapping[str, str] = {}
        self._next_told_ns = 0
        self._contact = ContactLog(backend)
        self.dropped: Callable[[], int] = lambda: 0
        """How many commands were not judged, for want of time."""

    def publishers(self) -> dict[str, tuple[str, ...]]:
        """Whom to believe, for the description: see `RobotDescription.publishers`."""
        scene = self._backend.scene
        others = () if scene is None else tuple(scene.publishers())
        return {
            topics.YUMI_JOINT_STATES.name: (self._joint_states.gid.hex(),),
            topics.YUMI_CONTROLLER_STATE.name: (self._controller_states.gid.hex(),),
            topics.YUMI_STATUS.name: (self._status.gid.hex(),),
            topics.YUMI_SCENE_STATES.name: tuple(
                gid.hex() for gid in others or (self._scene_states.gid,)
            ),
        }

    def states(self, state: RobotState) -> None:
        """Publish the newest cycle's states, if the first `CYCLE_NS` after the last are over.

        A state that comes again with the same time is told again: time stands still, and this is
        for those who come late.
        """
        stamp_ns = self._controller.arm_motion.executed_ns
        if stamp_ns < self._next_ns and stamp_ns != self._stamp_ns:
            return
        self._next_ns = stamp_ns - stamp_ns % CYCLE_NS + CYCLE_NS
        self._stamp_ns = stamp_ns
        self._contact.note(stamp_ns)
        if self._link_varies is not None:
            self._vary_link(self._link_varies.link_errors())
        # The scene first: whoever sees joint states of a stamp has its scene states already.
        scene = None if self._backend.scene is None else self._backend.scene.state()
        if scene is not None:
            nothing = scene.position[:0]
            told = JointStates(stamp_ns, scene.names, scene.position, scene.velocity, nothing)
            self._send(self._scene_states, encode_joint_states(told))
        names = self._backend.state_names
        joints = JointStates(stamp_ns, names, state.position, state.velocity, state.effort)
        self._send(self._joint_states, encode_joint_states(joints))

    def executed(self, state: RobotState) -> None:
        """Publish what was written in the newest cycle, and what it measured; left out, and
        counted, if the next cycle has come already."""
        motion = self._controller.arm_motion
        if motion.executed_ns == self._executed_ns:
            return
        self._executed_ns = motion.executed_ns
        if self._backend.due():
            self._cycles_untold += 1
            return
        names = self._backend.joint_names
        joints = slice(len(names))
        told = ControllerState(
            motion.executed_ns,
            names,
            motion.commanded,
            state.position[joints],
            state.velocity[joints],
            state.effort[joints],
        )
        self._controller_states.put(encode_controller_state(told))

    def carry(self) -> None:
        """Send the states whose delay on a varied link is over."""
        if self._bad_link is not None:
            self._bad_link.carry(time.monotonic_ns())

    def _send(self, publisher: Publisher, payload: bytes) -> None:
        if self._bad_link is None:
            publisher.put(payload)
        else:
            self._bad_link.take(publisher.put, payload, time.monotonic_ns())

    def _vary_link(self, errors: LinkErrors | None) -> None:
        """Begin anew if the link is another one: what the old one still holds is lost."""
        if errors is None:
            self._bad_link = None
        elif self._bad_link is None or self._bad_link.errors is not errors:
            self._bad_link = BadLink(errors)

    def status(self) -> None:
        """Publish the status if it is time for it, and not for the robot's next cycle: at once if
        the commander was refused something, soon if anybody else was, who may try by the
        hundred."""
        now_ns, refusals = time.monotonic_ns(), self._controller.refusals
        refused = refusals.count != self._refused_told
        wait_ns = _OTHERS_PERIOD_NS if refused else _STATUS_PERIOD_NS
        if not refusals.commander_untold:
            due_ns = self._told_ns + wait_ns
            if now_ns < due_ns or (now_ns < due_ns + _POSTPONED_NS and self._backend.due()):
                return
        self.tell(self._controller.clock_ns)

    def tell(self, stamp_ns: int, transition: Transition[ServerState] | None = None) -> None:
        """Publish the status now."""
        controller = self._controller
        self._told_ns = time.monotonic_ns()
        self._refused_told = controller.refusals.count
        # The commander's own come first: they are what it has to answer for.
        refusals = sorted(controller.refusals.take(), key=lambda r: not r.of_commander)
        noted = controller.refusals
        status = RobotStatus(
            stamp_ns=stamp_ns,
            state=controller.state,
            reason=controller.machine.reason,
            accepted=controller.accepted,
            refused=controller.refusals.count,
            refusal="; ".join(refusal.reason for refusal in refusals[:_SHOWN_REFUSALS]),
            refused_stamps_ns=tuple(refusal.stamp_ns for refusal in refusals),
            commander_refused_stamps_ns=tuple(
                r.stamp_ns for r in refusals if r.of_commander and r.stamp_ns is not None
            ),
            out_of_step=all(r.out_of_step for r in refusals if r.of_commander),
            refused_of_commander=noted.of_commander,
            broken_of_commander=noted.broken_of_commander,
            last_refusal=noted.last_of_commander,
            commander=controller.lease.holder or b"",
            slips=self._backend.slips,
            told=self._told_by_robot(transition is not None),
            dropped=self.dropped(),
            workspace=controller.lease.workspace,
            cycles_untold=self._cycles_untold,
            source=None if transition is None else transition.source,
            event=None if transition is None else ServerEvent(transition.event),
        )
        self._status.put(status.encode())

    def _told_by_robot(self, anew: bool) -> Mapping[str, str]:
        """What the robot says of itself: now and then, since refusals may come by the hundred."""
        now_ns = time.monotonic_ns()
        if anew or now_ns >= self._next_told_ns:
            self._next_told_ns = now_ns + _STATUS_PERIOD_NS
            self._told = self._backend.told()
            return {**self._told, **self._contact.take()}
        return self._told
