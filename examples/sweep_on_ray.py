"""A sweep on a Ray cluster of two nodes, both on this machine: a processor and a run each.

    pip install 'skewmi[cluster,train]'
    python examples/sweep_on_ray.py [FOLDER]       # some minutes

On real machines `ray start --head` and `ray start --address HEAD:6379` take the place of `Cluster`,
and the sweep's folder is on a disk that they share (docs/sweep.md).
"""

import os
import subprocess
import sys
from pathlib import Path

from ray.cluster_utils import Cluster

SWEEP = """
seeds: 2
set: {total_steps: 2_000, learner.hidden: [16, 16], learner.batch_size: 64}
groups:
  maze:
    tasks: [point_maze]
    configurations: [{name: "SAC + HER, Skew-Explore", preset: paper-reduced}]
"""

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/ray")
folder.mkdir(parents=True, exist_ok=True)
(folder / "maze.yaml").write_text(SWEEP)
os.environ.update(RAY_worker_niceness="0")  # else Ray's processes give way to all others
node = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
try:
    cluster.add_node(**node)
    cluster.wait_for_nodes()
    skewmi = [sys.executable, "-m", "skewmi.cli.main", "sweep", str(folder / "maze.yaml")]
    where = ["--engine", "ray", "--address", cluster.address, "--out", str(folder / "sweep")]
    sys.exit(subprocess.run([*skewmi, *where], check=False).returncode)
finally:
    cluster.shutdown()
