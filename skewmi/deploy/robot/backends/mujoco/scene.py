"""The simulated scene before the simulated robot."""

from __future__ import annotations

from collections.abc import Mapping

from skewmi.deploy.robot.backend import SceneState
from skewmi.deploy.robot.backends.mujoco.scene_geometry import (
    Standing,
    scene_geometry,
    scene_poses,
)
from skewmi.deploy.robot.backends.mujoco.simulation import ArmSimulation
from skewmi.deploy.wire.simulation_status import encode_poses
from skewmi.policy_io import Array, Workspace
from skewmi.sim.arm.scene import workspace_of


class MujocoScene:
    """A task's scene in MuJoCo; satisfies `Scene`.

    Args:
        simulation: That it is a part of.
    """

    simulated = True
    resettable = True

    def __init__(self, simulation: ArmSimulation) -> None:
        spec = simulation.spec
        self._simulation = simulation
        self.task = simulation.task
        self.layout_hashes = tuple(layout.hash() for _, layout in spec.layouts())
        self.workspace: Workspace = workspace_of(simulation.layout)
        self.known_box = simulation.scene.box
        self._stands = Standing(simulation.scene.base, simulation.scene.task.box_body)
        geometry = scene_geometry(simulation.nominal_model, spec.scene_fields, self._stands)
        self.shapes_json = geometry.to_json()
        self._note_poses()

    def state(self) -> SceneState:
        """Measured joints of the scene."""
        return self._simulation.scene_state()

    def publishers(self) -> tuple[bytes, ...]:
        """The robot server publishes its states itself."""
        return ()

    def contact(self) -> Mapping[str, float]:
        """Largest forces on hand and arm, tilt and excess of the box since the last reset."""
        return self._simulation.contact.summary()

    def reset(self, seed: int) -> Array:
        """Scene as the task begins, arm at its start configuration, as `seed` varies them."""
        q = self._simulation.reset(seed)
        self._note_poses()
        return q

    def _note_poses(self) -> None:
        simulation = self._simulation
        poses = scene_poses(simulation.scene.model, simulation.nominal_model, self._stands)
        self.poses_json = encode_poses(poses)
        """Where the scene stands since the last reset, see `simulation_status.SCENE_POSES`."""
