"""What a run tells of itself after every iteration: the table's columns, and a line for people."""

from __future__ import annotations

COLUMNS = (
    "step",
    "trajectories",
    "updates",
    "return",
    "rewarded_fraction",
    "rewarded_episodes",
    "evaluation_return",
    "evaluation_fraction",
    "entropy",
    "coverage",
    "differential_entropy",
    "covered_cells",
    "coverage_own_units",
    "refresh",
    "trajectories_to_convergence",
    "trajectories_to_convergence_paper",
)
"""Of metrics.csv, followed by those of learner, exploration and time; `docs/skew-explore.md` says
what each means."""

TIME_COLUMNS = ("seconds_rollout", "seconds_goals", "seconds_update", "seconds")
"""Columns that differ between two runs of the same seed."""


def headline(metrics: dict[str, float]) -> str:
    """The metrics that matter, beside the progress bar."""
    shown = [f"{int(metrics['trajectories']):,} trajectories"]
    if "covered_cells" in metrics:
        shown.append(f"covered {metrics['covered_cells']:.0%}")
    if "entropy" in metrics:
        shown.append(f"entropy {metrics['entropy']:.1f}")
    shown.append(f"rewarded {metrics['rewarded_fraction']:.0%}")
    shown.append(f"converged {metrics['evaluation_fraction']:.0%}")
    return "  ".join(shown)
