"""Twin files: how a simulated robot and its scene differ from the nominal ones.

A twin file is YAML. Every key is optional, and what is not given is nominal. A value is a number,
or `[low, high]`: drawn uniformly for every simulation at every reset. Keys of the servos also take
a list of seven such values, one a joint in chain order; one range for the whole arm is drawn for
each joint by itself. `KEYS` lists everything; `docs/variations.md` explains it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import Array

NUM_JOINTS = 7


class Key(NamedTuple):
    """What a key of a twin file allows."""

    low: float
    high: float
    unit: str
    size: int = 1


KEYS: Mapping[str, Key] = {
    "servo.kp_scale": Key(0.2, 5.0, "1", NUM_JOINTS),
    "servo.kd_scale": Key(0.2, 5.0, "1", NUM_JOINTS),
    "servo.frictionloss_scale": Key(0.0, 10.0, "1", NUM_JOINTS),
    "servo.armature_scale": Key(0.2, 5.0, "1", NUM_JOINTS),
    "servo.delay_ms": Key(0.0, 100.0, "ms"),
    "lid.frictionloss": Key(0.0, 2.0, "N m"),
    "lid.damping": Key(0.0, 1.0, "N m s/rad"),
    "lid.mass": Key(0.01, 1.0, "kg"),
    "button.frictionloss": Key(0.0, 50.0, "N"),
    "button.travel": Key(0.012, 0.030, "m"),
    "contact.friction": Key(0.05, 2.0, "1"),
    "box_pose.x": Key(-0.05, 0.05, "m"),
    "box_pose.y": Key(-0.05, 0.05, "m"),
    "box_pose.yaw_deg": Key(-20.0, 20.0, "deg"),
    "sensors.joint_noise": Key(0.0, 0.05, "rad"),
    "sensors.lid_bias_deg": Key(-20.0, 20.0, "deg"),
    "sensors.lid_noise_deg": Key(0.0, 20.0, "deg"),
    "sensors.button_noise": Key(0.0, 0.01, "m"),
    "gripper.opening_error": Key(-0.005, 0.005, "m"),
}
"""Allowed bounds, unit and number of values by `section.key`."""

_SECTIONS = tuple(dict.fromkeys(name.partition(".")[0] for name in KEYS))

Range = tuple[tuple[float, float], ...]
"""(low, high) of each value of a key; equal if it is not random."""


@dataclass(frozen=True)
class TwinSample:
    """What was drawn for `n` simulations.

    Attributes:
        n: Simulations.
        values: By `section.key`; only the keys of the twin. Shape (n,), servo scales (n, 7).
    """

    n: int
    values: Mapping[str, Array]

    def get(self, name: str, default: float = 0.0) -> Array:
        """The values of a key, or `default` for every simulation if the twin lacks it."""
        assert name in KEYS
        found = self.values.get(name)
        return np.full(self.n, default) if found is None else found


@dataclass(frozen=True)
class Twin:
    """A checked twin file.

    Attributes:
        ranges: By `section.key`, in the order of `KEYS`.
        seed: Joined with the environment's seed: twins that differ in it alone draw differently.
    """

    ranges: tuple[tuple[str, Range], ...] = field(default=())
    seed: int = 0

    @staticmethod
    def nominal() -> Twin:
        """Nothing differs."""
        return Twin()

    @property
    def is_nominal(self) -> bool:
        """Whether nothing is given, so that the nominal simulation runs untouched."""
        return not self.ranges

    def has(self, *names: str) -> bool:
        """Whether any of these keys is given."""
        assert all(name in KEYS for name in names)
        return any(name in names for name, _ in self.ranges)

    @staticmethod
    def load(path: str | Path) -> Twin:
        """Read a twin file.

        Args:
            path: Of the file, or the name of a bundled one (`randomised`).

        Raises:
            NotFoundError: There is no such file; the message lists the bundled ones.
            ConfigurationError: It is not YAML, or a key or value is not allowed.
        """
        if str(path) in bundled():
            text = (resources.files("skewmi.sim") / "variations" / f"{path}.yaml").read_text(
                "utf-8"
            )
            return Twin.parse(text, f"the bundled twin {path}")
        try:
            text = Path(path).read_text(encoding="utf-8")
        except FileNotFoundError as error:
            raise NotFoundError(
                f"no twin file {path}; give a YAML file or a bundled name: {', '.join(bundled())}"
            ) from error
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigurationError(f"twin file {path} cannot be read: {error}") from error
        return Twin.parse(text, f"twin file {path}")

    @staticmethod
    def parse(text: str, name: str = "twin") -> Twin:
        """Read the text of a twin file, YAML or the JSON of `to_json`.

        Args:
            text: Of the file.
            name: What error messages call it.

        Raises:
            ConfigurationError: It is not YAML, or a key or value is not allowed.
        """
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError

        try:
            content = YAML(typ="safe", pure=True).load(text)
        except (YAMLError, ValueError) as error:
            summary = " ".join(str(error).split())
            raise ConfigurationError(f"{name} is not YAML: {summary}") from error
        return _checked({} if content is None else content, name)

    def to_json(self) -> str:
        """One line that `parse` reads back as an equal twin."""
        content: dict[str, Any] = {"seed": self.seed} if self.seed else {}
        for name, values in self.ranges:
            section, _, key = name.partition(".")
            items = [low if low == high else [low, high] for low, high in values]
            content.setdefault(section, {})[key] = items[0] if len(items) == 1 else items
        return json.dumps(content)

    def sample(self, rng: np.random.Generator, n: int) -> TwinSample:
        """Draw the values of `n` simulations.

        Args:
            rng: Advanced by what is random alone.
            n: Simulations.
        """
        values = {}
        for name, pairs in self.ranges:
            low, high = np.array(pairs).T
            size = KEYS[name].size
            if np.array_equal(low, high):
                drawn = np.tile(low, (n, size // len(low)))
            else:
                drawn = rng.uniform(low, high, (n, size))
            values[name] = drawn[:, 0] if size == 1 else drawn
        return TwinSample(n, values)


def bundled() -> tuple[str, ...]:
    """Names of the twin files that come with the package."""
    folder = resources.files("skewmi.sim") / "variations"
    names = (Path(entry.name) for entry in folder.iterdir())
    return tuple(sorted(name.stem for name in names if name.suffix == ".yaml"))


def resolve(twin: Twin | str | Path | None) -> Twin:
    """A twin from what users and run directories give.

    Args:
        twin: A twin; the JSON of one; a file; the name of a bundled one; None for the nominal.

    Raises:
        NotFoundError, ConfigurationError: See `Twin.load`.
    """
    if twin is None:
        return Twin.nominal()
    if isinstance(twin, Twin):
        return twin
    if isinstance(twin, str) and twin.lstrip().startswith("{"):
        return Twin.parse(twin)
    if not isinstance(twin, str | Path):
        raise ConfigurationError(
            f"twin is {twin!r}; give a file or a bundled name: {', '.join(bundled())}"
        )
    return Twin.load(twin)


def _checked(content: object, name: str) -> Twin:
    if not isinstance(content, dict):
        raise ConfigurationError(f"{name} must map sections to keys ({', '.join(_SECTIONS)}, seed)")
    seed = content.get("seed", 0)
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ConfigurationError(f"{name}: seed is {seed!r}; it must be a whole number from 0")
    ranges: dict[str, Range] = {}
    for section, entries in content.items():
        if section == "seed":
            continue
        if section not in _SECTIONS:
            raise ConfigurationError(
                f"{name}: no section {section!r}; allowed: seed, {', '.join(_SECTIONS)}"
            )
        allowed = [key.partition(".")[2] for key in KEYS if key.startswith(f"{section}.")]
        if not isinstance(entries, dict | None):
            raise ConfigurationError(
                f"{name}: {section} is {entries!r}; it must map keys to values: "
                f"{', '.join(allowed)}"
            )
        for key, value in (entries or {}).items():
            if key not in allowed:
                raise ConfigurationError(
                    f"{name}: {section} has no key {key!r}; allowed: {', '.join(allowed)}"
                )
            ranges[f"{section}.{key}"] = _range(value, f"{section}.{key}", name)
    return Twin(tuple((key, ranges[key]) for key in KEYS if key in ranges), seed)


def _range(value: object, key: str, name: str) -> Range:
    """Check a value and bring it into one form."""
    spec = KEYS[key]
    if isinstance(value, list) and spec.size > 1 and len(value) == spec.size:
        return tuple(_pair(item, key, name) for item in value)
    return (_pair(value, key, name),)


def _pair(value: object, key: str, name: str) -> tuple[float, float]:
    spec = KEYS[key]
    unit = "" if spec.unit == "1" else f" {spec.unit}"
    lists = f", or a list of {spec.size} of these" if spec.size > 1 else ""
    rule = (
        f"{name}: {key} is {value!r}; it must be a number or [low, high], "
        f"within {spec.low:g}..{spec.high:g}{unit}{lists}"
    )
    pair: list[Any] = value if isinstance(value, list) else [value, value]
    if len(pair) != 2 or any(isinstance(x, bool) or not isinstance(x, int | float) for x in pair):
        raise ConfigurationError(rule)
    low, high = float(pair[0]), float(pair[1])
    if not (math.isfinite(low) and math.isfinite(high) and spec.low <= low <= high <= spec.high):
        raise ConfigurationError(rule)
    return low, high
