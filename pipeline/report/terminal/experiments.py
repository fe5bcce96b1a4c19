"""What the terminal shows of any experiment at its end: failures, jobs, and where the results are."""

from __future__ import annotations

from rich.text import Text

from ...experiments.experiment import ExperimentOutcome


def sweep_lines(outcome: ExperimentOutcome, results: str) -> list[Text]:
    """The last lines.

    Parameters
    ----------
    results : which files of the folder hold what
    """
    return [
        *(Text(f"failed: {name}: {reason}", style="red") for name, reason in outcome.failures.items()),
        Text(f"{outcome.n_made} jobs done, {outcome.n_reused} reused, in {outcome.wall_s:.1f} s"),
        Text(f"results: {outcome.folder}/{results}"),
    ]
