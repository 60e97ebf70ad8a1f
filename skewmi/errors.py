"""The errors of this package: one base class, so that a caller can catch them all."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SkewmiError(Exception):
    """Base of every error that a user of the package can cause or has to handle.

    The message is one line that says what was given, what is allowed and what to do.
    The command line prints it and exits with code 2.
    """


class ConfigurationError(SkewmiError):
    """A value in a configuration, a flag or a file is not allowed."""


class OutputError(ConfigurationError):
    """A file or folder must not or cannot be written; the message says which and why."""


class NotFoundError(SkewmiError):
    """Something asked for by name does not exist; the message lists what does."""


class LayoutMismatchError(SkewmiError):
    """A policy and its user disagree about observation, action or robot model."""


class PolicyFileError(SkewmiError):
    """A policy file cannot be read or is not one of ours."""


class VerificationError(PolicyFileError):
    """An exported policy does not do what its original does; nothing was written."""


class CheckpointError(SkewmiError):
    """A run directory or a checkpoint in it is missing, damaged or of another kind."""


class KinematicsError(SkewmiError):
    """A pose cannot be reached, or a configuration is outside the joint limits."""


class SimulationError(SkewmiError):
    """The physics engine left the states that mean anything, or pictures cannot be drawn."""


class LimitViolationError(SkewmiError):
    """A command breaks a limit; carries the limit's name, the value and the bound."""

    def __init__(self, limit: str, value: float, bound: float, detail: str = "") -> None:
        self.limit = limit
        self.value = value
        self.bound = bound
        self.detail = detail
        message = f"{limit}: {value:.6g} is outside the bound {bound:.6g}"
        super().__init__(f"{message} ({detail})" if detail else message)


class TransportError(SkewmiError):
    """The message link cannot be opened, or nobody answers on it."""


class CommandRefusedError(SkewmiError):
    """The robot server refused a command; the message gives its reason."""


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: what was probably meant; empty if nothing was."""
    near = difflib.get_close_matches(given.lower(), list(known), n=1, cutoff=0.6)
    return f"; did you mean {near[0]!r}?" if near else ""
