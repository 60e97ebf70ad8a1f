"""All small changes of a module, by Cosmic Ray's operators and by some of our own.

Cosmic Ray replaces operators, numbers and conditions. What would hurt most in code that refuses
commands is not among them: a check that is not called, an error that is not raised, `any` in the
place of `all`, a missing absolute value. The operators here weaken a check in these ways.

Left out: changes of annotations, which are not executed; shifts, bit operations, `//` and `%` in
the place of arithmetic; identity (`is`) in the place of comparisons of numbers.
"""

from __future__ import annotations

import ast
import difflib
import pickle
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import parso
from cosmic_ray import plugins
from cosmic_ray.commands.init import init
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import MutationSpec
from parso.python.tree import Name

Position = tuple[tuple[int, int], tuple[int, int]]

LEFT_OUT = re.compile(
    r".*BinaryOperator.*_(RShift|LShift|BitOr|BitAnd|BitXor|FloorDiv|Mod)$"
    r"|.*ComparisonOperator_(Eq|NotEq|Lt|LtE|Gt|GtE)_(Is|IsNot)$"
)

SWAPS = {
    "all": "any",
    "any": "all",
    "max": "min",
    "min": "max",
    "maximum": "minimum",
    "argmax": "argmin",
}


@dataclass(frozen=True)
class Mutant:
    """One change of a module."""

    place: str
    """File and function."""
    mutation: str
    """The changed lines before and after, in Markdown."""
    operator: str
    diff: str
    content: str
    """The whole file with the change."""


def list_mutants(path: Path) -> list[Mutant]:
    """Every mutation that the operators know and that is not left out, in order of the source."""
    with tempfile.TemporaryDirectory() as folder, use_db(Path(folder) / "session") as database:
        init([path], database, {})
        found = [item.mutations[0] for item in database.work_items]
    source = path.read_text(encoding="utf-8")
    annotations = _annotations(source)
    # A mutation changes the syntax tree; loading a copy of it is quicker than parsing again.
    sys.setrecursionlimit(100_000)
    tree = pickle.dumps(parso.parse(source))
    mutants = []
    for mutation in sorted(found, key=lambda m: (m.start_pos, m.operator_name, m.occurrence)):
        annotated = any(begin <= mutation.start_pos < end for begin, end in annotations)
        if annotated or LEFT_OUT.match(mutation.operator_name):
            continue
        operator = plugins.get_operator(mutation.operator_name)()
        changed = MutationVisitor(mutation.occurrence, operator).walk(pickle.loads(tree)).get_code()
        if _is_code(changed):
            mutants.append(_describe(mutation, source, changed))
    return mutants


def _annotations(source: str) -> list[Position]:
    """Where annotations begin and end; `from __future__ import annotations` defers them all."""
    found = []
    for node in ast.walk(ast.parse(source)):
        for field in ("annotation", "returns"):
            a = getattr(node, field, None)
            if a is not None:
                found.append(((a.lineno, a.col_offset), (a.end_lineno, a.end_col_offset)))
    return found


def _is_code(source: str) -> bool:
    """Cosmic Ray takes the `*` before keyword-only parameters for a multiplication."""
    try:
        ast.parse(source)
    except SyntaxError:
        return False
    return True


def _describe(mutation: MutationSpec, old: str, new: str) -> Mutant:
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
        content=new,
    )


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


_OPERATORS = (RemoveStatement, UnwrapCall, SwapReduction)
# Cosmic Ray looks for operators among installed packages; these are known to this process only.
plugins.OPERATOR_PROVIDERS["skewmi"] = {operator.__name__: operator for operator in _OPERATORS}
