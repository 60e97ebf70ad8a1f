"""Who may import whom, checked in fresh interpreters: the folder tree is the architecture."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from skewmi.extras import MODULES

OF_EXTRAS = tuple(module for modules in MODULES.values() for module in modules)

FORBIDDEN: dict[str, tuple[str, ...]] = {
    "skewmi.errors": ("numpy", "mujoco", "torch"),
    "skewmi.policy_io": ("mujoco", "pinocchio", "torch", "onnxruntime", "zenoh", "skewmi.sim"),
    "skewmi.success": ("mujoco", "pinocchio", "torch", "onnxruntime", "zenoh", "skewmi.sim"),
    "skewmi.command_integrator": (
        "mujoco",
        "pinocchio",
        "torch",
        "zenoh",
        "skewmi.sim",
        "skewmi.deploy",
    ),
    "skewmi.box_frame": ("torch", "pinocchio", "mink", "zenoh", "skewmi.sim", "skewmi.deploy"),
    "skewmi.robot_models": (
        "torch",
        "pinocchio",
        "mink",
        "zenoh",
        "skewmi.policy_io",
        "skewmi.sim",
        "skewmi.train",
        "skewmi.deploy",
    ),
    "skewmi.calibration": (
        "torch",
        "scipy",
        "pinocchio",
        "zenoh",
        "skewmi.policy_io",
        "skewmi.sim",
        "skewmi.train",
        "skewmi.deploy",
    ),
    "skewmi.calibration.calibration_file": ("mujoco", "skewmi.robot_models.mjcf"),
    "skewmi.sim.arm": ("gymnasium", "skewmi.sim.tasks"),
    "skewmi.sim": (
        "torch",
        "zenoh",
        "skewmi.train",
        "skewmi.export",
        "skewmi.deploy",
        "skewmi.calibration.excitation",
        "skewmi.calibration.servo_identification",
    ),
    "skewmi.train": (
        "mujoco",
        "zenoh",
        "skewmi.robot_models",
        "skewmi.sim",
        "skewmi.export",
        "skewmi.deploy",
    ),
    "skewmi.sweep": ("mujoco", "zenoh", "ray", "skewmi.sim", "skewmi.export", "skewmi.deploy"),
    "skewmi.export": ("zenoh", "mujoco", "skewmi.sim", "skewmi.robot_models"),
    "skewmi.deploy": (
        "torch",
        "onnx",
        "skewmi.sim",
        "skewmi.train",
        "skewmi.export",
        "skewmi.calibration.excitation",
        "skewmi.calibration.servo_identification",
    ),
    "skewmi.evaluation": ("tyro", "skewmi.sim", "skewmi.export", "skewmi.cli"),
    "skewmi.cli.main": ("numpy", *OF_EXTRAS, "mujoco", "zenoh", "skewmi.sim", "skewmi.train"),
}
"""Package -> what must not be loaded after importing all of it (`cli.main`: only itself)."""

MAY_IMPORT_SIM = ("skewmi.deploy.robot",)
"""The simulated robot runs the simulation; nothing else in deploy may."""

IMPORT_ALL = """
import importlib, pkgutil, sys
name, *skip = sys.argv[1:]
module = importlib.import_module(name)
for found in pkgutil.walk_packages(getattr(module, "__path__", []), name + "."):
    if not any(found.name == s or found.name.startswith(s + ".") for s in skip):
        importlib.import_module(found.name)
print("\\n".join(sys.modules))
"""


def loaded_modules(package: str, skip: tuple[str, ...]) -> frozenset[str]:
    result = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL, package, *skip],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return frozenset(result.stdout.split())


@pytest.mark.parametrize("package", FORBIDDEN)
def test_package_imports_only_what_the_architecture_allows(package: str) -> None:
    loaded = loaded_modules(package, MAY_IMPORT_SIM if package == "skewmi.deploy" else ())
    assert package in loaded
    assert sorted(loaded.intersection(FORBIDDEN[package])) == []
    if package != "skewmi.cli.main":
        assert not any(name.startswith("skewmi.cli") for name in loaded), (
            "nobody imports the command line"
        )
        assert package == "skewmi.evaluation" or "skewmi.evaluation" not in loaded, (
            "only commands import evaluation"
        )


def test_only_pictures_of_runs_need_torch() -> None:
    of_runs = (
        "skewmi.evaluation.figures",
        "skewmi.evaluation.learning",
        "skewmi.evaluation.training_layout",
        "skewmi.evaluation.training_view",
    )
    loaded = loaded_modules("skewmi.evaluation", of_runs)
    assert sorted(loaded & {"torch", "skewmi.train"}) == []


@pytest.mark.parametrize("module", ["ray_engine", "tables"])
def test_readers_of_sweeps_and_processes_of_clusters_need_no_torch(module: str) -> None:
    loaded = loaded_modules(f"skewmi.sweep.{module}", ())
    assert sorted(loaded & {"torch", "skewmi.train"}) == []


def test_simulated_robot_server_runs_without_torch() -> None:
    loaded = loaded_modules("skewmi.deploy.robot", ())
    assert sorted(loaded & {"torch", "skewmi.train", "skewmi.export"}) == []


@pytest.mark.parametrize(
    "modules",
    [
        ("skewmi.cli.deploy", "skewmi.deploy.session.connect", "skewmi.deploy.recording.recorder"),
        ("skewmi.deploy.recording.recorder_process",),
        ("skewmi.deploy.robot.robot_process", "skewmi.deploy.robot.backends.mujoco.backend"),
        ("skewmi.cli.robot", "skewmi.deploy.robot.backends.egm.backend"),
    ],
    ids=["session", "recorder", "robot server", "bridge"],
)
def test_what_a_robots_computer_runs_starts_without_what_it_does_not_use(
    modules: tuple[str, ...],
) -> None:
    """Each costs a second or half a gigabyte there. scipy comes with mink's solvers."""
    code = (
        "import importlib, sys\n"
        "for name in sys.argv[1:]: importlib.import_module(name)\n"
        "from skewmi.sim import tasks\n"
        "tasks.find(tasks.default())\n"
        "print('\\n'.join(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *modules],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "MUJOCO_GL": "disabled"},
    )
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert sorted(loaded & {*OF_EXTRAS, "qpsolvers", "glfw", "imageio", "pandas"}) == []


def test_a_robot_that_is_started_reads_no_command_line() -> None:
    loaded = loaded_modules("skewmi.deploy.robot.robot_process", ())
    assert sorted(loaded & {"tyro", "rich", "mink", "mujoco", "onnxruntime"}) == []


def test_mink_can_still_solve() -> None:
    code = (
        "import sys\n"
        "from skewmi.deploy.motion.differential_ik import mink\n"
        "assert 'qpsolvers' not in sys.modules\n"
        "import qpsolvers\n"
        "assert mink.solve_ik.__globals__['qpsolvers'].Problem is qpsolvers.Problem"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
