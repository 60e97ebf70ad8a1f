"""The table of extras is what the package's description says, and its words lead somewhere."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest

import skewmi
from skewmi import extras
from skewmi.errors import NotFoundError

ROOT = Path(skewmi.__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]


def distributions(requirements: list[str]) -> set[str]:
    """Names as the registry has them, without those of our own extras."""
    names = {re.match(r"[\w.-]+", line)[0].lower() for line in requirements}
    return names - {"skewmi"}


@pytest.mark.parametrize("extra", extras.MODULES)
def test_every_package_of_an_extra_is_in_the_table(extra: str) -> None:
    by_distribution: dict[str, set[str]] = {}
    for module, names in importlib.metadata.packages_distributions().items():
        for name in names:
            by_distribution.setdefault(name.lower(), set()).add(module)
    for name in distributions(EXTRAS[extra]):
        if name in by_distribution:
            assert by_distribution[name] & set(extras.MODULES[extra]), name


def test_no_package_is_of_an_extra_and_of_every_installation() -> None:
    base = distributions(PROJECT["dependencies"])
    for extra in extras.MODULES:
        assert not base & distributions(EXTRAS[extra])
    assert "skewmi[view]" in EXTRAS["train"], "pictures of runs come with training"


def test_a_missing_module_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "is_installed", lambda module: module != "rerun")
    extras.require("--live", "pyarrow")
    with pytest.raises(NotFoundError) as caught:
        extras.require("--live", "pyarrow", "rerun")
    words = str(caught.value)
    assert words.startswith("--live needs the package 'rerun' (extra 'view'): pip install -e ")
    folder = re.search(r"-e '(.*)\[view\]'", words)
    assert folder is not None
    assert (Path(folder[1]) / "pyproject.toml").is_file()


def test_modules_of_modules_belong_to_the_extra() -> None:
    assert extras.extra_of("rerun.blueprint") == "view"
    assert extras.extra_of("torch") == "train"
    assert extras.extra_of("numpy") is None
