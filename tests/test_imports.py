"""Who may import whom, checked in fresh interpreters: the folder tree is the architecture."""

from __future__ import annotations

import subprocess
import sys

import pytest

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
    "skewmi.cli.main": ("torch", "mujoco", "zenoh", "skewmi.sim", "skewmi.train"),
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
    of_runs = ("skewmi.evaluation.figures", "skewmi.evaluation.learning")
    loaded = loaded_modules("skewmi.evaluation", of_runs)
    assert sorted(loaded & {"torch", "skewmi.train"}) == []


@pytest.mark.parametrize("module", ["ray_engine", "tables"])
def test_readers_of_sweeps_and_processes_of_clusters_need_no_torch(module: str) -> None:
    loaded = loaded_modules(f"skewmi.sweep.{module}", ())
    assert sorted(loaded & {"torch", "skewmi.train"}) == []


def test_simulated_robot_server_runs_without_torch() -> None:
    loaded = loaded_modules("skewmi.deploy.robot", ())
    assert sorted(loaded & {"torch", "skewmi.train", "skewmi.export"}) == []
