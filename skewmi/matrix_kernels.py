"""Fast products of matrices on processors that are not Intel's.

torch on a processor multiplies by Intel's MKL, which asks who made the processor before it looks at
what it can do. AMD's with AVX2 or AVX-512 get kernels that do less than half as many products a
second as the others on the same processor (`benchmarks/matrix_kernels.py`). The question is one
function, `mkl_serv_intel_cpu_true`, and a library that is loaded before torch may answer it. The
others' roundings differ, as between processors; they are MKL's own, and ask what the processor can
do.

Nothing here imports torch.
"""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

VARIABLE = "SKEWMI_MKL_KERNELS"
"""Environment variable; `default` leaves MKL alone."""

TAKEN = (
    f"products of matrices by MKL's AVX kernels, on an AMD processor, too ({VARIABLE}=default: not)"
)
"""What is told of it."""

_SOURCE = 'extern "C" int mkl_serv_intel_cpu_true(void) { return 1; }\n'
_CPUINFO = Path("/proc/cpuinfo")
_VENDORS = ("AuthenticAMD", "HygonGenuine")
_BUILD_TIMEOUT_S = 60.0
_taken = False


def taken() -> bool:
    """Whether this process has them."""
    return _taken


def name_of_taken() -> str:
    """`avx` if this process has them, else `default`."""
    return "avx" if _taken else "default"


def would_help(cpuinfo: Path = _CPUINFO) -> bool:
    """Whether MKL passes over kernels that this processor could run.

    Args:
        cpuinfo: As Linux tells it.
    """
    if platform.machine() != "x86_64":
        return False
    try:
        told = cpuinfo.read_text()
    except OSError:  # not Linux
        return False
    fields = {
        key.strip(): value.strip()
        for key, _, value in (line.partition(":") for line in told.splitlines())
    }
    return fields.get("vendor_id") in _VENDORS and "avx2" in fields.get("flags", "").split()


def compiler() -> str | None:
    """Path of the C++ compiler, which torch takes, too: what CXX names, else g++."""
    return shutil.which(os.environ.get("CXX", "g++"))


def take_fast_kernels() -> bool:
    """Let MKL take them in this process; call it before anything imports torch.

    It does nothing where it would not help, without a C++ compiler (g++, or what CXX names), after
    torch has been imported, or if `SKEWMI_MKL_KERNELS` is `default`.

    Returns:
        Whether they will be taken.
    """
    global _taken
    if _taken or "torch" in sys.modules or os.environ.get(VARIABLE) == "default":
        return _taken
    if would_help():
        _taken = _answer()
    return _taken


def _answer() -> bool:
    """Load a library with the answer; whether that went well."""
    found = compiler()
    if found is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "libmkl_kernels.so"
        try:
            build(found, library)
            # Whoever looks the function up later, as torch's libraries do, finds this one first.
            # A loaded library is not needed as a file any more.
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        except (OSError, subprocess.SubprocessError):
            return False
    return True


def build(cxx: str, library: Path) -> None:
    """Write the library.

    Args:
        cxx: A C++ compiler, see `compiler`.
        library: Where to.

    Raises:
        OSError, subprocess.SubprocessError: The compiler does not run, or fails.
    """
    subprocess.run(
        [cxx, "-shared", "-fPIC", "-x", "c++", "-", "-o", str(library)],
        input=_SOURCE,
        text=True,
        capture_output=True,
        check=True,
        timeout=_BUILD_TIMEOUT_S,
    )
