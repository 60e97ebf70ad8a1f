"""What the extras of the package bring, and how to install one: for messages about what is missing.

The deployment side is installed without them: a robot's computer needs neither pictures nor
training. Whoever needs a module of an extra imports it where it is used.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from skewmi.errors import NotFoundError

MODULES: dict[str, tuple[str, ...]] = {
    "view": ("rerun", "rerun_bindings", "rerun_cli", "matplotlib", "PIL", "pyarrow"),
    "train": ("torch", "scipy", "onnx", "onnxscript", "safetensors", "cattrs", "tensorboard"),
    "security": ("cryptography",),
    "cluster": ("ray",),
}
"""Extra -> what one imports of it."""


def extra_of(module: str) -> str | None:
    """The extra that brings a module or its package; None if none does."""
    package = module.partition(".")[0]
    return next((extra for extra, modules in MODULES.items() if package in modules), None)


def install_line(extra: str | None = None) -> str:
    """The command that installs an extra into this installation of the package.

    Args:
        extra: One of `MODULES`; None for what every installation has.
    """
    wanted = "" if extra is None else f"[{extra}]"
    checkout = Path(__file__).resolve().parents[1]
    if (checkout / "pyproject.toml").is_file():
        return f"pip install -e '{checkout}{wanted}'"
    return f"pip install 'skewmi{wanted}'"


def is_installed(module: str) -> bool:
    """Whether a module could be imported, without importing it."""
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):
        return False


def require(what: str, *modules: str) -> None:
    """See that modules are installed, before any work is done for what needs them.

    Args:
        what: That needs them, such as "--live".
        modules: By the names that one imports.

    Raises:
        NotFoundError: One is not; the message says which extra brings it and how to install that.
    """
    for module in modules:
        if not is_installed(module):
            raise missing(what, ModuleNotFoundError(name=module))


def missing(what: str, error: ModuleNotFoundError) -> NotFoundError:
    """The error that says which package is missing, for what, and how to install it.

    Args:
        what: That needs it, such as "`skewmi replay`".
        error: Of the import.
    """
    name = (error.name or str(error)).partition(".")[0]
    extra = extra_of(name)
    of_extra = "" if extra is None else f" (extra {extra!r})"
    return NotFoundError(f"{what} needs the package {name!r}{of_extra}: {install_line(extra)}")
