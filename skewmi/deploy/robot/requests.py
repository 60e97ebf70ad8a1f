"""What anybody may ask of a robot server, besides motion; without its wires, as `controller`."""

from __future__ import annotations

from collections import deque

from skewmi.deploy.robot.backend import RobotBackend
from skewmi.deploy.robot.controller import RobotController
from skewmi.deploy.robot.gripper.base import check_opening
from skewmi.deploy.robot.refusals import Refusal, printable
from skewmi.deploy.robot.states import ACCEPTS_COMMANDS, ServerEvent, ServerState
from skewmi.deploy.robot.workspaces import check_scene_is_shut
from skewmi.deploy.safety.flange_space import TASK
from skewmi.deploy.safety.validation import MAX_GRIPPER_BYTES, check_fresh, check_size
from skewmi.deploy.wire.arm_request import ArmRequest
from skewmi.deploy.wire.messages import JointStates
from skewmi.errors import CommandRefusedError
from skewmi.robot_models import yumi

MOST_WAITING = 16
"""Gripper commands whose time has not come; one for each control step is usual."""


class RobotRequests:
    """Arming, stopping, gripper commands and resets of the scene, checked.

    Args:
        backend: The robot.
        controller: Of that robot.
    """

    def __init__(self, backend: RobotBackend, controller: RobotController) -> None:
        self._backend = backend
        self._controller = controller
        self._openings: deque[tuple[int, bytes, float]] = deque(maxlen=MOST_WAITING)
        self.stops = 0
        """How often somebody asked to stop, in whatever state: a commander that was between two
        episodes must not take the arm again as if nothing had been said."""

    def arm(self, extra: bytes, now_ns: int) -> None:
        """Accept chunks from now on.

        Args:
            extra: An `ArmRequest`: who becomes the commander, and in which workspace.
            now_ns: Any monotonic clock, for the lease.

        Raises:
            CommandRefusedError: Somebody else commands, the state does not allow it, the robot
                is not ready, or the workspace cannot be granted.
        """
        controller, lease = self._controller, self._controller.lease
        request = ArmRequest.decode(extra)
        controller.check_lease(now_ns)
        if controller.state in (ServerState.STOPPING, ServerState.FAULT):
            raise CommandRefusedError(
                f"the robot server is {controller.state.value} ({controller.machine.reason}); "
                "stop it first (skewmi stop acknowledges a fault)"
            )
        gid, gripper, workspace = request.gid, request.gripper, request.workspace or TASK
        if controller.state in ACCEPTS_COMMANDS and gid and gid == lease.holder:
            if workspace != lease.workspace:
                self._check_workspace(workspace)
            controller.refusals.begin()
            lease.workspace = workspace
            lease.gripper_holder = gripper or lease.gripper_holder
            lease.extend(now_ns)
            return
        missing = controller.not_ready()
        if missing is not None:
            raise CommandRefusedError(f"the robot is not ready: {missing}")
        lease.check_free(now_ns)
        self._check_workspace(workspace)
        lease.open(now_ns)
        if controller.state is ServerState.DISARMED:
            self._activate()
        controller.refusals.begin()
        lease.holder, lease.gripper_holder = gid or None, gripper or None
        lease.workspace = workspace
        # The arm may have sagged or been pushed while disarmed: hold where it is commanded.
        where = "" if workspace == TASK else f" in the {workspace} workspace"
        controller.fire(ServerEvent.ARM, f"armed by {gid.hex()[:8] or 'a service call'}{where}")

    def stop(self, who: str) -> None:
        """Brake along the accepted plan's tail, then disarm; at rest, acknowledge a fault.

        Args:
            who: Told in the reason; what cannot be printed, and more than a line of it, is not.

        Raises:
            CommandRefusedError: In fault, and the arm has not come to rest yet.
        """
        controller = self._controller
        self.stops += 1
        if controller.state is ServerState.FAULT:
            if not controller.at_rest:
                raise CommandRefusedError(
                    f"in fault ({controller.machine.reason}), and the arm has yet to come to rest: "
                    "stop again to acknowledge it"
                )
            if controller.arm_motion.state is not None:
                # The arm may be far from its command: hold it there, do not jerk it back.
                controller.reseed(controller.arm_motion.measured)
        controller.end(ServerEvent.STOP, f"stop asked for by {printable(who)}")

    def brake(self, who: str) -> None:
        """As `stop`, but a fault stays: for who cannot be told apart from anybody else.

        Args:
            who: As in `stop`.
        """
        self.stops += 1
        if self._controller.state is not ServerState.FAULT:
            self._controller.end(ServerEvent.STOP, f"stop asked for by {printable(who)}")

    def disarm(self, gids: bytes) -> None:
        """The commander gives the arm back: brake along the accepted plan's tail, then disarm.

        At rest or stopping already, and in fault, nothing changes.

        Args:
            gids: Of its publishers, 16 bytes each, that of chunks first.

        Raises:
            CommandRefusedError: Somebody else commands.
        """
        if self._controller.state not in ACCEPTS_COMMANDS:
            return
        gid, holder = gids[:16], self._controller.lease.holder
        if holder is None or gid != holder:
            raise CommandRefusedError(
                f"{gid.hex()[:8] or 'the caller'} is not the commander "
                f"({'none yet' if holder is None else holder.hex()[:8]}); anybody may stop the "
                "arm (skewmi stop)"
            )
        self._controller.end(ServerEvent.DISARM, f"disarmed by its commander {gid.hex()[:8]}")

    def _check_workspace(self, name: str) -> None:
        """Whether a workspace can be granted now.

        Raises:
            CommandRefusedError: There is none of that name, the arm moves, or the scene is open.
        """
        controller, scene = self._controller, self._backend.scene
        if name not in controller.workspaces:
            raise CommandRefusedError(
                f"no workspace {printable(name)!r} before this robot's scene; there are: "
                f"{', '.join(controller.workspaces)}"
            )
        if name != controller.lease.workspace:
            # What was sent last may go on resting for a while.
            controller.arm_motion.drop_what_has_not_begun()
        if name != controller.lease.workspace and not controller.at_rest:
            raise CommandRefusedError("the arm is moving; another workspace is granted at rest")
        if name != TASK and scene is not None:
            check_scene_is_shut(scene)

    def _activate(self) -> None:
        try:
            self._backend.activate()
        except CommandRefusedError:
            self._controller.lease.close()
            raise

    def reset_scene(self, seed: int) -> None:
        """Put scene and arm back to the start of an episode.

        Raises:
            CommandRefusedError: The arm is moving, somebody commands it, or the scene is real.
        """
        controller, scene, lease = self._controller, self._backend.scene, self._controller.lease
        if scene is None:
            raise CommandRefusedError(f"the robot {self._backend.name!r} has no scene to reset")
        if not controller.at_rest:
            raise CommandRefusedError("the arm is moving; stop it before resetting the scene")
        if lease.holder is not None and lease.sequence > 0:
            raise CommandRefusedError(
                f"commander {lease.holder.hex()[:8]} works in the scene; reset it before its "
                "first trajectory, or once it has disarmed"
            )
        controller.reseed(scene.reset(seed))

    def check_gripper(self, size: int, gid: bytes, sequence: int) -> None:
        """What can be said of a gripper command without reading it.

        Args:
            size: Of the message, bytes.
            gid: Who published it.
            sequence: Its number, counted by the publisher.

        Raises:
            CommandRefusedError: Not armed, another commander, an old one, or too long.
        """
        self._controller.check_accepting()
        self._controller.lease.check_gripper(gid, sequence)
        check_size(size, MAX_GRIPPER_BYTES)

    def follow_gripper(self, command: JointStates, gid: bytes, sequence: int | None = None) -> None:
        """`open_gripper` for a command as it was received.

        A robot in lock-step waits for the command's time: what arrives on the way to it would else
        move the fingers sooner or later from one run to the next.

        Raises:
            CommandRefusedError: Not this gripper's joint, or not made just now; or as there.
        """
        finger = yumi.finger_names("right")[0]
        fingers = (finger,) if finger in self._backend.state_names else ()
        if not fingers or command.names != fingers:
            got = ", ".join(command.names[:5]) or "none"
            raise CommandRefusedError(
                f"one opening, that of {', '.join(fingers) or 'no gripper'}, is expected; got {got}"
            )
        controller, opening = self._controller, float(command.position[0])
        check_fresh(command.stamp_ns, controller.clock_ns)
        if not self._backend.lock_step or command.stamp_ns <= controller.clock_ns:
            self.open_gripper(opening, gid, sequence)
            return
        controller.check_accepting()
        controller.lease.check_gripper(gid, sequence)
        check_opening(opening)
        self._openings.append((command.stamp_ns, gid, opening))
        controller.lease.renew_gripper(gid, sequence)

    def move_fingers(self) -> None:
        """Carry out the gripper commands whose time has come; call it in every cycle.

        Those of a commander who is none any more are forgotten, however soon the next one came.
        """
        controller = self._controller
        accepting = controller.state in ACCEPTS_COMMANDS
        for _ in range(len(self._openings)):
            at_ns, gid, opening = self._openings.popleft()
            if not accepting or gid != controller.lease.gripper_holder:
                continue
            if at_ns > controller.clock_ns:
                self._openings.append((at_ns, gid, opening))
                continue
            try:
                self._backend.open_gripper(opening)
            except CommandRefusedError as error:
                controller.refusals.note(Refusal(f"gripper: {error}", of_commander=True))

    def open_gripper(self, opening: float, gid: bytes, sequence: int | None = None) -> None:
        """Move the fingers, for the commander only.

        Args:
            opening: Travel of each finger from closed, m.
            gid: Who published it.
            sequence: Its number, counted by the publisher; None is not looked at.

        Raises:
            CommandRefusedError: Not armed, another commander, or not an opening.
        """
        lease = self._controller.lease
        self._controller.check_accepting()
        lease.check_gripper(gid, sequence)
        self._backend.open_gripper(opening)
        lease.renew_gripper(gid, sequence)
