"""Names of the files that a sweep keeps in a run's folder, beside those of every run.

Apart from the rest, so that whoever only starts workers loads no tensor library: on a cluster that
is another program's process.
"""

RUN = "run.json"
"""What the run is; written before it starts."""
PARTS = "parts.jsonl"
"""A line per process that has worked on it: commit, host, since which step."""
RESULT = "result.json"
"""Written when it is done; without it, the run is not."""
LOG = "worker.log"
"""What its processes said."""
