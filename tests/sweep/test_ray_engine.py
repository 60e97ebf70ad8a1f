"""A sweep on a Ray cluster of two nodes, one of which goes away."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from tiny_sweeps import (
    assert_nothing_lost_or_doubled,
    is_alive,
    run_dirs,
    start_driver,
    under_way,
    wait_until,
    worker_of,
    write_sweep,
)

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sweep.engine import INVISIBLE
from skewmi.sweep.ray_engine import opened_ray, train_here
from skewmi.sweep.run_folder import is_done, read_parts

STEPS = 8_000
MEMORY = 80 * 2**20


def test_a_machine_that_does_not_see_the_folder_says_so(tmp_path: Path) -> None:
    assert train_here(str(tmp_path / "elsewhere"), 1) == INVISIBLE


@pytest.mark.slow
def test_a_lost_node_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    # Ray's workers are as nice as can be, and on a busy computer would never get their turn.
    monkeypatch.setenv("RAY_worker_niceness", "0")
    from ray.cluster_utils import Cluster

    file, out = write_sweep(tmp_path, STEPS), tmp_path / "sweep"
    folders = run_dirs(file, out)
    node = {"num_cpus": 1, "object_store_memory": MEMORY}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    try:
        lost = cluster.add_node(**node)
        cluster.wait_for_nodes()
        driver = start_driver(file, out, "--engine", "ray", "--address", cluster.address)
        try:
            wait_until(lambda: all(under_way(f, 400) for f in folders), "both runs are under way")
            workers = [worker_of(folder) for folder in folders]
            cluster.remove_node(lost, allow_graceful=False)
            wait_until(
                lambda: sum(not is_alive(w) for w in workers) == 1 or all(map(is_done, folders)),
                "the node's worker has ended with it",
            )
            assert driver.wait() == 0
        finally:
            driver.kill()
            driver.wait()
    finally:
        cluster.shutdown()
    # One run was lost with its node and begun again on the other; one was not touched.
    assert sorted(len(read_parts(folder)) for folder in folders) == [1, 2]
    assert_nothing_lost_or_doubled(folders, tmp_path)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "127.0.0.1:99999"])
def test_no_cluster_there_is_said_at_once(address: str) -> None:
    pytest.importorskip("ray")
    with (
        pytest.raises(ConfigurationError, match=f"no Ray cluster at {address}"),
        opened_ray(address, 1, None),
    ):
        raise AssertionError("it is open")


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="Ray is installed")
def test_a_missing_ray_is_said() -> None:
    with pytest.raises(NotFoundError, match=r"\[cluster\]"), opened_ray(None, 1, None):
        raise AssertionError("it is open")
