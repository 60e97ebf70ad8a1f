"""What MKL's fast kernels bring on a processor that is not Intel's: updates of soft actor-critic.

    python benchmarks/matrix_kernels.py --json

`benchmarks/sac.py` by turns with the kernels that MKL chooses by itself and with those of
`skewmi.matrix_kernels`, each time in a process of its own. Three minutes.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import REPOSITORY, argument_parser, print_result, progress, write_result

from skewmi import matrix_kernels

HOWS = ("chosen_by_mkl", "fast")
KEPT = ("compiled", "eager", "straightforward", "gemm", "stable_baselines3")


def updates(environment: dict[str, str], seed: int) -> dict[str, dict[str, float]]:
    """Milliseconds of an update by size and implementation, median of the turns."""
    command = [sys.executable, str(REPOSITORY / "benchmarks" / "sac.py"), "--json"]
    output = subprocess.run(
        [*command, "--seed", str(seed)],
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    document = json.loads(output)
    return {
        size: {name: figures["milliseconds_per_update"][name][1] for name in KEPT}
        for size, figures in document.items()
        if isinstance(figures, dict) and "milliseconds_per_update" in figures
    }


def measure(turns: int, seed: int) -> dict[str, Any]:
    """Both ways by turns; medians over the turns, and how much faster the fast one is."""
    compiler = matrix_kernels.compiler()
    if compiler is None or not matrix_kernels.would_help():
        sys.exit("this needs a processor of AMD with AVX2, and a C++ compiler")
    found: dict[str, list[dict[str, dict[str, float]]]] = {how: [] for how in HOWS}
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "libmkl_kernels.so"
        matrix_kernels.build(compiler, library)
        environments = {"chosen_by_mkl": {}, "fast": {"LD_PRELOAD": str(library)}}
        for turn in range(turns):
            for how in HOWS:
                progress(f"turn {turn + 1} of {turns}: {how}")
                found[how].append(updates(environments[how], seed))
    sizes = found["fast"][0]
    medians = {
        size: {
            name: {how: statistics.median(t[size][name] for t in found[how]) for how in HOWS}
            for name in KEPT
        }
        for size in sizes
    }
    times_faster = {
        size: {
            name: round(by_how["chosen_by_mkl"] / by_how["fast"], 3)
            for name, by_how in named.items()
        }
        for size, named in medians.items()
    }
    return {"milliseconds_per_update": medians, "times_faster": times_faster, "turns": found}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--turns", type=int, default=3, help="of each")
    options = parser.parse_args()
    measured = measure(options.turns, options.seed)
    document = write_result(
        "matrix_kernels", measured, options.out, seed=options.seed, config={"turns": options.turns}
    )
    print_result(document, as_json=options.json)


if __name__ == "__main__":
    main()
