"""Variations of a model: how a simulated robot and its scene differ from the nominal ones.

A variation file is YAML. Every key is optional, and what is not given is nominal. A value is a
number, or `[low, high]`: drawn uniformly for every simulation at every reset. Keys with one value
per joint also take a list of such values, one a joint in chain order; one range for the whole arm
is drawn for each joint by itself. Which keys there are is the task's business, see `Variations`;
`docs/variations.md` explains them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from skewmi.errors import ConfigurationError, NotFoundError, did_you_mean
from skewmi.policy_io import Array
from skewmi.yaml_text import parse_yaml, shown

_FOLDER = "variations"
"""Where a package keeps the files that come with it."""


@dataclass(frozen=True)
class VariationKey:
    """One number that may differ.

    Attributes:
        name: `section.key`.
        low, high: Bounds of what is allowed.
        unit: Of values and bounds.
        size: Number of values.
        apply: Writes drawn values, shape (n,) or (n, size), into the fields of the models, given
            as whoever simulates keeps them; None where a value is no field of a model.
        excludes: Name of a key that may not be given besides this one: both say the same.
    """

    name: str
    low: float
    high: float
    unit: str = "1"
    size: int = 1
    apply: Callable[[Any, Array], None] | None = None
    excludes: str = ""

    @property
    def section(self) -> str:
        """What the key stands under in a file."""
        return self.name.partition(".")[0]

    @property
    def short(self) -> str:
        """Its name within the section."""
        return self.name.partition(".")[2]


Range = tuple[tuple[float, float], ...]
"""(low, high) of each value of a key; equal if it is not random."""


@dataclass(frozen=True)
class VariationSample:
    """What was drawn for `n` simulations.

    Attributes:
        n: Simulations.
        values: By `section.key`; only the keys of the variation. Shape (n,) or (n, size).
    """

    n: int
    values: Mapping[str, Array]

    def get(self, name: str, default: float = 0.0) -> Array:
        """The values of a key, or `default` for every simulation if the variation lacks it."""
        found = self.values.get(name)
        return np.full(self.n, default) if found is None else found


@dataclass(frozen=True)
class ModelVariation:
    """A checked variation file.

    Attributes:
        ranges: By key, in the order of the task's keys.
        seed: Joined with the environment's seed: variations that differ in it alone draw
            differently.
    """

    ranges: tuple[tuple[VariationKey, Range], ...] = field(default=())
    seed: int = 0

    @property
    def is_nominal(self) -> bool:
        """Whether nothing is given, so that the nominal simulation runs untouched."""
        return not self.ranges

    def has(self, *names: str) -> bool:
        """Whether any of these keys is given."""
        return any(key.name in names for key, _ in self.ranges)

    def to_json(self) -> str:
        """One line that `Variations.parse` reads back as an equal variation."""
        content: dict[str, Any] = {"seed": self.seed} if self.seed else {}
        for key, values in self.ranges:
            items = [low if low == high else [low, high] for low, high in values]
            section = content.setdefault(key.section, {})
            section[key.short] = items[0] if len(items) == 1 else items
        return json.dumps(content)

    def sample(self, rng: np.random.Generator, n: int) -> VariationSample:
        """Draw the values of `n` simulations.

        Args:
            rng: Advanced by what is random alone.
            n: Simulations.
        """
        values = {}
        for key, pairs in self.ranges:
            low, high = np.array(pairs).T
            if np.array_equal(low, high):
                drawn = np.tile(low, (n, key.size // len(low)))
            else:
                drawn = rng.uniform(low, high, (n, key.size))
            values[key.name] = drawn[:, 0] if key.size == 1 else drawn
        return VariationSample(n, values)


NOMINAL = ModelVariation()
"""Nothing differs."""


@dataclass(frozen=True)
class Variations:
    """What may differ in a task.

    Attributes:
        keys: In the order in which values are drawn; none for a task without variations.
        packages: Packages whose folder `variations` has files that users may name without
            suffix; the first that has one of the name decides.
    """

    keys: tuple[VariationKey, ...] = ()
    packages: tuple[str, ...] = ()

    @property
    def sections(self) -> tuple[str, ...]:
        """What a file may have at its top, besides `seed`."""
        return tuple(dict.fromkeys(key.section for key in self.keys))

    def bundled(self) -> dict[str, Traversable]:
        """The files that users may name without suffix."""
        found: dict[str, Traversable] = {}
        for package in reversed(self.packages):
            folder = resources.files(package) / _FOLDER
            entries = folder.iterdir() if folder.is_dir() else iter(())
            names = {Path(entry.name): entry for entry in entries}
            found |= {n.stem: entry for n, entry in names.items() if n.suffix == ".yaml"}
        return dict(sorted(found.items()))

    def load(self, path: str | Path) -> ModelVariation:
        """Read a variation file.

        Args:
            path: Of the file, or the name of a bundled one.

        Raises:
            NotFoundError: There is no such file; the message lists the bundled ones.
            ConfigurationError: It is not YAML, or a key or value is not allowed.
        """
        bundled = self.bundled()
        if str(path) in bundled:
            text = bundled[str(path)].read_text("utf-8")
            return self.parse(text, f"the bundled variation {path}")
        try:
            text = Path(path).read_text(encoding="utf-8")
        except FileNotFoundError as error:
            names = ", ".join(bundled) or "there are none"
            raise NotFoundError(
                f"no variation file {path}; give a YAML file or a bundled name: {names}"
                f"{did_you_mean(str(path), bundled)}"
            ) from error
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigurationError(f"variation file {path} cannot be read: {error}") from error
        return self.parse(text, f"variation file {path}")

    def parse(self, text: str, name: str = "variation") -> ModelVariation:
        """Read the text of a variation file, YAML or the JSON of `ModelVariation.to_json`.

        Args:
            text: Of the file.
            name: What error messages call it.

        Raises:
            ConfigurationError: It is not YAML, or a key or value is not allowed.
        """
        content = parse_yaml(text, name)
        return self._checked({} if content is None else content, name)

    def resolve(self, variation: ModelVariation | str | Path | None) -> ModelVariation:
        """A variation from what users and run directories give.

        Args:
            variation: A variation; the JSON of one; a file; the name of a bundled one; None for
                the nominal one.

        Raises:
            NotFoundError, ConfigurationError: See `load`.
        """
        if variation is None:
            return NOMINAL
        if isinstance(variation, ModelVariation):
            return variation
        if isinstance(variation, str) and variation.lstrip().startswith("{"):
            return self.parse(variation)
        if not isinstance(variation, str | Path):
            raise ConfigurationError(
                f"variation is {shown(variation)}; give a file or a bundled name: "
                f"{', '.join(self.bundled())}"
            )
        return self.load(variation)

    def _checked(self, content: object, name: str) -> ModelVariation:
        sections = self.sections
        if not isinstance(content, dict):
            raise ConfigurationError(
                f"{name} must map sections to keys ({', '.join((*sections, 'seed'))})"
            )
        seed = content.get("seed", 0)
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise ConfigurationError(
                f"{name}: seed is {shown(seed)}; it must be a whole number from 0"
            )
        ranges: dict[str, Range] = {}
        for section, entries in content.items():
            if section == "seed":
                continue
            if section not in sections:
                raise ConfigurationError(
                    f"{name}: no section {shown(section)}; allowed: "
                    f"{', '.join(('seed', *sections))}"
                )
            allowed = {key.short: key for key in self.keys if key.section == section}
            if not isinstance(entries, dict | None):
                raise ConfigurationError(
                    f"{name}: {section} is {shown(entries)}; it must map keys to values: "
                    f"{', '.join(allowed)}"
                )
            for short, value in (entries or {}).items():
                if short not in allowed:
                    raise ConfigurationError(
                        f"{name}: {section} has no key {shown(short)}; allowed: "
                        f"{', '.join(allowed)}"
                    )
                ranges[f"{section}.{short}"] = _range(value, allowed[short], name)
        for key in self.keys:
            if key.name in ranges and key.excludes in ranges:
                raise ConfigurationError(
                    f"{name}: {key.name} and {key.excludes} are both given and say the same; "
                    "leave one out"
                )
        return ModelVariation(
            tuple((key, ranges[key.name]) for key in self.keys if key.name in ranges), seed
        )


def _range(value: object, key: VariationKey, name: str) -> Range:
    """Check a value and bring it into one form."""
    if isinstance(value, list) and key.size > 1 and len(value) == key.size:
        return tuple(_pair(item, key, name) for item in value)
    return (_pair(value, key, name),)


def _pair(value: object, key: VariationKey, name: str) -> tuple[float, float]:
    unit = "" if key.unit == "1" else f" {key.unit}"
    lists = f", or a list of {key.size} of these" if key.size > 1 else ""
    rule = (
        f"{name}: {key.name} is {shown(value)}; it must be a number or [low, high], "
        f"within {key.low:g}..{key.high:g}{unit}{lists}"
    )
    pair: list[Any] = value if isinstance(value, list) else [value, value]
    if len(pair) != 2 or any(isinstance(x, bool) or not isinstance(x, int | float) for x in pair):
        raise ConfigurationError(rule)
    low, high = float(pair[0]), float(pair[1])
    if not (math.isfinite(low) and math.isfinite(high) and key.low <= low <= high <= key.high):
        raise ConfigurationError(rule)
    return low, high
