"""Mutations that weaken a check without touching an operator or a number.

Cosmic Ray replaces operators, numbers and conditions. What would hurt most in code that refuses
commands is not among them: a check that is not called, an error that is not raised, `any` in the
place of `all`, a missing absolute value. These operators add that to its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import parso
from cosmic_ray import plugins
from cosmic_ray.operators.operator import Example, Operator
from parso.python.tree import Name

Position = tuple[tuple[int, int], tuple[int, int]]

SWAPS = {
    "all": "any",
    "any": "all",
    "max": "min",
    "min": "max",
    "maximum": "minimum",
    "argmax": "argmin",
}


class _OneWay(Operator):  # type: ignore[misc]
    """At most one mutation for a node: subclasses say which nodes and what becomes of them."""

    def applies(self, node: Any) -> bool:
        raise NotImplementedError

    def mutation_positions(self, node: Any) -> Iterator[Position]:
        if self.applies(node):
            yield node.start_pos, node.end_pos


def _parsed_like(node: Any, code: str) -> Any:
    """A syntax node for `code` with the white space before `node`."""
    new = parso.parse(code).children[0]
    new.get_first_leaf().prefix = node.get_first_leaf().prefix
    return new


class RemoveStatement(_OneWay):
    """Put `pass` in the place of a call whose result is not used, a `raise` or a `return`."""

    def applies(self, node: Any) -> bool:
        return node.type in ("raise_stmt", "return_stmt") or (
            node.type in ("atom_expr", "power")
            and node.parent is not None
            and node.parent.type == "simple_stmt"
        )

    def mutate(self, node: Any, index: int) -> Any:
        return _parsed_like(node, "pass")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        return (Example("check(x)", "pass"),)


class UnwrapCall(_OneWay):
    """Put the argument in the place of a call with one argument: `abs(x)` becomes `(x)`."""

    def applies(self, node: Any) -> bool:
        # A raised or unused call is RemoveStatement's.
        unused = node.parent is not None and node.parent.type in ("simple_stmt", "raise_stmt")
        if unused or node.type not in ("atom_expr", "power"):
            return False
        last = node.children[-1]
        if last.type != "trailer" or last.children[0].value != "(" or len(last.children) != 3:
            return False
        return last.children[1].type not in ("arglist", "argument")

    def mutate(self, node: Any, index: int) -> Any:
        return _parsed_like(node, node.children[-1].get_code(include_prefix=False))

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        return (Example("y = abs(x)", "y = (x)"),)


class SwapReduction(_OneWay):
    """`all` for `any`, `max` for `min` and so on, in both directions."""

    def applies(self, node: Any) -> bool:
        return isinstance(node, Name) and node.value in SWAPS

    def mutate(self, node: Any, index: int) -> Any:
        node.value = SWAPS[node.value]
        return node

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        return (Example("x.all()", "x.any()"),)


def register() -> None:
    """Make the operators known to Cosmic Ray, for this process, as `skewmi/<name>`."""
    operators = (RemoveStatement, UnwrapCall, SwapReduction)
    plugins.OPERATOR_PROVIDERS["skewmi"] = {operator.__name__: operator for operator in operators}
