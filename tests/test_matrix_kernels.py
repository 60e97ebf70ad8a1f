"""MKL's kernels on processors that are not Intel's: where they are taken, and whether right."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from skewmi import matrix_kernels

AMD = "vendor_id\t: AuthenticAMD\nflags\t\t: fpu avx avx2 avx512f\n"

COMPARED = """
import ctypes
import numpy as np
from skewmi.matrix_kernels import take_fast_kernels
assert take_fast_kernels() and take_fast_kernels()
assert ctypes.CDLL(None).mkl_serv_intel_cpu_true() == 1
import torch
rng = np.random.default_rng(0)
for _ in range(300):
    m, k, n = rng.integers(1, 300, size=3)
    a, b = rng.normal(size=(m, k)), rng.normal(size=(k, n))
    for left, right in ((a, b), (np.asfortranarray(a), b), (a, np.asfortranarray(b))):
        given = torch.tensor(left.astype(np.float32)), torch.tensor(right.astype(np.float32))
        exact = given[0].double().numpy() @ given[1].double().numpy()
        size = np.abs(given[0].double().numpy()) @ np.abs(given[1].double().numpy())
        error = np.abs((given[0] @ given[1]).numpy() - exact)
        assert (error <= 1e-6 * k**0.5 * size + 1e-12).all(), (m, k, n, error.max())
x = torch.randn(4096, dtype=torch.float32)
for f in (torch.exp, torch.tanh, torch.log1p, torch.sigmoid):
    y = f(x.abs()), f(x.abs().double())
    assert torch.allclose(y[0].double(), y[1], rtol=1e-5, atol=1e-6), f
print("right")
"""

REFUSED = """
import sys
from skewmi.matrix_kernels import take_fast_kernels, taken
if sys.argv[1:] == ["torch"]:
    import torch
assert not take_fast_kernels() and not taken()
print("left alone")
"""


def child(script: str, *arguments: str, **environment: str) -> str:
    kept = {name: value for name, value in os.environ.items() if name != matrix_kernels.VARIABLE}
    command = [sys.executable, "-c", script, *arguments]
    ended = subprocess.run(
        command, env={**kept, **environment}, text=True, capture_output=True, timeout=120
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.strip()


needs_amd = pytest.mark.skipif(
    not matrix_kernels.would_help() or matrix_kernels.compiler() is None,
    reason="MKL takes them by itself here, or there is no C++ compiler",
)


@needs_amd
def test_products_are_those_of_double_precision() -> None:
    assert child(COMPARED) == "right"


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [
        ([], {matrix_kernels.VARIABLE: "default"}),
        ([], {"CXX": "no-such-compiler"}),
        ([], {"CXX": "false"}),
        (["torch"], {}),
    ],
    ids=["switched off", "without a compiler", "with one that fails", "after torch"],
)
def test_mkl_is_left_alone(arguments: list[str], environment: dict[str, str]) -> None:
    assert child(REFUSED, *arguments, **environment) == "left alone"


@pytest.mark.parametrize(
    ("told", "helps"),
    [
        (AMD, True),
        (AMD.replace("AuthenticAMD", "GenuineIntel"), False),
        (AMD.replace(" avx2", ""), False),
        ("", False),
        ("processor : 0\nnonsense\n", False),
    ],
)
def test_they_help_on_amd_with_avx2(told: str, helps: bool, tmp_path: Path) -> None:
    if matrix_kernels.platform.machine() != "x86_64":
        pytest.skip("another architecture")
    (tmp_path / "cpuinfo").write_text(told)
    assert matrix_kernels.would_help(tmp_path / "cpuinfo") is helps
    assert not matrix_kernels.would_help(tmp_path / "missing")
