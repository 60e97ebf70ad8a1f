"""A variation at work in a batch: models that differ, late servos, sensors with errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from mujoco.batch import Batch

from skewmi.policy_io import Array
from skewmi.sim.arm.definition import SUBSTEPS
from skewmi.sim.arm.drive import Play, Stribeck, delay_steps
from skewmi.sim.arm.model_fields import model_fields
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.arm.sensors import SensorErrors, random_stream, sensors_err
from skewmi.sim.arm.variation_keys import OPENING_ERROR, STICTION_SCALE
from skewmi.sim.variation import ModelVariation, VariationSample


class BatchVariation:
    """Draws a variation's values for every simulation of a batch and applies them.

    Args:
        variation: Not the nominal one.
        scene: Gives the nominal model and the addresses.
        batch: Of the scene's physics model.
        seed: Of the environment.

    Attributes:
        variation: As given.
        sample: Drawn at the last `start`.
        sticks: Whether joints at rest have more friction than moving ones, so that `rub` has to
            be called before every substep.
    """

    def __init__(self, variation: ModelVariation, scene: ArmScene, batch: Batch, seed: int) -> None:
        self.variation = variation
        self.sample = VariationSample(batch.nsim, {})
        self._scene, self._batch = scene, batch
        self._ideal_sensors = not sensors_err(variation, scene.task)
        self.sticks = variation.has(STICTION_SCALE)
        self.seed(seed)

    def seed(self, seed: int) -> None:
        """Restart the random stream from the environment's seed."""
        self._rng = random_stream(self.variation, seed)

    def start(self, qpos: Array, controls: Array) -> None:
        """Draw new values; write them into the models and into the start of the episode.

        Args:
            qpos: Nominal start, changed. Shape (n, nq).
            controls: That hold it, changed. Shape (n, nu).
        """
        n = self._batch.nsim
        self.sample = sample = self.variation.sample(self._rng, n)
        keys = self._scene.task.variations.keys
        fields = model_fields(self._scene.physics_model, keys, sample)
        if self.sticks:
            # Changed in every substep: an episode starts from what it is in motion.
            sliding = fields.write("dof_frictionloss")[:, self._scene.arm_dof]
            self._stribeck = Stribeck(sample, sliding)
        for name, values in fields.values.items():
            self._batch.expand(name)[:] = values
        if fields.needs_set_const:
            self._batch.set_const()
        self._sensors = SensorErrors(sample, self._scene.task)
        self._opening_error = sample.get(OPENING_ERROR)
        qpos[:, self._scene.finger_qpos] += self._opening_error[:, None]
        controls[:, self._scene.finger_ctrl] += self._opening_error
        # The targets of the last step, then those of the one to come: row SUBSTEPS + k - delay
        # is what the servos have got to at substep k.
        self._path = np.repeat(controls[:, None, :], 2 * SUBSTEPS, axis=1)
        whole, fraction = delay_steps(sample)
        rows = np.arange(SUBSTEPS, 2 * SUBSTEPS) - whole[:, None]
        first = 2 * SUBSTEPS * np.arange(n)[:, None]
        self._rows = rows + first
        self._fraction = fraction[:, None, None] if fraction.any() else None
        # The longest delay reaches back to row 0, with nothing of the one before it.
        self._older_rows = np.maximum(rows - 1, 0) + first
        self._play = Play.of(sample, controls[:, self._scene.arm_ctrl])

    def rub(self) -> None:
        """Give the joints the friction that they have at their present speed."""
        dofs = self._scene.arm_dof
        velocity = self._batch.bind("qvel")[:, dofs]
        self._batch.expand("dof_frictionloss")[:, dofs] = self._stribeck.friction(velocity)

    def begin_step(self) -> None:
        """The targets of the coming step become those of the last one."""
        self._path[:, :SUBSTEPS] = self._path[:, SUBSTEPS:]
        if self._play is not None:
            self._play.keep()

    def delay(self, targets: Array, out: Array) -> None:
        """What the servos get of a step's targets; may be called again if these change.

        Args:
            targets: As commanded. Shape (n, SUBSTEPS, nu).
            out: What the servos get, of the same shape.
        """
        self._path[:, SUBSTEPS:] = targets
        self._path[:, SUBSTEPS:, self._scene.finger_ctrl] += self._opening_error[:, None]
        flat = self._path.reshape(-1, targets.shape[-1])
        # Every row exists; "clip" only spares a buffer.
        np.take(flat, self._rows, axis=0, out=out, mode="clip")
        if self._fraction is not None:
            out += self._fraction * (flat[self._older_rows] - out)
        if self._play is not None:
            arm = self._scene.arm_ctrl
            out[:, :, arm] = self._play.follow(out[:, :, arm])

    def measured(self, arm_q: Array) -> Array:
        """Joint angles as the sensors have them but for their noise; both shape (n, 7), rad."""
        offset = self._sensors.joint_offset
        return arm_q if offset is None else arm_q + offset

    def sensor_errors(self) -> tuple[Array, Array] | None:
        """Errors of one reading, see `SensorErrors.draw`; None if every sensor is ideal."""
        return None if self._ideal_sensors else self._sensors.draw(self._rng)

    def random_state(self) -> Mapping[str, Any]:
        """JSON-serialisable state of the random stream."""
        return self._rng.bit_generator.state

    def set_random_state(self, state: Mapping[str, Any]) -> None:
        """Inverse of `random_state`. Raises TypeError, ValueError or KeyError if it is not."""
        rng = np.random.default_rng()
        rng.bit_generator.state = state
        self._rng = rng
