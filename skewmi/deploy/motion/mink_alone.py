"""mink without the solvers that it would load with it.

mink imports qpsolvers for `mink.solve_ik`, which is not used here, and qpsolvers imports scipy:
a second of a slow computer's time, at each start. A stand-in is imported in its place, which
loads qpsolvers when somebody does solve with mink.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_SOLVERS = "qpsolvers"


class _Later(ModuleType):
    """Stands for a module until something of it is used."""

    being_imported = True
    """Whether names are only looked at, in annotations, and need not mean anything yet."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return object if self.being_imported else getattr(import_module(self.__name__), name)


def import_mink() -> Any:
    """The module mink."""
    if "mink" in sys.modules or _SOLVERS in sys.modules:
        return import_module("mink")
    later = _Later(_SOLVERS)
    sys.modules[_SOLVERS] = later
    try:
        return import_module("mink")
    finally:
        later.being_imported = False
        # Others who import it get the module itself.
        del sys.modules[_SOLVERS]
