"""A wall clock for child processes that can be set without touching the machine's.

A small C library that is preloaded adds an offset to CLOCK_REALTIME, for Python and Zenoh alike.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

_SOURCE = Path(__file__).with_name("fault_clock.c")


class WallClock:
    """The clock.

    Args:
        folder: For library and offset.

    Raises:
        RuntimeError: There is no C compiler.
    """

    def __init__(self, folder: Path) -> None:
        compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
        if compiler is None:
            raise RuntimeError("no C compiler")
        library = folder / "clock.so"
        command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(_SOURCE), "-ldl"]
        subprocess.run(command, check=True)
        self._offset = folder / "offset"
        self.jump(0)
        self.environment = {"LD_PRELOAD": str(library), "SKEWMI_FAULTS_CLOCK": str(self._offset)}

    def jump(self, offset_s: int) -> None:
        """Set the clocks to so many seconds after the true time."""
        mode = "r+b" if self._offset.exists() else "wb"
        with self._offset.open(mode, buffering=0) as file:
            file.write(struct.pack("<q", offset_s))
