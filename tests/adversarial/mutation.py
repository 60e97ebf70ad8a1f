"""Mutation testing of what judges commands: does a test notice every weakened check?

    pip install 'cosmic-ray>=8.7'
    python tests/adversarial/mutation.py --out results/mutation.json

With `--resume` modules that are in the file of `--out` already, and neither changed since nor their
tests, are taken from there.

Cosmic Ray makes every small change it knows (and those of `mutants`) in a copy of the
package, one at a time, and the module's own unit tests run on each. A change that no test notices
survives. Each survivor must have a row in `docs/mutation.md` that says why it cannot matter, and
each row there must be a survivor; otherwise the run fails with exit code 1.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import io
import json
import os
import re
import shutil
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

import result_document
from mutant_forks import ForkPerMutant, Target

try:
    from mutants import Mutant, list_mutants
except ModuleNotFoundError as error:
    sys.exit(
        f"tests/adversarial/mutation.py needs {error.name}, which is not installed; install Cosmic "
        "Ray into the environment of skewmi: pip install 'cosmic-ray>=8.7'"
    )


TARGETS = (
    Target(
        "skewmi/deploy/safety/limits.py",
        (
            "test_limits_bounds.py",
            "test_limits_form.py",
            "test_limits_stream.py",
            "test_limits_ends.py",
            "test_limits_hand.py",
            "test_limits_box.py",
            "test_limits.py",
        ),
    ),
    Target(
        "skewmi/deploy/safety/validation.py",
        ("test_validation_rules.py", "test_validation.py"),
    ),
    Target("skewmi/deploy/safety/lease.py", ("test_lease.py",)),
)

EXPLANATIONS = result_document.REPOSITORY / "docs" / "mutation.md"

# What a check takes depends on the machine's load and would kill mutants at random; what a module
# imports, tested in an interpreter of its own, does not depend on any mutation here.
NOT_RUN = "not is_cheap and not imports_nothing"


def main() -> int:
    parser = result_document.argument_parser(__doc__)
    parser.add_argument("--only", default="", help="only modules whose path has this in it")
    parser.add_argument(
        "--explained",
        type=Path,
        metavar="FILE",
        help="run nothing; judge the survivors in a result",
    )
    parser.add_argument("--resume", action="store_true", help="keep what --out has of a module")
    options = parser.parse_args()
    if options.explained:
        document = json.loads(options.explained.read_text(encoding="utf-8"))
        return judge([(s["place"], s["mutation"]) for s in document["survivors"]], TARGETS)
    targets = tuple(target for target in TARGETS if options.only in target.path)
    if not targets:
        known = ", ".join(target.path for target in TARGETS)
        parser.error(f"--only {options.only}: no such module; there are {known}")

    figures, survivors = earlier(options.out, targets) if options.resume else ({}, [])
    with tempfile.TemporaryDirectory(prefix="skewmi-mutation-") as folder:
        copy = make_copy(Path(folder).resolve())
        sys.path.insert(0, str(copy))
        # A counterexample is a kill; searching for the smallest one is time lost. And what takes
        # long depends on the machine's load.
        settings.register_profile(
            "mutation",
            phases=(Phase.explicit, Phase.generate),
            suppress_health_check=list(HealthCheck),
            database=None,
            deadline=None,
        )
        settings.load_profile("mutation")
        with contextlib.chdir(copy):
            for target in targets:
                if target.path in figures:
                    continue
                figures[target.path], survived = run_target(target, options.seed)
                figures[target.path]["sources_sha256"] = digest(target)
                survivors += [record(survivor) for survivor in survived]

    document = result_document.write_result(
        "mutation",
        {"modules": figures, "survivors": survivors},
        options.out,
        seed=options.seed,
        config={
            "tool": f"cosmic-ray {importlib.metadata.version('cosmic-ray')}",
            "tests": {target.path: target.tests for target in targets},
        },
    )
    result_document.print_result(document, as_json=options.json)
    return judge([(survivor["place"], survivor["mutation"]) for survivor in survivors], targets)


def digest(target: Target) -> str:
    """Of everything that decides what becomes of a module's mutants; in hexadecimal."""
    tests = result_document.REPOSITORY / "tests"
    files = [
        result_document.REPOSITORY / target.path,
        *(tests / "deploy" / "safety" / name for name in target.tests),
        *sorted((tests / "support").glob("limit_*.py")),
        tests / "adversarial" / "mutants.py",
    ]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


def earlier(
    path: Path | None, targets: tuple[Target, ...]
) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Figures and survivors, in a result, of those modules that nothing of has changed since."""
    if path is None or not path.exists():
        return {}, []
    document = json.loads(path.read_text(encoding="utf-8"))
    kept = {
        target.path: document["modules"][target.path]
        for target in targets
        if document["modules"].get(target.path, {}).get("sources_sha256") == digest(target)
    }
    places = tuple(f"{Path(path).name} " for path in kept)
    return kept, [one for one in document["survivors"] if one["place"].startswith(places)]


def record(mutant: Mutant) -> dict[str, str]:
    """A mutant without the whole file."""
    return {key: value for key, value in asdict(mutant).items() if key != "content"}


def judge(survivors: list[tuple[str, str]], targets: tuple[Target, ...]) -> int:
    """Exit code: 1, and what is wrong on standard error, unless exactly these are explained."""
    places = tuple(f"{Path(target.path).name} " for target in targets)
    rows = {row for row in read_explanations(EXPLANATIONS) if row[0].startswith(places)}
    unexplained, outdated = sorted(set(survivors) - rows), sorted(rows - set(survivors))
    for title, some in (("not explained", unexplained), ("explained, but killed", outdated)):
        for place, mutation in some:
            result_document.progress(f"{title}: | {place} | {mutation} |")
    return 1 if unexplained or outdated else 0


def make_copy(folder: Path) -> Path:
    """Copy what the tests need into a folder, so that nobody's edits change a run."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(result_document.REPOSITORY / "skewmi", folder / "skewmi", ignore=ignored)
    shutil.copy(result_document.REPOSITORY / "pyproject.toml", folder)
    (folder / "tests" / "support").mkdir(parents=True)
    for name in {name for target in TARGETS for name in target.tests}:
        source = result_document.REPOSITORY / "tests" / "deploy" / "safety" / name
        shutil.copy(source, folder / "tests")
    return folder


def test_versions(target: Target, versions: list[tuple[str, str]], seed: int) -> list[str]:
    """Outcome of the tests of a module for each version of its source; see `ForkPerMutant`."""
    forks = ForkPerMutant(target, versions)
    arguments = ["-qq", "-x", "--assert=plain", "-p", "no:cacheprovider", "-k", NOT_RUN]
    arguments += [f"--hypothesis-seed={seed}", *(f"tests/{name}" for name in target.tests)]
    passed, output = False, io.StringIO()
    try:
        with contextlib.redirect_stdout(output):
            passed = pytest.main(arguments, plugins=[forks]) == 0
    finally:
        if forks.in_fork:
            os._exit(0 if passed else 1)
    if len(forks.outcomes) != len(versions):
        sys.exit(f"the tests of {target.path} could not be run:\n{output.getvalue()}")
    return forks.outcomes


def run_target(target: Target, seed: int) -> tuple[dict[str, Any], list[Mutant]]:
    """Run the tests of a module on each of its mutants; the working directory is the copy."""
    path = Path(target.path)
    begin = time.monotonic()
    unmutated = [(f"no mutation of {path}", path.read_text(encoding="utf-8"))]
    if test_versions(target, unmutated, seed) != [""]:
        sys.exit(f"the tests of {target.path} fail on its copy before any mutation")
    unmutated_s = time.monotonic() - begin
    mutants = list_mutants(path)
    result_document.progress(
        f"{target.path}: {len(mutants)} mutants, {unmutated_s:.1f} s without mutation"
    )
    begin = time.monotonic()
    versions = [(f"{mutant.place}: {mutant.mutation}", mutant.content) for mutant in mutants]
    outcomes = test_versions(target, versions, seed)
    per_mutant = (time.monotonic() - begin) / len(mutants)
    survivors = [m for m, outcome in zip(mutants, outcomes, strict=True) if not outcome]
    return {
        "mutants": len(mutants),
        "killed": outcomes.count("killed"),
        "timeout": outcomes.count("timeout"),
        "survived": len(survivors),
        "seconds_per_mutant": round(per_mutant, 2),
        "seconds_unmutated": round(unmutated_s, 2),
    }, survivors


def read_explanations(path: Path) -> set[tuple[str, str]]:
    """Place and mutation of every row of the table; the third cell must not be empty."""
    rows = set()
    for line in path.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 3 and "→" in cells[1]:
            if not cells[2]:
                sys.exit(f"{path.name} does not say why in: {line}")
            rows.add((cells[0], cells[1].replace(r"\|", "|")))
    return rows


if __name__ == "__main__":
    sys.exit(main())
