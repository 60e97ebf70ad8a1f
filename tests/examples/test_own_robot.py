"""A robot of another package: offered by name, and as safe behind the server as ours."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from lone_robot import LoneRobot

from skewmi.deploy.motion.start_motion import StartMotion
from skewmi.deploy.robot import backends
from skewmi.deploy.robot.backends import GROUP, BackendOptions, make_backend, with_those_of
from skewmi.deploy.robot.process import free_port
from skewmi.errors import ConfigurationError
from skewmi.robot_models import limits as joint_limits
from skewmi.robot_models import yumi
from skewmi.trajectory import CYCLE_NS, GRID_NS

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "own_robot"
LAB = joint_limits.profile("lab")
HOME = np.array(yumi.HOME["right"])
OURS = b"a" * 16


def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("own_robot", EXAMPLE / "own_robot.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_follows_the_plan_late_and_comes_to_rest_where_it_should() -> None:
    module = example()
    away = HOME + np.linspace(0.2, -0.2, 7)
    robot = LoneRobot(module.make(BackendOptions(lock_step=True)), LAB)
    motion = StartMotion(HOME, away, LAB)
    robot.requests.arm(OURS, 0)
    begin_ns, sent, distance = 5 * CYCLE_NS, 0, 0.0
    while robot.controller.clock_ns < begin_ns + round(1e9 * (motion.trajectory.duration_s + 0.3)):
        if sent < motion.cycles and robot.controller.clock_ns >= begin_ns + (sent - 1) * CYCLE_NS:
            tick = (begin_ns + sent * CYCLE_NS) // GRID_NS
            assert robot.controller.receive(
                robot.payload(motion.chunk(sent), tick), OURS, sent + 1, 0
            )
            sent += 1
        robot.run(1)
        distance = max(distance, float(np.abs(robot.measured[:7] - robot.targets[-1].q).max()))
    # A first-order lag of 20 ms is behind by at most that time's way at the largest velocity.
    assert 0.0 < distance <= (module.LAG_S + 2 * GRID_NS / 1e9) * float(LAB.velocity.max())
    np.testing.assert_allclose(robot.measured[:7], away, atol=1e-5)


def test_names_of_ours_cannot_be_taken_and_clashes_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = [
        EntryPoint("sim", "stranger:make", GROUP),
        EntryPoint("arm", "one:make", GROUP),
        EntryPoint("arm", "two:make", GROUP),
        EntryPoint("arm", "one:make", GROUP),  # the same package, found twice
        EntryPoint("gone", "no_such_module:make", GROUP),
    ]
    found = with_those_of(points)
    assert found["sim"] == with_those_of([])["sim"]
    assert found["arm"] == ("one:make", "two:make")
    monkeypatch.setattr(backends, "BACKENDS", found)
    with pytest.raises(ConfigurationError, match="2 robots are called 'arm': one:make, two:make"):
        make_backend("arm", BackendOptions())
    with pytest.raises(ConfigurationError, match="'gone' cannot be loaded from no_such_module"):
        make_backend("gone", BackendOptions())


@pytest.mark.slow
def test_its_package_is_served_by_name(tmp_path: Path) -> None:
    source = shutil.copytree(EXAMPLE, tmp_path / "source")  # a build leaves files in its source
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    site = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--target", str(site), str(source)],
        check=True,
        capture_output=True,
    )
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    skewmi = [sys.executable, "-m", "skewmi.cli.main"]
    told = subprocess.run([*skewmi, "list", "--json"], env=environment, capture_output=True)
    assert json.loads(told.stdout)["robots"]["own_robot"] == "of another package"
    where = f"tcp/127.0.0.1:{free_port()}"
    serve = [*skewmi, "robot", "--backend", "own_robot", "--listen", where, "--json"]
    with subprocess.Popen(
        [*serve, "--end-with-input"],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as robot:
        assert robot.stdout is not None
        assert robot.stdin is not None
        description = json.loads(robot.stdout.readline())
        robot.stdin.close()
        assert robot.wait(60) == 0
    assert (description["backend"], description["ready"]) == ("own_robot", True)
