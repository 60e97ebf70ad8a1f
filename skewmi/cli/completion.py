"""Completion of commands, their options and what these may be, in bash, zsh or fish.

Print the script and let the shell read it, once or from its start-up file:

  bash:  eval "$(skewmi completion bash)"
  zsh:   eval "$(skewmi completion zsh)"
  fish:  skewmi completion fish | source

The script knows every command of this installation; write it anew after an update. It is made in
some seconds and starts nothing when a key is pressed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skewmi.cli.completion_scripts import bash_script, fish_script, zsh_script
from skewmi.cli.completion_words import every_entry
from skewmi.outputs import check_output, written_aside

SCRIPTS = {"bash": bash_script, "zsh": zsh_script, "fish": fish_script}


@dataclass(frozen=True)
class CompletionCommand:
    """Options of `skewmi completion`."""

    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.Positional]
    """Whose script."""
    out: Path | None = None
    """File to write; printed without."""
    overwrite: bool = False
    """Replace an existing file."""


def run_completion(options: CompletionCommand) -> int:
    """Print or write the script. Returns 0."""
    if options.out is not None:
        check_output(options.out, overwrite=options.overwrite)
    script = SCRIPTS[options.shell](every_entry())
    if options.out is None:
        print(script, end="")
        return 0
    with written_aside(options.out) as draft:
        draft.write_text(script, encoding="utf-8")
    print(f"wrote {options.out}")
    return 0
