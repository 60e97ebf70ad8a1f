"""How many threads Zenoh has in every process of ours; children inherit it.

By itself Zenoh runs on one or two threads for each kind of work. When a peer falls silent (a laptop
that sleeps, a process that is stopped), the thread that closes its session waits for seconds, and
with some such peers at once none is left that takes in messages or lets anybody else connect.
`tests/adversarial/floods.py` measures how many peers a number of threads is enough for;
docs/security.md says it.
"""

from __future__ import annotations

import os

from skewmi.errors import TransportError

VARIABLE = "ZENOH_RUNTIME"

THREADS = {"rx": 16, "net": 16, "acc": 8, "tx": 8, "app": 2}
"""Kind of work -> threads: receiving, keeping up and closing sessions, accepting, sending, and the
users' own."""


def setting() -> str:
    """The threads in Zenoh's words."""
    parts = (f"{kind}: (worker_threads: {count})" for kind, count in THREADS.items())
    return f"({', '.join(parts)})"


def prepare() -> None:
    """Ask for the threads, unless the user has set the variable."""
    os.environ.setdefault(VARIABLE, setting())


def explain(error: BaseException) -> None:
    """Say what is wrong if an error of opening a session is about the threads: Zenoh panics then.

    Raises:
        TransportError: The variable is nonsense.
    """
    if "RuntimeParam" in str(error):
        raise TransportError(
            f"Zenoh cannot read its threads in {VARIABLE}={os.environ.get(VARIABLE)!r}: "
            f"unset it, or write {setting()}"
        ) from error
