"""Values that the paper reports and fidpipe shows next to its own; the means of its scores are in `metrics`."""

from __future__ import annotations

from ...schemas.data_files import read_data
from ...schemas.metric_catalogue import PaperMean

_PAPER = read_data("paper")
#: Steps of the section "Pipeline Timing": name, milliseconds, the steps of ours that do that work, and their text.
TIMINGS = _PAPER["timings"]
#: The scores of Table I.
TABLE_I_SCORES = ("match_rate", "centroid_distance_m_mean", "eigenspectrum_distance_mean")
#: Table I by kind, amount and shift (m) of the perturbation; mean and standard deviation over seeds of each score.
TABLE_I = {tuple(row["level"]): tuple(PaperMean(*row[score]) for score in TABLE_I_SCORES) for row in _PAPER["table_i"]}
