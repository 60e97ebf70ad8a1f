"""Malformed datagrams, to the bridge's process and to its parts in motion.

A million of them: `python tests/adversarial/egm_flood.py --count 1000000`.
"""

from __future__ import annotations

import numpy as np
import pytest
from egm_bench import Bench, in_degrees
from egm_datagrams import malformed
from egm_flood import run

from skewmi.deploy.robot.states import ServerState


def test_the_bridge_holds_tells_and_goes_on() -> None:
    found = run(5_000, seed=1)
    assert found["sent"] == 5_000
    assert found["counted_by_the_bridge"] > 0


@pytest.mark.slow
def test_the_bridge_outlives_a_hundred_thousand() -> None:
    assert run(100_000, seed=2)["sent"] == 100_000


def test_a_motion_is_not_changed_by_them() -> None:
    with Bench() as alone, Bench() as flooded:
        datagrams = malformed(np.random.default_rng(3), alone.controller.packet)
        for bench in (alone, flooded):
            bench.moving(size=0.2)
        references = []
        for bench in (alone, flooded):
            answers = []
            for _ in range(100):
                if bench is flooded:
                    for _ in range(20):
                        bench.controller.send_bytes(next(datagrams))
                answers += bench.run(1)
            references.append(in_degrees(answers))
            assert bench.robot.state is not ServerState.FAULT
        np.testing.assert_array_equal(references[0], references[1])
        assert flooded.backend.right is not None
        assert flooded.backend.right.watch.unusable == 2_000
        assert "not a packet of a YuMi" in flooded.backend.told()["unusable_reason"]
