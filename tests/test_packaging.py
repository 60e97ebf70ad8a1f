"""What is made of the source tree: exact versions, a container, a source distribution."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
DOCKERFILE = ROOT / "Dockerfile"
CONSTRAINTS = ROOT / "constraints" / "deploy.txt"


def project() -> dict:
    with (ROOT / "pyproject.toml").open("rb") as file:
        return tomllib.load(file)["project"]


def pinned() -> dict[str, str]:
    """Versions by name."""
    lines = CONSTRAINTS.read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


def requirements(*extras: str) -> list[Requirement]:
    """Of the deployment side, and of extras."""
    content = project()
    lists = [content["dependencies"], *(content["optional-dependencies"][e] for e in extras)]
    return [Requirement(text) for each in lists for text in each]


def test_exact_versions_are_within_the_ranges_and_complete() -> None:
    versions = pinned()
    for requirement in requirements("security"):
        if requirement.marker is None or requirement.marker.evaluate():
            version = versions[canonicalize_name(requirement.name)]
            assert requirement.specifier.contains(version), f"{requirement} but {version}"


def test_exact_versions_are_of_the_deployment_side_alone() -> None:
    versions = pinned()
    assert not {"torch", "ray", "tensorboard", "pytest", "mkdocs", "skewmi"} & versions.keys()
    assert not [name for name in versions if name.startswith("nvidia")]
    text = CONSTRAINTS.read_text(encoding="utf-8")
    assert "://" not in text
    assert "--" not in text.replace("# pip", "")


def test_the_container_copies_what_exists_and_names_extras_that_exist() -> None:
    text = DOCKERFILE.read_text(encoding="utf-8").replace("\\\n", " ")
    copied = [line.split()[1:-1] for line in text.splitlines() if line.startswith("COPY ")]
    sources = [source for sources in copied for source in sources]
    assert {"pyproject.toml", "skewmi", "constraints/deploy.txt"} <= set(sources)
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    for source in sources:
        assert (ROOT / source).exists(), source
        assert f"!{source}" in ignored, f"{source} is not sent to the build"
    readme, licences = project()["readme"], project()["license-files"]
    assert {readme, *licences} <= set(sources), "the package's own metadata needs them"
    (extras,) = re.findall(r"\"\.\[([a-z,]+)\]\"", text)
    assert set(extras.split(",")) <= project()["optional-dependencies"].keys()
    (python,) = re.findall(r"^FROM python:([0-9.]+)-slim$", text, re.MULTILINE)
    assert f"with Python {python} " in CONSTRAINTS.read_text(encoding="utf-8")
    (entry,) = re.findall(r"^ENTRYPOINT \[\"(\w+)\"\]$", text, re.MULTILINE)
    assert entry in project()["scripts"]


@pytest.mark.slow
def test_a_source_distribution_can_be_tested(tmp_path: Path) -> None:
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if tracked.returncode:
        pytest.skip("this is no checkout: a source distribution is made of one")
    # A copy, so that what a build leaves in its source is not left here.
    for name in filter(None, tracked.stdout.split("\0")):
        if (ROOT / name).is_file():
            (tmp_path / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tmp_path / "tree" / name)
    make = f"from setuptools import build_meta; build_meta.build_sdist({str(tmp_path)!r})"
    subprocess.run(
        [sys.executable, "-c", make], cwd=tmp_path / "tree", check=True, capture_output=True
    )
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(tmp_path / "unpacked", filter="data")
    (tree,) = (tmp_path / "unpacked").iterdir()
    inside = {path.relative_to(tree).as_posix() for path in tree.rglob("*") if path.is_file()}
    wanted = {name for name in tracked.stdout.split("\0") if name and (ROOT / name).is_file()}
    assert wanted - inside <= {".gitignore", ".ci/run"}
    # All files are there; these read pages, sweeps and scripts of the tree that they are in.
    tests = ("tests/test_pages.py", "tests/test_troubleshooting.py", "tests/test_rapid.py")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider", *tests],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
