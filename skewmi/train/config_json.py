"""Configurations as JSON and back, strictly: what is unknown or of another type is refused.

A learner's or exploration's numbers carry the name that `registry` knows them by, so that the
type they came from is found again.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import cattrs
from cattrs.preconf.json import make_converter

from skewmi.errors import ConfigurationError, SkewmiError
from skewmi.train.config import TrainConfig
from skewmi.train.exploration.protocol import ExplorationConfig
from skewmi.train.learner import LearnerConfig
from skewmi.train.registry import EXPLORATIONS, LEARNERS, Entry, entry_of

_NAME = "name"


def to_document(config: TrainConfig) -> dict[str, Any]:
    """What JSON holds of a configuration, at full precision."""
    document: dict[str, Any] = _converter().unstructure(config)
    return document


def from_document(document: object) -> TrainConfig:
    """Inverse of `to_document`; what is missing has its default.

    Raises:
        ConfigurationError: A name is unknown or a value not allowed; the message lists all.
    """
    if not isinstance(document, dict):
        raise ConfigurationError(f"a training configuration is an object, not {document!r}")
    try:
        return _converter().structure(document, TrainConfig)
    except (cattrs.BaseValidationError, SkewmiError) as error:
        reasons = (
            cattrs.transform_error(error, format_exception=_reason)
            if isinstance(error, cattrs.BaseValidationError)
            else [str(error)]
        )
        raise ConfigurationError(f"not a training configuration: {'; '.join(reasons)}") from error


def _reason(error: BaseException, kind: type[Any] | None) -> str:
    # A plain Exception is cattrs' word for a value that is not among those allowed.
    if isinstance(error, SkewmiError | _WrongTypeError) or type(error) is Exception:
        return str(error)
    return cattrs.v.format_exception(error, kind)


class _WrongTypeError(ValueError):
    """A value of another type than the field's."""


def _converter() -> cattrs.Converter:
    """Made anew each time: the registry may have grown."""
    converter = make_converter(forbid_extra_keys=True)
    # cattrs itself would take "3" for 3 and 0.9 for 0.
    for kind in (bool, int, float, str):
        converter.register_structure_hook(kind, _strict(kind))
    for base, entries in ((LearnerConfig, LEARNERS), (ExplorationConfig, EXPLORATIONS)):
        # For exactly the base: the derived types are plain dataclasses.
        exactly = partial(operator.is_, base)
        converter.register_unstructure_hook_func(exactly, _to_named(converter))
        converter.register_structure_hook_func(exactly, _from_named(converter, entries))
    return converter


def _strict(kind: type[Any]) -> Callable[[Any, type[Any]], Any]:
    def structure(value: Any, _: type[Any]) -> Any:
        fits = type(value) is kind or (kind is float and type(value) is int)
        if not fits:
            raise _WrongTypeError(f"{value!r} is not of type {kind.__name__}")
        return kind(value)

    return structure


def _to_named(converter: cattrs.Converter) -> Callable[[Any], dict[str, Any]]:
    def unstructure(config: Any) -> dict[str, Any]:
        name, entry = entry_of(config)
        return {_NAME: name, **converter.unstructure(config, unstructure_as=entry.config)}

    return unstructure


def _from_named(
    converter: cattrs.Converter, entries: Mapping[str, Entry]
) -> Callable[[Any, type[Any]], Any]:
    def structure(value: Any, _: type[Any]) -> Any:
        if not isinstance(value, dict) or value.get(_NAME) not in entries:
            given = value.get(_NAME) if isinstance(value, dict) else value
            raise _WrongTypeError(f"name is {given!r}; there are {', '.join(entries)}")
        rest = {key: item for key, item in value.items() if key != _NAME}
        return converter.structure(rest, entries[value[_NAME]].config)

    return structure
