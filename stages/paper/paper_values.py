"""Values that the paper reports and fidpipe shows next to its own; the means of its scores are in `metrics`."""

from __future__ import annotations

from dataclasses import dataclass

from ...schemas.metric_catalogue import PaperMean

N_PAIRS = 50
N_MATCHED = 1067
MEDIAN_UNMATCHED_RANGE_M = 29.0

#: The settings that the paper chose in its ablation; it makes no choice of t.
CHOSEN = {"k": 90, "tau_m": 0.2, "delta_m": 5.0}
#: The influence of a setting on a score according to the paper.
INFLUENCES = {
    ("k", "match_rate"): "main influence",
    ("tau_m", "match_rate"): "main influence",
    ("delta_m", "match_rate"): "affects it",
    ("delta_m", "r_lambda_mean"): "no influence",
    ("t", "match_rate"): "no influence",
    ("t", "r_lambda_mean"): "negligible",
}

#: The scores of Table I.
TABLE_I_SCORES = ("match_rate", "centroid_distance_m_mean", "eigenspectrum_distance_mean")
#: Table I by kind, amount and shift (m) of the perturbation; mean and standard deviation over seeds of each score.
TABLE_I = {
    ("noise", 1e-3, 0.0): (PaperMean(0.9593, 0.0130), PaperMean(0.0202, 0.0323), PaperMean(0.0087, 0.0062)),
    ("noise", 1e-2, 0.0): (PaperMean(0.9533, 0.0400), PaperMean(0.0334, 0.0271), PaperMean(0.0209, 0.0038)),
    ("noise", 1e-1, 0.0): (PaperMean(0.9529, 0.0338), PaperMean(0.0733, 0.0586), PaperMean(0.0435, 0.0112)),
    ("dropout", 0.05, 0.0): (PaperMean(0.9150, 0.0528), PaperMean(0.2349, 0.0765), PaperMean(0.1003, 0.0176)),
    ("dropout", 0.20, 0.0): (PaperMean(0.8837, 0.0730), PaperMean(0.3753, 0.0945), PaperMean(0.3001, 0.0228)),
    ("dropout", 0.40, 0.0): (PaperMean(0.8543, 0.0233), PaperMean(0.6269, 0.1101), PaperMean(0.7855, 0.0572)),
    ("rigid", 0.5, 0.0): (PaperMean(1.0, 0.0), PaperMean(0.2063, 0.0), PaperMean(7.213e-6, 0.0)),
    ("rigid", 1.0, 0.0): (PaperMean(1.0, 0.0), PaperMean(0.4126, 0.0), PaperMean(1.576e-7, 0.0)),
    ("rigid", 2.0, 0.05): (PaperMean(1.0, 0.0), PaperMean(0.8299, 0.0049), PaperMean(4.494e-6, 5.511e-6)),
}


@dataclass(frozen=True)
class Timing:
    """A step of the paper's section "Pipeline Timing" with its milliseconds, and the steps of ours that do that work.

    steps : (stage, step); an empty step stands for all steps of the stage
    text : description of these steps; by default their names
    """

    name: str
    milliseconds: int
    steps: tuple[tuple[str, str], ...]
    text: str = ""


#: The last row is the paper's total, which does not include further scores (baselines, seeds).
TIMINGS = (
    Timing("community detection", 544, (("communities", "louvain"),)),
    Timing("Laplacians", 596, (("selection", "subgraphs"), ("selection", "laplacian"), ("metrics", "laplacian"))),
    Timing("heat kernel", 1505, (("selection", "heat"),)),
    Timing("alignment", 1532, (("selection", "alignment"),)),
    Timing(
        "all",
        7120,
        tuple((stage, "") for stage in ("ground", "graph", "communities", "matching", "selection", "metrics")),
        "every step of ground to metrics",
    ),
)
