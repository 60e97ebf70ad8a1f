"""Forks of one test process, in each of which the tests judge another version of a module."""

from __future__ import annotations

import gc
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import pytest
import result_document

SUPPORT = result_document.REPOSITORY / "tests" / "support"

STALE = 70
"""Exit code of a fork whose tests would not see its version."""

TIMEOUT_S = 60
"""Processor time after which the tests of a mutant are given up, s. Wall time would let a busy
machine decide."""


@dataclass(frozen=True)
class Target:
    """A module to mutate."""

    path: str
    tests: tuple[str, ...]
    """The files of `tests/deploy/safety` that must notice a change of it, the quickest first."""

    @property
    def module(self) -> str:
        return self.path.removesuffix(".py").replace("/", ".")


class ForkPerMutant:
    """Lets pytest collect the tests once, then runs them on each version of a module, in forks.

    In a fork the module and the test files are executed anew, each in the namespace that it has:
    the tests and fixtures that pytest has collected then see the version. What the test files
    import from `tests/support` is imported anew. Files stay as they are, and so do other modules'
    references to the unchanged one: a test that reaches the module only through them cannot kill a
    mutant.

    Args:
        target: Whose tests they are.
        versions: Name and source of each version to test.

    Attributes:
        outcomes: "" where every test passed, else "killed" or "timeout"; in order of `versions`.
        in_fork: Whether this is a fork.
    """

    def __init__(self, target: Target, versions: list[tuple[str, str]]) -> None:
        self._target = target
        self._versions = versions
        self.outcomes: list[str] = []
        self.in_fork = False

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        module = sys.modules[self._target.module]
        if module.__file__ != str(Path(self._target.path).resolve()):
            sys.exit(f"the tests import {module.__file__} instead of the copy")
        files = {item.module: None for item in session.items}  # type: ignore[attr-defined]
        again = [(file, code_of(file)) for file in files]
        gc.freeze()  # so that no fork copies everything at its first collection
        for name, source in self._versions:
            process = os.fork()
            if process == 0:
                self.in_fork = True
                signal.setitimer(signal.ITIMER_PROF, TIMEOUT_S)
                exec(compile(source, module.__file__, "exec"), module.__dict__)
                for helper in helpers():
                    del sys.modules[helper]
                for file, source_code in again:
                    exec(source_code, file.__dict__)
                require_of_this_version(module, [file for file, _ in again])
                return None  # on to pytest's own loop
            code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            if code == STALE:
                sys.exit("a test would judge another version than it should, see above")
            self.outcomes.append("timeout" if code == -signal.SIGPROF else "killed" * bool(code))
            if not code:
                result_document.progress(f"tests pass with {name}")
            if len(self.outcomes) % 50 == 0:
                result_document.progress(f"{len(self.outcomes)} of {len(self._versions)}")
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, call: pytest.CallInfo[None]) -> None:
        """End a fork at the first failure: pytest's report on it takes longer than the tests."""
        if self.in_fork and call.excinfo is not None:
            os._exit(1)


def helpers() -> list[str]:
    """Names of the loaded modules of `tests/support`, but for our own."""
    return [
        name
        for name, module in sys.modules.items()
        if Path(getattr(module, "__file__", None) or ".").parent == SUPPORT
        and module is not result_document
    ]


def require_of_this_version(module: ModuleType, files: list[ModuleType]) -> None:
    """End the fork as no version can unless whatever tests have of a module is of this version."""
    for file in [*files, *(sys.modules[name] for name in helpers())]:
        for name, value in vars(file).items():
            kind = value if isinstance(value, type | FunctionType) else type(value)
            if kind.__module__ == module.__name__ and kind is not vars(module)[kind.__name__]:
                os.write(2, f"{file.__name__}.{name} is of another version\n".encode())
                os._exit(STALE)


def code_of(module: ModuleType) -> CodeType:
    """The compiled source of a module."""
    assert module.__file__ is not None
    source = Path(module.__file__).read_text(encoding="utf-8")
    return compile(source, module.__file__, "exec")
