"""What becomes of a deployment beside CPU hogs, with and without real-time rights.

    python tests/adversarial/busy_computer.py --episodes 8 --out results/busy_computer.json

Each run is `skewmi deploy` in real time on its own simulated robot, as a user starts it, beside as
many hogs as processors. An ordinary user is one without the right to real-time priority and to
locked memory (CAP_SYS_NICE, CAP_IPC_LOCK), taken away by util-linux's `setpriv` and `prlimit`. Exit
code 1 if an episode of a run failed by what the computer did: stopped or in fault.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

import result_document

ORDINARY = (
    *("setpriv", "--bounding-set", "-sys_nice,-ipc_lock", "--inh-caps", "-sys_nice,-ipc_lock"),
    *("prlimit", "--rtprio=0:0", "--memlock=65536:65536"),
)
"""What a command is put behind so that it has no more rights than an ordinary user's."""


@contextmanager
def hogs(count: int) -> Iterator[None]:
    """Processes that do nothing, as fast as they can."""
    processes = [subprocess.Popen([sys.executable, "-c", "while 1: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def deploy(policy: str, episodes: int, seed: int, *, rights: bool, count: int) -> dict[str, Any]:
    """One run beside so many hogs: how its episodes ended."""
    command = [
        *(() if rights else ORDINARY),
        *(sys.executable, "-P", "-m", "skewmi.cli.main", "deploy", policy),
        *("--episodes", str(episodes), "--seed", str(seed), "--json"),
    ]
    with hogs(count):
        run = subprocess.run(command, capture_output=True, text=True, check=False)
    if not run.stdout.strip():
        sys.exit(f"{' '.join(command)} printed no report:\n{run.stderr}")
    report = json.loads(run.stdout.splitlines()[-1])
    ends = [(one["outcome"], one["reason"]) for one in report["per_episode"]]
    return {
        "real_time_rights": rights,
        "hogs": count,
        "exit_code": run.returncode,
        "episodes": len(ends),
        "successes": report["successes"],
        "by_the_computer": [reason for outcome, reason in ends if outcome in ("stopped", "fault")],
        "lock_step": report["lock_step"],
        "missed_cycles": report["missed_cycles"],
        "cycles": report["cycles"],
        "notes": report["notes"],
    }


def main() -> int:
    parser = result_document.argument_parser((__doc__ or "").splitlines()[0])
    parser.add_argument("--policy", default="open_press_close", help="bundled policy or file")
    parser.add_argument("--episodes", type=int, default=8, help="of each run")
    options = parser.parse_args()
    for tool in ("setpriv", "prlimit"):
        if shutil.which(tool) is None:
            sys.exit(f"{tool} is missing; it belongs to util-linux")
    processors, runs = len(os.sched_getaffinity(0)), []
    for rights, count in ((True, 0), (True, processors), (False, 0), (False, processors)):
        run = deploy(options.policy, options.episodes, options.seed, rights=rights, count=count)
        result_document.progress(json.dumps(run))
        runs.append(run)
    document = result_document.write_result(
        "busy_computer",
        {"runs": runs},
        options.out,
        seed=options.seed,
        config={"policy": options.policy, "episodes": options.episodes},
    )
    result_document.print_result(document, as_json=options.json)
    return int(any(run["by_the_computer"] for run in runs))


if __name__ == "__main__":
    sys.exit(main())
