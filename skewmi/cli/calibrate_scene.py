"""`skewmi calibrate scene`: touches the box, and says where it stands."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from skewmi.calibration.calibration_file import Calibration, read_calibration, write_calibration
from skewmi.calibration.calibration_use import require_robot
from skewmi.calibration.contact_watch import ContactWatch
from skewmi.calibration.known_prediction import prediction_of
from skewmi.calibration.scene_fit import Touch, fit_scene
from skewmi.calibration.scene_section import scene_section, scene_warnings, touch_of
from skewmi.calibration.scene_sources import read_marker, read_points
from skewmi.calibration.servo_model import ServoModel
from skewmi.cli import numbers
from skewmi.cli.calibrate_scene_result import FoundScene, merged, print_scene, scene_document
from skewmi.cli.interrupt import stop_on_signal
from skewmi.cli.robot_flags import require_motion_options
from skewmi.cli.scene_shapes import SceneBox, nominal_box
from skewmi.cli.scene_touches import TouchPlanner
from skewmi.cli.task_flags import variation_option
from skewmi.deploy.motion_link import JointMotionOptions
from skewmi.deploy.robot.description import RobotDescription, admitted
from skewmi.deploy.session.touch_plan import PlannedTouch
from skewmi.deploy.touch_motion import run_touches
from skewmi.deploy.wire.domain import ros_domain
from skewmi.errors import ConfigurationError
from skewmi.outputs import check_output
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models.servo import CONTACT_SERVO
from skewmi.sim import tasks

LARGEST_FORCE_LIMIT = 15.0
"""N."""


@dataclass(frozen=True)
class Scene:
    """Find where the box stands by touching its sides, and what its shut lid's sensor reads.

    The simulated robot is started if none is named. The hand touches three sides of the box twice
    each at 5 mm/s, and returns. Exit code 0 done, 1 stopped or not found, 2 bad input.
    """

    connect: str | None = None
    """Zenoh locator of a running `skewmi robot`, such as tcp/127.0.0.1:7447."""
    zenoh_config: Path | None = None
    """Zenoh configuration file that tells how to reach a running `skewmi robot`."""
    domain: int | None = None
    """ROS 2 domain, 0..232; by default ROS_DOMAIN_ID, else 0."""
    variation: str | None = None
    """What the simulated robot that is started is: a variation file or a bundled name."""
    lock_step: bool = False
    """Robot server and session wait for each other: as fast as possible and repeatable."""
    limits: str = "lab"
    """Joint limit profile: lab or careful."""
    lead_ms: float = 24.0
    """Time from a robot state to the motion that answers it, ms, a multiple of 4 in 8..100."""
    calibration: Path | None = None
    """What is known of the servos; its section is kept in what is written."""
    force_limit: float = 10.0
    """More than that, as estimated, ends the run, N, 1..15."""
    points: Path | None = None
    """Points of the box's sides instead of touching: CSV file with columns face, x, y, z."""
    marker: Path | None = None
    """A marker on the box instead of touching: YAML file."""
    out: Path = Path("calibration.yaml")
    """Calibration to write."""
    overwrite: bool = False
    """Replace an existing calibration."""
    json: bool = False
    """Print one JSON document on the last line."""


def run_scene(options: Scene) -> int:
    """Touch, solve, write, tell. Returns the exit code."""
    before = _checked(options)
    console = Console(stderr=True)

    def tell(text: str) -> None:
        console.print(text, highlight=False, markup=False)

    begun = datetime.now(UTC)
    if options.points is not None or options.marker is not None:
        found = _told(options)
    else:
        touched = _touched(options, before, tell)
        if isinstance(touched, int):
            return touched
        found = touched
    lid_bias, lid_sigma = (None, 0.0) if found.lid is None else found.lid
    section = scene_section(found.fit, lid_bias, lid_sigma)
    known = before is not None and (before.servo is not None or before.egm is not None)
    warnings = scene_warnings(found.fit, found.faces, known or found.report is None)
    written = merged(before, section, found, warnings, begun)
    write_calibration(options.out, written, overwrite=options.overwrite)
    seconds = (datetime.now(UTC) - begun).total_seconds()
    document = scene_document(options.out, section, found, seconds)
    if options.json:
        print(json.dumps(document))
    else:
        print_scene(document, warnings, Console())
    return 0


def _checked(options: Scene) -> Calibration | None:
    joint_limits.profile(options.limits)
    numbers.require("--force-limit", options.force_limit, 1.0, LARGEST_FORCE_LIMIT)
    if options.points is not None and options.marker is not None:
        raise ConfigurationError("--points and --marker say the same: give one of them")
    require_motion_options(
        options.lead_ms, options.variation, options.connect, options.zenoh_config
    )
    inputs = [options.points, options.marker, options.zenoh_config]
    check_output(options.out, overwrite=options.overwrite, inputs=inputs)
    return None if options.calibration is None else read_calibration(options.calibration)


def _told(options: Scene) -> FoundScene:
    """From a file, for the box of the default task; nothing moves."""
    box = nominal_box()
    if options.marker is not None:
        middle = next(iter(box.faces.values())).middle
        return FoundScene(read_marker(options.marker, middle), (), None, None)
    assert options.points is not None
    touches = read_points(options.points, box.faces)
    return FoundScene(fit_scene(touches), [t.face.name for t in touches], None, None)


def _touched(
    options: Scene, before: Calibration | None, tell: Callable[[str], None]
) -> FoundScene | int:
    """By touching; the exit code if that was stopped or did not come to a result."""
    model = ServoModel(CONTACT_SERVO.kd / CONTACT_SERVO.kp)
    prediction = prediction_of(before, model, CONTACT_SERVO)
    watch = ContactWatch(prediction)
    boxes: list[SceneBox] = []

    def plan(described: RobotDescription) -> list[PlannedTouch]:
        if before is not None:
            require_robot(before, described.backend, described.egm.get("speed_share"))
        if described.box is not None:
            raise ConfigurationError(
                f"the robot server knows where the box stands ({described.box.words}); to find it "
                "again, start the robot server with a calibration that has no section scene"
            )
        tell("planning the touches")
        limits = admitted(joint_limits.profile(options.limits), described)
        planner = TouchPlanner(described, limits, prediction.servo.parameters, tell)
        boxes.append(planner.box)
        return planner.touches()

    task = tasks.default()
    motion_options = JointMotionOptions(
        task=task,
        connect=options.connect,
        zenoh_config=options.zenoh_config,
        variation=variation_option(task, options.variation).get("variation"),
        domain=ros_domain(options.domain),
        lock_step=options.lock_step,
        limits=options.limits,
        lead_ms=options.lead_ms,
    )
    with stop_on_signal() as stop:
        report = run_touches(
            plan, watch, motion_options, options.force_limit, stop=stop, on_event=tell
        )
    if report.stops or report.interrupted:
        for text in report.stops:
            tell(text)
        if options.json:
            print(json.dumps({"stops": report.stops, "largest_force_n": report.largest_force}))
        return 130 if report.interrupted else 1
    try:
        touches = [_touch(boxes[0], reading) for reading in report.readings]
        fit = fit_scene(touches)
    except ConfigurationError as error:
        tell(str(error))
        if options.json:
            print(json.dumps({"stops": [str(error)], "largest_force_n": report.largest_force}))
        return 1
    lid = boxes[0].lid
    read = None if lid not in report.scene else (report.scene[lid], report.scene_scatter[lid])
    return FoundScene(fit, [touch.face.name for touch in touches], report, read)


def _touch(box: SceneBox, reading: Any) -> Touch:
    face = box.faces[reading.touch.face]
    return touch_of(face, reading.touch.top, reading.q, reading.opening)
