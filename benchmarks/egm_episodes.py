"""OpenPressClose by a policy through the whole EGM chain, beside the simulated robot server.

Session, Zenoh, bridge, UDP, emulated controller and physics, in real time and in processes of
their own, at lags of 10 and 20 ms; and the same episodes on the simulated robot server, in the same
run. What counts is the difference: more than 3 points is to be explained.

    python benchmarks/egm_episodes.py --json --out results/egm_episodes.json      # some 15 minutes
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from common import argument_parser, print_result, progress, write_result

from skewmi.deploy.robot.process import EMULATED_COMM_TIMEOUT_S, free_port
from skewmi.policies import bundled

TASK = "open_press_close"
LAGS_MS = (10.0, 20.0)
KEPT = (
    "successes",
    "success_rate",
    "stops",
    "missed_cycles",
    "cycle_ms",
    "limit_fractions",
    "notes",
)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--episodes", type=int, default=30, help="of each robot")
    parser.add_argument("--policy", default=str(bundled()[TASK]), help="file")
    parser.add_argument("--feed-forward", type=float, default=1.0, help="fraction, 0..1")
    parser.add_argument("--lead-ms", type=float, default=24.0, help="how early a session sends, ms")
    arguments = parser.parse_args()
    options = ["--episodes", str(arguments.episodes), "--seed", str(arguments.seed), "--json"]
    options += ["--lead-ms", str(arguments.lead_ms)]
    found: dict[str, Any] = {}
    progress("the simulated robot server")
    found["sim"] = deploy([arguments.policy, "--robot", "sim", *options])
    for lag_ms in LAGS_MS:
        progress(f"the emulated controller, lag {lag_ms:g} ms")
        with chain(lag_ms, arguments.feed_forward) as locator:
            found[f"egm, lag {lag_ms:g} ms"] = deploy(
                [arguments.policy, "--connect", locator, *options]
            )
    config = {
        "episodes": arguments.episodes,
        "comm_timeout_s": EMULATED_COMM_TIMEOUT_S,
        "feed_forward": arguments.feed_forward,
        "lead_ms": arguments.lead_ms,
    }
    document = write_result(
        "egm_episodes", found, arguments.out, seed=arguments.seed, config=config
    )
    print_result(document, as_json=arguments.json)


def deploy(arguments: list[str]) -> dict[str, Any]:
    """`skewmi deploy` with these; what of its report is kept."""
    result = subprocess.run(
        [*SKEWMI, "deploy", *arguments], stdout=subprocess.PIPE, text=True, check=False
    )
    report = json.loads(result.stdout)
    kept = {key: report[key] for key in KEPT}
    steps = [e["steps"] for e in report["per_episode"] if e["outcome"] == "success"]
    kept["mean_steps_of_successes"] = round(sum(steps) / max(len(steps), 1), 1)
    kept["contact"] = report["contact"]
    return kept


@contextmanager
def chain(
    lag_ms: float, feed_forward: float, more: Sequence[str] = (), variation: str | None = None
) -> Iterator[str]:
    """A bridge, with more options, and an emulated controller; yields where the bridge listens."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    right, left = (f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}" for _ in range(2))
    bridge = ["egm", "--listen", locator, "--egm-listen", right, "--egm-listen-left", left]
    bridge += ["--egm-feed-forward", str(feed_forward), *more]
    emulator = ["egm-emulator", "--egm-remote", right, "--egm-remote-left", left]
    emulator += ["--connect", locator, "--egm-lag-ms", str(lag_ms)]
    emulator += ["--egm-comm-timeout-s", str(EMULATED_COMM_TIMEOUT_S)]
    emulator += [] if variation is None else ["--variation", variation]
    with _robot(bridge), _robot(emulator):
        yield locator


@contextmanager
def _robot(arguments: list[str]) -> Iterator[None]:
    child = subprocess.Popen(
        [*SKEWMI, "robot", "--backend", *arguments, "--json", "--end-with-input"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        if not child.stdout.readline():
            raise RuntimeError(f"{arguments[0]} did not start")
        yield
    finally:
        child.stdin.close()
        child.wait(20)


SKEWMI = [sys.executable, "-m", "skewmi.cli.main"]


if __name__ == "__main__":
    main()
