"""The matrix: every fault, and what must come of it in every phase."""

from __future__ import annotations

import signal

from fault_cell import (
    AS_ASKED,
    DISARMED,
    FAULT,
    GOES_ON,
    RESTS_GOES_ON,
    STOPPED,
    Fault,
    Phase,
)
from fault_chunks import (
    breaching,
    far_away,
    left_arm,
    one_nan,
    one_point,
    six_joints,
    sorted_names,
    too_many_points,
    without_tail,
)
from fault_egm import EGM_ROWS
from fault_kinds import (
    Change,
    Inject,
    changed,
    clock_jump,
    cut_short,
    cut_short_late,
    delayed,
    disarmed,
    doubled,
    frozen,
    gripper_flood,
    hard_to_read,
    hard_to_read_late,
    intruder,
    killed,
    link_cut,
    link_silent,
    lost,
    planted,
    refused_unheard,
    reordered,
    restarted,
    sent_late,
    silent,
    wrong_state,
)
from fault_rows import ASKED, PATIENT_MS, DoesNotApply, Expect, Row
from fault_strangers import STRANGERS

from skewmi.deploy.wire.topics import YUMI_JOINT_STATES, YUMI_SCENE_STATES

REFUSED = Expect(AS_ASKED, "arm it first")
NOT_PLANNED = DoesNotApply("nothing is planned then")
AFTER_LEASE = "run again 2 s after the last command; at once after `skewmi stop`"


def _state_row(name: str, inject: Inject, moving: Expect) -> Row:
    return Row(Fault(name, inject, inject), moving, moving, ASKED)


def _stream_row(
    name: str, inject: Inject, start: Expect, running: Expect, hardest: Phase = Phase.RUNNING
) -> Row:
    return Row(Fault(name, inject), start, running, ASKED, hardest)


def _chunk_row(name: str, change: Change, says: str) -> Row:
    fault = Fault(name, changed(change), sent_late(change), lock_step=True)
    return Row(fault, Expect(STOPPED, says), Expect(STOPPED, says), REFUSED)


def _planned_row(kind: str, start: str, running: str, hardest: Phase = Phase.RUNNING) -> Row:
    fault = Fault(f"planned: {kind}", planted, plant=kind, lock_step=True)
    return Row(fault, Expect(STOPPED, start), Expect(STOPPED, running), NOT_PLANNED, hardest)


def _clock_row(name: str, offset_s: int) -> Row:
    inject = clock_jump(offset_s)
    fault = Fault(name, inject, inject, clock_jump_s=offset_s, lead_ms=PATIENT_MS)
    return Row(fault, Expect(GOES_ON), Expect(GOES_ON), ASKED)


STALE_JOINTS = Expect(STOPPED, "no new joint state for")
STALE_SCENE = Expect(STOPPED, "the scene state is")
NOT_FINITE = Expect(FAULT, "joint states hold positions that are not finite")
SPLICE = Expect(RESTS_GOES_ON, "splice: ")
NOT_THERE = Expect(STOPPED, "rad from the start configuration")
REPEATED = Expect(STOPPED, "repeated or overtaken")
LATE = Expect(STOPPED, "in the past of the robot server's clock")
LATE_STARTS = Expect(STOPPED, "start motions came too late")
OVERRUN = Expect(RESTS_GOES_ON, "in the past of the robot server's clock")
GONE = Expect(FAULT, "then no answer from /yumi/")
LEASE_ENDS = Expect(DISARMED, "no command for 2 s")
# The run ends in a fault if the server is gone before it has answered that the arm rests.
ENDED = Expect(f"{STOPPED} or {FAULT}", "stop asked for by the end of the robot server")
INTRUDER = Expect(GOES_ON, "is not the commander")
SKEWMI_STOP = Expect(STOPPED, "stop asked for by skewmi stop")
BOX = "distance outside the workspace"

GROUPS: dict[str, tuple[Row, ...]] = {
    "What the session sees": (
        _state_row("joint states stop coming", silent(YUMI_JOINT_STATES), STALE_JOINTS),
        _state_row("the same joint state again and again", frozen(YUMI_JOINT_STATES), STALE_JOINTS),
        _state_row("joint states with a NaN", wrong_state, NOT_FINITE),
        _state_row("scene states stop coming", silent(YUMI_SCENE_STATES), STALE_SCENE),
        _state_row("the same scene state again and again", frozen(YUMI_SCENE_STATES), STALE_SCENE),
    ),
    "Strangers on the robot server's topics": STRANGERS,
    "Chunks on their way": (
        _stream_row("1 chunk lost", lost(1), SPLICE, SPLICE),
        _stream_row("5 chunks lost", lost(5), SPLICE, SPLICE),
        _stream_row("20 chunks lost", lost(20), SPLICE, SPLICE),
        _stream_row("50 chunks lost", lost(50), NOT_THERE, SPLICE),
        _stream_row("every chunk twice", doubled, REPEATED, REPEATED),
        _stream_row("two chunks in the wrong order", reordered, SPLICE, SPLICE),
        _stream_row("chunks delayed by 5 ms", delayed(0.005), Expect(GOES_ON), Expect(GOES_ON)),
        _stream_row("chunks delayed by 50 ms", delayed(0.05), LATE_STARTS, LATE, Phase.START),
        _stream_row("chunks delayed by 500 ms", delayed(0.5), LATE_STARTS, LATE, Phase.START),
    ),
    "What a chunk says": (
        Row(
            Fault("starts 0.3 rad away", changed(far_away), sent_late(far_away)),
            Expect(RESTS_GOES_ON, "splice: position"),
            Expect(RESTS_GOES_ON, "splice: position"),
            REFUSED,
        ),
        _chunk_row("a single point", one_point, "a chunk has 2 to 500 points"),
        _chunk_row("501 points", too_many_points, "a chunk has 2 to 500 points"),
        _chunk_row("six joints", six_joints, "in this order"),
        Row(
            Fault("bytes cut short", cut_short, cut_short_late, lock_step=True),
            Expect(STOPPED, "malformed trajectory_msgs/msg/JointTrajectory"),
            Expect(STOPPED, "malformed trajectory_msgs/msg/JointTrajectory"),
            Expect(AS_ASKED, "arm it first"),
        ),
        Row(
            Fault("5,415 empty points", hard_to_read, hard_to_read_late, lock_step=True),
            Expect(STOPPED, "points of different forms"),
            Expect(STOPPED, "points of different forms"),
            REFUSED,
        ),
        _chunk_row("joints in another order", sorted_names, "in this order"),
        _chunk_row("joints of the other arm", left_arm, "in this order"),
        _chunk_row("a NaN", one_nan, "positions hold values that are not finite"),
        _chunk_row("does not end at rest", without_tail, "a chunk must end at rest"),
    ),
    "A chunk on the link breaks a limit (the robot server refuses)": tuple(
        _chunk_row(kind, breaching(kind), says)
        for kind, says in (
            ("position", "joint position"),
            ("velocity", "joint velocity"),
            ("acceleration", "joint acceleration"),
            ("jerk", "joint jerk"),
            ("tool speed", "tool speed"),
            ("workspace box", BOX),
        )
    ),
    "What is lost of an answer": (
        Row(
            Fault(
                "a limit is broken, the status that says so is lost",
                refused_unheard(breaching("jerk")),
                sent_late(breaching("jerk")),
                lock_step=True,
            ),
            Expect(STOPPED, "joint jerk"),
            Expect(STOPPED, "joint jerk"),
            REFUSED,
        ),
    ),
    "The planner breaks a limit (the session does not send it)": (
        _planned_row("position", "joint position", "joint position"),
        _planned_row("velocity", "joint velocity", "joint velocity"),
        _planned_row("acceleration", "joint acceleration", "joint acceleration"),
        _planned_row("jerk", "joint jerk", "joint jerk"),
        _planned_row("tool speed", "tool speed", "tool speed"),
        _planned_row("workspace box", BOX, BOX),
        _planned_row("torque", "joint torque", "joint torque"),
        _planned_row("self-collision", "clearance", BOX, Phase.START),
    ),
    "Time": (
        _clock_row("wall clocks jump by +1 h", 3600),
        _clock_row("wall clocks jump by -1 h", -3600),
        Row(
            Fault("the policy takes 1 s", planted, plant="stall"),
            DoesNotApply("no policy is asked then"),
            Expect(RESTS_GOES_ON, "missed"),
            ASKED,
        ),
        Row(
            Fault("a cycle of the planner takes 60 ms", planted, plant="overrun"),
            OVERRUN,
            OVERRUN,
            ASKED,
        ),
    ),
    "Programs and links": (
        Row(
            Fault("session killed (-9)", killed, killed),
            LEASE_ENDS,
            LEASE_ENDS,
            Expect(DISARMED, "disarmed by its commander"),
            go_on=AFTER_LEASE,
        ),
        Row(
            Fault(
                "robot server killed (-9) and started again",
                restarted(signal.SIGKILL, 0.06),
                restarted(signal.SIGKILL),
            ),
            GONE,
            GONE,
            GONE,
            go_on="run again",
        ),
        Row(
            Fault(
                "robot server ended and started again",
                restarted(signal.SIGTERM, 0.06),
                restarted(signal.SIGTERM),
            ),
            ENDED,
            ENDED,
            GONE,
        ),
        Row(
            Fault("link silent for 1 s", link_silent, link_silent, proxied=True),
            STALE_JOINTS,
            STALE_JOINTS,
            ASKED,
        ),
        Row(
            Fault("link cut for 1 s", link_cut, link_cut, proxied=True),
            GONE,
            GONE,
            GONE,
            go_on=AFTER_LEASE,
        ),
        Row(
            Fault("a second commander", intruder, intruder, lead_ms=PATIENT_MS),
            INTRUDER,
            INTRUDER,
            REFUSED,
            go_on="nothing to do",
        ),
        Row(
            Fault(
                "a stranger's gripper messages of 130 kB at 100 Hz",
                gripper_flood,
                gripper_flood,
                lead_ms=PATIENT_MS,
            ),
            Expect(GOES_ON, "is not the gripper's commander"),
            Expect(GOES_ON, "is not the gripper's commander"),
            ASKED,
            go_on="nothing to do",
        ),
        Row(
            Fault("somebody runs `skewmi stop`", disarmed, disarmed),
            SKEWMI_STOP,
            SKEWMI_STOP,
            Expect(AS_ASKED, "exit 0"),
        ),
    ),
    "The controller and its link": EGM_ROWS,
}
ROWS = tuple(row for rows in GROUPS.values() for row in rows)
