"""Density units: in which distances between states are measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skewmi.errors import ConfigurationError
from skewmi.policy_io import Array, PolicyLayout
from skewmi.train.replay import Index
from skewmi.train.running_mean_std import RunningMeanStd
from skewmi.train.state import State, as_array


@dataclass(frozen=True)
class Scale:
    """Density units of a state: (state - offset) / unit * weight."""

    offset: Array
    unit: Array
    weight: Array

    def __call__(self, states: Array, *, weighted: bool) -> Array:
        """States (..., d) in density units."""
        scaled: Array = (states - self.offset) / self.unit
        return scaled * self.weight if weighted else scaled

    def inverse(self, scaled: Array, *, weighted: bool) -> Array:
        """Undo `__call__`."""
        states: Array = (scaled / self.weight if weighted else scaled) * self.unit + self.offset
        return states

    def state_dict(self) -> State:
        """All three, by name."""
        return {"offset": self.offset, "unit": self.unit, "weight": self.weight}

    @staticmethod
    def from_state_dict(state: State) -> Scale:
        """Inverse of `state_dict`."""
        return Scale(*(as_array(state[name]) for name in ("offset", "unit", "weight")))


def unit_scale(layout: PolicyLayout, weights: tuple[tuple[str, float], ...] = ()) -> Scale:
    """The layout's own units."""
    d = layout.state_dim
    return Scale(np.zeros(d), np.ones(d), field_weights(layout, weights))


def running_scale(
    layout: PolicyLayout,
    running: RunningMeanStd,
    floor: float,
    weights: tuple[tuple[str, float], ...] = (),
) -> Scale:
    """Running mean and standard deviation.

    A field that has hardly moved yet would get a tiny unit, and its noise would fill the
    density; `floor` is the smallest unit, as a fraction of half the field's nominal range.
    """
    half = np.array([0.5 * (field.high - field.low) for field in layout.state_fields])
    unit = np.maximum(np.sqrt(running.variance), np.maximum(floor * half, 1e-8))
    return Scale(running.mean.copy(), unit, field_weights(layout, weights))


def field_weights(layout: PolicyLayout, weights: tuple[tuple[str, float], ...]) -> Array:
    """Factor of each state field; 1 where none is given. Shape (state_dim,).

    Raises:
        ConfigurationError: A field does not exist.
    """
    given = dict(weights)
    field_columns(layout, tuple(given))
    return np.array([given.get(field.name, 1.0) for field in layout.state_fields])


def field_columns(layout: PolicyLayout, fields: tuple[str, ...]) -> Index:
    """Columns of a state that fields are in. Shape (k,).

    Raises:
        ConfigurationError: A field does not exist.
    """
    names = [field.name for field in layout.state_fields]
    unknown = [name for name in fields if name not in names]
    if unknown:
        raise ConfigurationError(f"unknown fields {unknown}; fields are {names}")
    return np.array([names.index(name) for name in fields], dtype=np.int64)
