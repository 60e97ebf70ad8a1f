"""What a loop asks of the operating system, and gives back."""

from __future__ import annotations

import gc
import os
import subprocess
import sys

import pytest

from skewmi.deploy.realtime import hot_loop


def test_hot_loop_leaves_collection_and_scheduling_as_they_were() -> None:
    enabled = gc.isenabled()
    with hot_loop(priority=False) as granted:
        assert not gc.isenabled()
        assert granted == ["gc frozen"]
    assert gc.isenabled() == enabled
    assert gc.get_freeze_count() == 0


HOT = """
import gc, os, re, resource, sys
from pathlib import Path
from skewmi.deploy.realtime import hot_loop
if sys.argv[1] == "refused":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    os.setgid(65534), os.setuid(65534)
def state():
    locked = int(re.search(r"VmLck:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO, locked > 0
before = state()
with hot_loop(priority=True) as granted:
    frozen = gc.get_freeze_count() > 0 and not gc.isenabled()
    print(granted == ["gc frozen"] * frozen
          + ["SCHED_FIFO"] * state()[0] + ["memory locked"] * state()[1], granted)
print(before[0] == state()[0] == False, gc.isenabled(), gc.get_freeze_count() == 0)
"""


@pytest.mark.parametrize("permission", ["allowed", "refused"])
def test_hot_loop_takes_what_it_is_permitted_and_tells_the_truth(permission: str) -> None:
    if permission == "refused" and os.getuid() != 0:
        pytest.skip("only root can give up the permission")
    command = [sys.executable, "-c", HOT, permission]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    told, after = result.stdout.splitlines()
    assert told.startswith("True")
    assert after == "True True True"
    if permission == "refused":
        assert told == "True ['gc frozen']"
