"""Mutation testing of what judges commands: does a test notice every weakened check?

    pip install 'cosmic-ray>=8.7'
    python benchmarks/mutation.py --out results/mutation.json

Cosmic Ray makes every small change it knows (and those of `mutation_operators`) in a copy of the
package, one at a time, and the module's own unit tests run on each. A change that no test notices
survives. Each survivor must have a row in `docs/mutation.md` that says why it cannot matter, and
each row there must be a survivor; otherwise the run fails with exit code 1.

Left out: changes of annotations, which are not executed; shifts, bit operations, `//` and `%` in
the place of arithmetic; identity (`is`) in the place of comparisons of numbers.
"""

from __future__ import annotations

import ast
import compileall
import contextlib
import difflib
import importlib
import importlib.metadata
import io
import json
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

import common

try:
    import mutation_operators
    from cosmic_ray import plugins
    from cosmic_ray.commands.init import init
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import MutationSpec
except ModuleNotFoundError as error:
    sys.exit(
        f"benchmarks/mutation.py needs {error.name}, which is not installed; install Cosmic Ray "
        "into the environment of skewmi: pip install 'cosmic-ray>=8.7'"
    )


@dataclass(frozen=True)
class Target:
    """A module to mutate."""

    path: str
    tests: tuple[str, ...]
    """The files of `tests/deploy` that must notice a change of it, the quickest first."""
    preloaded: tuple[str, ...]
    """What its tests import beside it and no mutant changes: imported once, then forked."""

    @property
    def module(self) -> str:
        return self.path.removesuffix(".py").replace("/", ".")


TARGETS = (
    Target(
        "skewmi/deploy/limits.py",
        ("test_deploy_limits_bounds.py", "test_deploy_limits_hand.py", "test_deploy_limits.py"),
        ("hypothesis", "ruckig", "skewmi.robot_models.kinematics", "skewmi.policy_io"),
    ),
    Target(
        "skewmi/deploy/endpoint/validation.py",
        ("test_deploy_validation_rules.py", "test_deploy_validation.py"),
        (
            "hypothesis",
            "skewmi.deploy.endpoint.sim_twin",
            "skewmi.deploy.motion.start_motion",
            "skewmi.deploy.wire.messages",
            "skewmi.sim.open_press_close.definition",
        ),
    ),
    Target("skewmi/deploy/endpoint/lease.py", ("test_deploy_lease.py",), ("hypothesis",)),
)

EXPLANATIONS = common.REPOSITORY / "docs" / "mutation.md"

LEFT_OUT = re.compile(
    r".*BinaryOperator.*_(RShift|LShift|BitOr|BitAnd|BitXor|FloorDiv|Mod)$"
    r"|.*ComparisonOperator_(Eq|NotEq|Lt|LtE|Gt|GtE)_(Is|IsNot)$"
)

# What a check takes depends on the machine's load and would kill mutants at random; what a module
# imports, tested in an interpreter of its own, does not depend on any mutation here.
NOT_RUN = "not fast_enough and not imports_nothing"

TIMEOUT_S = 60
"""Processor time after which the tests of a mutant are given up, s. Wall time would let a busy
machine decide."""

# A found counterexample is a kill; searching for the smallest one is time lost.
CONFTEST = """
from hypothesis import HealthCheck, Phase, settings
settings.register_profile(
    "mutation",
    phases=(Phase.explicit, Phase.generate),
    suppress_health_check=list(HealthCheck),
    database=None,
    deadline=None,
)
settings.load_profile("mutation")
"""


@dataclass(frozen=True)
class Mutant:
    """One change."""

    place: str
    """Module and function, as in the table of explanations."""
    mutation: str
    """The lines before and after, as in the table of explanations."""
    operator: str
    diff: str


def main() -> int:
    parser = common.argument_parser(__doc__)
    parser.add_argument("--only", default="", help="only modules whose path has this in it")
    parser.add_argument(
        "--explained",
        type=Path,
        metavar="FILE",
        help="run nothing; judge the survivors in a result",
    )
    options = parser.parse_args()
    if options.explained:
        document = json.loads(options.explained.read_text(encoding="utf-8"))
        return judge([(s["place"], s["mutation"]) for s in document["survivors"]], TARGETS)
    targets = tuple(target for target in TARGETS if options.only in target.path)
    if not targets:
        known = ", ".join(target.path for target in TARGETS)
        parser.error(f"--only {options.only}: no such module; there are {known}")

    mutation_operators.register()
    figures: dict[str, Any] = {}
    survivors: list[Mutant] = []
    with tempfile.TemporaryDirectory(prefix="skewmi-mutation-") as folder:
        copy = make_copy(Path(folder).resolve())
        sys.path.insert(0, str(copy))
        with contextlib.chdir(copy):
            for target in targets:
                figures[target.path], survived = run_target(target, options.seed)
                survivors += survived

    document = common.write_result(
        "mutation",
        {"modules": figures, "survivors": [asdict(survivor) for survivor in survivors]},
        options.out,
        seed=options.seed,
        config={
            "tool": f"cosmic-ray {importlib.metadata.version('cosmic-ray')}",
            "tests": {target.path: target.tests for target in targets},
        },
    )
    common.print_result(document, as_json=options.json)
    return judge([(survivor.place, survivor.mutation) for survivor in survivors], targets)


def judge(survivors: list[tuple[str, str]], targets: tuple[Target, ...]) -> int:
    """Exit code: 1, and what is wrong on standard error, unless exactly these are explained."""
    places = tuple(f"{Path(target.path).name} " for target in targets)
    rows = {row for row in read_explanations(EXPLANATIONS) if row[0].startswith(places)}
    unexplained, outdated = sorted(set(survivors) - rows), sorted(rows - set(survivors))
    for title, some in (("not explained", unexplained), ("explained, but killed", outdated)):
        for place, mutation in some:
            common.progress(f"{title}: | {place} | {mutation} |")
    return 1 if unexplained or outdated else 0


def make_copy(folder: Path) -> Path:
    """Copy what the tests need into a folder; only the copy is ever changed."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(common.REPOSITORY / "skewmi", folder / "skewmi", ignore=ignored)
    shutil.copy(common.REPOSITORY / "pyproject.toml", folder)
    (folder / "tests" / "support").mkdir(parents=True)
    (folder / "tests" / "conftest.py").write_text(CONFTEST, encoding="utf-8")
    for name in {name for target in TARGETS for name in target.tests}:
        shutil.copy(common.REPOSITORY / "tests" / "deploy" / name, folder / "tests")
    compileall.compile_dir(folder / "skewmi", quiet=1)
    return folder


class ForkPerMutant:
    """Lets one pytest start up, then collect and run anew, in a fork, on each version of a file.

    Args:
        target: Whose tests they are.
        versions: Name -> content of its file to test; a list of pairs.

    Attributes:
        outcomes: "" where every test passed, else "killed" or "timeout"; in order of `versions`.
        in_fork: Whether this is a fork that ran the tests.
    """

    def __init__(self, target: Target, versions: list[tuple[str, str]]) -> None:
        self._target = target
        self._versions = versions
        self.outcomes: list[str] = []
        self.in_fork = False

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        path = Path(self._target.path)
        original = path.read_text(encoding="utf-8")
        for name, content in self._versions:
            path.write_text(content, encoding="utf-8")
            process = os.fork()
            if process == 0:
                signal.setitimer(signal.ITIMER_PROF, TIMEOUT_S)
                self.in_fork = True
                return
            code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            self.outcomes.append("timeout" if code == -signal.SIGPROF else "killed" * bool(code))
            if not code:
                common.progress(f"tests pass with {name}")
            if len(self.outcomes) % 50 == 0:
                common.progress(f"{len(self.outcomes)} of {len(self._versions)}")
        path.write_text(original, encoding="utf-8")
        pytest.exit("every version has been tested", returncode=0)


def test_versions(target: Target, versions: list[tuple[str, str]], seed: int) -> list[str]:
    """Outcome of the tests of a module for each version of its file; see `ForkPerMutant`."""
    forks = ForkPerMutant(target, versions)
    arguments = ["-qq", "-x", "--assert=plain", "-p", "no:cacheprovider", "-k", NOT_RUN]
    arguments += [f"--hypothesis-seed={seed}", *(f"tests/{name}" for name in target.tests)]
    with contextlib.redirect_stdout(io.StringIO()):
        code = pytest.main(arguments, plugins=[forks])
    if forks.in_fork:
        tested = sys.modules.get(target.module)
        here = tested is not None and tested.__file__ == str(Path(target.path).resolve())
        # A mutant that cannot even be imported is killed; one that was not tested must not pass.
        os._exit(int(code) if here or code else 70)
    return forks.outcomes


def run_target(target: Target, seed: int) -> tuple[dict[str, Any], list[Mutant]]:
    """Run the tests of a module on each of its mutants; the working directory is the copy."""
    path = Path(target.path)
    # Python takes a compiled module for current if size and second of the source agree, which two
    # mutants can share: the target is compiled anew at every import.
    sys.dont_write_bytecode = True
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
        compiled.unlink()
    for name in target.preloaded:
        importlib.import_module(name)
    if target.module in sys.modules:
        sys.exit(f"{target.path} cannot be mutated: what is preloaded for it imports it")
    original = path.read_text(encoding="utf-8")
    begin = time.monotonic()
    if test_versions(target, [(f"no mutation of {path}", original)], seed) != [""]:
        sys.exit(f"the tests of {target.path} fail on its copy before any mutation")
    unmutated_s = time.monotonic() - begin
    mutants, contents = [], []
    unchanged = ("", executed(original))
    for mutation, content in list_mutants(target):
        if executed(content) not in unchanged:
            mutants.append(describe(mutation, original, content))
            contents.append(content)
    common.progress(f"{target.path}: {len(mutants)} mutants, {unmutated_s:.1f} s without mutation")
    begin = time.monotonic()
    names = [f"{mutant.place}: {mutant.mutation}" for mutant in mutants]
    outcomes = test_versions(target, list(zip(names, contents, strict=True)), seed)
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


def list_mutants(target: Target) -> Iterator[tuple[MutationSpec, str]]:
    """Every mutation that the operators know, in the order of the source, and what it makes."""
    session, path = Path("session.sqlite"), Path(target.path)
    with use_db(session) as database:
        init([path], database, {})
        items = [item.mutations[0] for item in database.work_items]
    session.unlink()
    source = path.read_text(encoding="utf-8")
    for mutation in sorted(items, key=lambda m: (m.start_pos, m.operator_name, m.occurrence)):
        if not LEFT_OUT.match(mutation.operator_name):
            operator = plugins.get_operator(mutation.operator_name)()
            yield mutation, mutate_code(source, operator, mutation.occurrence)


def executed(source: str) -> str:
    """The syntax tree without annotations, which `from __future__ import annotations` defers.

    Empty for what is no code: Cosmic Ray takes the `*` before keyword-only parameters for a
    multiplication.
    """
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return ""
    for node in ast.walk(tree):
        for field in ("annotation", "returns"):
            if hasattr(node, field):
                setattr(node, field, None)
    return ast.dump(tree)


def describe(mutation: MutationSpec, old: str, new: str) -> Mutant:
    """A mutant with the names that the table of explanations uses."""
    diff = list(difflib.unified_diff(old.splitlines(), new.splitlines(), lineterm="", n=0))[2:]
    before, after = (
        " ".join(" ".join(line[1:] for line in diff if line.startswith(sign)).split())
        for sign in "-+"
    )
    return Mutant(
        place=f"{mutation.module_path.name} {mutation.definition_name or 'module'}",
        mutation=f"`{before}` → `{after}`",
        operator=mutation.operator_name,
        diff="\n".join(diff),
    )


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
