"""What the values of a variation mean in the fields of a model, for many simulations at once."""

from __future__ import annotations

import mujoco
import numpy as np

from skewmi.policy_io import Array
from skewmi.sim.variation import VariationKey, VariationSample

_NEEDS_SET_CONST = {"body_mass", "body_inertia", "body_pos", "body_quat", "dof_armature"}
"""Fields that constants of the model are derived from."""


class ModelFields:
    """The fields of a model that differ between simulations.

    Args:
        model: The nominal model, not changed.
        n: Simulations.

    Attributes:
        model: As given.
        values: By name of the `MjModel` field. Each shape (n, *shape of the field).
    """

    def __init__(self, model: mujoco.MjModel, n: int) -> None:
        self.model = model
        self.values: dict[str, Array] = {}
        self._n = n

    def write(self, name: str) -> Array:
        """A field of every simulation, to be changed in place. Shape (n, *shape of the field)."""
        if name not in self.values:
            nominal = getattr(self.model, name)
            self.values[name] = np.tile(nominal, (self._n, *([1] * nominal.ndim)))
        return self.values[name]

    def dof(self, joint: str) -> int:
        """Index of a joint's degree of freedom."""
        return int(self.model.joint(joint).dofadr[0])

    @property
    def needs_set_const(self) -> bool:
        """Whether constants of the model have to be derived anew."""
        return not _NEEDS_SET_CONST.isdisjoint(self.values)


def model_fields(
    model: mujoco.MjModel, keys: tuple[VariationKey, ...], sample: VariationSample
) -> ModelFields:
    """The fields of the model that differ, for every simulation.

    Args:
        model: The nominal model, not changed.
        keys: Of the task.
        sample: Values drawn.
    """
    fields = ModelFields(model, sample.n)
    for key in keys:
        if key.apply is not None and key.name in sample.values:
            key.apply(fields, sample.values[key.name])
    return fields
