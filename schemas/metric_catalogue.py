"""Catalogue of scores: name, unit, bounds, direction, meaning and source of each.

Columns of tables, headings of views, names of measures for a gate, limits of the report's quadrants and the list of
baseline metrics come from here. To add a score: a row here and the function that computes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

_METHOD_SECTION = 'paper, section "Graph-Based Validation Metrics"'


@dataclass(frozen=True)
class PaperMean:
    """A mean over the paper's pairs with its standard deviation."""

    mean: float
    std: float

    def __str__(self) -> str:
        return f"{self.mean:g} ± {self.std:g}"


@dataclass(frozen=True)
class Metric:
    """One score.

    column : name in the tables, with the unit if it has one
    heading : short name for table headings, without the unit
    meaning : one sentence: what the column holds
    reading : one sentence: how to read a value
    short : heading for narrow columns if `heading` is too long
    unit : "m", "m2", or None for a plain number
    low, high : bounds, or None
    better : direction of a better value; None for a number that does not measure quality
    equal : value for two identical objects (or scans); None if it depends on the object
    source : source of the definition
    paper : mean of the paper's 50 pairs
    is_count : values are integers
    is_nullable : a finished job may have no value
    has_mean : `pairs` has mean and standard deviation over the objects
    method : name in the setting metrics.baselines that selects it; "" for our own scores
    """

    column: str
    heading: str
    meaning: str
    reading: str = ""
    short: str = ""
    unit: str | None = None
    low: float | None = 0.0
    high: float | None = None
    better: Literal["lower", "higher"] | None = "lower"
    equal: float | None = 0.0
    source: str = ""
    paper: PaperMean | None = None
    is_count: bool = False
    is_nullable: bool = True
    has_mean: bool = True
    method: str = ""

    @property
    def label(self) -> str:
        """Heading with the unit, such as `offset (m)`."""
        return f"{self.heading} ({unit_words(self.unit)})" if self.unit else self.heading

    @property
    def narrow_label(self) -> str:
        """Heading for a narrow column: one word per line, the unit on the last line."""
        words = (self.short or self.heading).split()
        return "\n".join([*words, f"({unit_words(self.unit)})"] if self.unit else words)

    @property
    def mean_column(self) -> str:
        """Column of `pairs` with the mean over the objects of a pair."""
        return f"{self.column}_mean"

    @property
    def higher_is_better(self) -> bool:
        """True if a larger value is better."""
        return self.better == "higher"

    @property
    def scale(self) -> str:
        """Best and worst value as far as they exist, such as `0 best, 1 worst`."""
        best, worst = (self.high, self.low) if self.higher_is_better else (self.low, self.high)
        ends = [f"{value:g} {word}" for value, word in ((best, "best"), (worst, "worst")) if value is not None]
        return ", ".join(ends) if self.better else ""


def unit_words(unit: str | None) -> str:
    """Unit for display, such as m²; "" for a plain number."""
    return {"m2": "m²", None: ""}.get(unit, unit or "")


_spectral = partial(Metric, source=_METHOD_SECTION)
_metres = partial(Metric, unit="m", source="fidpipe")
_count = partial(Metric, is_count=True)
_share = partial(Metric, high=1.0, better="higher", equal=1.0)
_SIDES = (("real", "real"), ("sim", "simulated"))

#: The scores of a matched object, in the order of the columns of `metrics`.
OBJECT_SCORES = (
    Metric(
        "centroid_distance_m",
        "offset",
        "distance between the centroids",
        "distance between the centroids of matched objects",
        unit="m",
        source='paper, section "Controlled Perturbation Analysis", d_cent',
        is_nullable=False,
    ),
    Metric(
        "cdc",
        "CDC",
        "density-aware Chamfer distance of the paper, 0 to 2",
        "geometry: 0 for the same points, 2 without any near point",
        high=2.0,
        source='paper, equation "cdc"',
        paper=PaperMean(0.75, 0.02),
        is_nullable=False,
    ),
    _spectral(
        "r_lambda",
        "r_lambda",
        "max_eigenvalue_shift / laplacian_change, 0 to 1",
        "structure: share of the Laplacian's change that shifts its spectrum; 0 best, 1 worst",
        high=1.0,
        paper=PaperMean(0.37, 0.03),
    ),
    _spectral(
        "r_gap",
        "r_gap",
        "change of the spectral gap / (2 laplacian_change), 0 to 0.5",
        "structure: change of the overall connectivity; 0 best, 0.5 worst",
        high=0.5,
        paper=PaperMean(0.028, 0.014),
    ),
    _spectral(
        "max_eigenvalue_shift",
        "shift",
        "largest shift of an ordered eigenvalue",
        "largest shift of an ordered eigenvalue: the numerator of r_lambda",
        high=2.0,
    ),
    _spectral(
        "laplacian_change",
        "change",
        "spectral norm of the difference of the Laplacians",
        "spectral norm of the difference of the Laplacians: the denominator of r_lambda",
        high=2.0,
    ),
    Metric(
        "eigenspectrum_distance",
        "d_lambda",
        "Euclidean distance of the ordered spectra",
        "Euclidean distance of the ordered spectra; grows with the number of nodes",
        source='paper, section "Controlled Perturbation Analysis", d_lambda',
    ),
    *(
        _spectral(
            f"gap_{side}",
            f"gap, {side}",
            f"second smallest eigenvalue minus the smallest, {words}",
            f"second smallest eigenvalue of the {words} object",
            high=2.0,
            better=None,
            equal=None,
            has_mean=False,
        )
        for side, words in _SIDES
    ),
    Metric(
        "alignment_rms_m",
        "alignment",
        "root mean square distance of aligned nodes, both sides centred",
        "distance of aligned nodes; if it is large, do not trust r_lambda",
        short="align",
        unit="m",
        source="fidpipe; the cost of the paper's one-to-one alignment",
        is_nullable=False,
    ),
)

#: Scores of a pair as a whole, in the order of the columns of `seeds` and then of `pairs`.
PAIR_SCORES = (
    *(
        _count(f"n_communities_{side}", f"{words} objects", f"objects of the {words} side", better=None, equal=None)
        for side, words in _SIDES
    ),
    _count("n_matched", "matched objects", "objects that both sides have", better="higher", equal=None),
    *(
        _count(
            f"n_{kind}",
            f"{kind} objects",
            f"{own} objects without a {other} one",
            f"{own} objects without a {other} counterpart",
        )
        for kind, own, other in (("missing", "real", "simulated"), ("hallucinated", "simulated", "real"))
    ),
    _share(
        "match_rate",
        "match rate",
        "matched / max(communities of either side)",
        "objects that both sides have, over those of the side with more; 1 is best",
        source="paper, Algorithm 1",
        paper=PaperMean(0.594, 0.066),
    ),
)

#: Largest distance to the other side at which a point counts as covered, as in names of columns: 0.1, 0.3, 1 m.
COVERAGE_REACHES = ("0p1m", "0p3m", "1m")


def reach_words(reach: str) -> str:
    """Distance for display: `0.3 m` for `0p3m`."""
    return f"{reach.replace('p', '.').removesuffix('m')} m"


#: Coverage of both surfaces of a pair, in the order of the columns of `pairs`.
COVERAGE_SCORES = tuple(
    _share(
        f"covered_{side}_{reach}",
        f"{words} covered, {reach_words(reach)}",
        f"share of {words} object points with {an_other} object point at most {reach_words(reach)} away",
        f"surface: share of the {words} points with a point of the other side within {reach_words(reach)}; 1 is best",
        short=f"{side} in {reach_words(reach)}",
        source="fidpipe",
    )
    for side, words, an_other in (("real", "real", "a simulated"), ("sim", "simulated", "a real"))
    for reach in COVERAGE_REACHES
)

_ROUGHNESS = "standard deviation of the 20 nearest points from their plane"
_MEDIAN = "roughness of a typical point (median); the bias is a difference of means"

#: Displacement and roughness of the surfaces of a pair, in the order of the columns of `pairs`.
SURFACE_SCORES = (
    *(
        Metric(
            f"shift_{axis}_m",
            f"shift {axis}",
            f"displacement of the simulated surface along {axis}, point to plane",
            f"displacement of the simulated surface along {axis}; 0 if both are at the same place",
            unit="m",
            low=None,
            better=None,
            source="fidpipe; Chen and Medioni 1992",
        )
        for axis in "xyz"
    ),
    Metric(
        "shift_m",
        "shift",
        "length of the displacement along the observable directions",
        "the mean over pairs is a mean of lengths, which noise enlarges; for the mean vector see shift x, y and z",
        unit="m",
        source="fidpipe; Chen and Medioni 1992",
    ),
    *(
        _metres(
            f"roughness_{side}_m",
            f"roughness, {words}",
            f"median over {words} points: {_ROUGHNESS}",
            _MEDIAN,
            better=None,
            equal=None,
        )
        for side, words in _SIDES
    ),
    Metric(
        "roughness_bias_m",
        "roughness bias",
        "mean roughness, simulated minus real",
        "above 0 the simulated surface is rougher (noise), below 0 it is smoother. The roughest points dominate the "
        "mean, so the medians may differ in the other direction",
        unit="m",
        low=None,
        better=None,
        source="double validation metric, Rosenberger 2023",
    ),
    Metric(
        "roughness_area_m",
        "roughness area",
        "area between the two distributions of roughness after removing the bias",
        unit="m",
        source="double validation metric, Rosenberger 2023",
    ),
)

_PIECES = (("missing", "real", "simulated", "simulation"), ("invented", "simulated", "real", "real scan"))

#: Missing and invented pieces of surface of a pair, and share of found objects, in the order of the columns of `pairs`.
PIECE_SCORES = (
    *(
        Metric(
            f"n_{kind}_pieces",
            f"{kind} pieces",
            f"connected parts of {own} objects without a {other} point within pieces.reach_m",
            f"connected parts of {own} objects where the {place} has nothing",
            is_count=True,
            source="fidpipe",
        )
        for kind, own, other, place in _PIECES
    ),
    *(
        Metric(
            f"{kind}_pieces_share",
            f"share in {kind} pieces",
            f"share of the {own} object points that are in {kind} pieces",
            high=1.0,
            source="fidpipe",
        )
        for kind, own, *_ in _PIECES
    ),
    _share(
        "found",
        "found",
        "n_matched / (n_matched + n_missing)",
        "share of the real objects that have a simulated counterpart; 1 is best",
        source="fidpipe",
    ),
)

_RAY_OUTCOMES = (
    ("same", "rays whose ranges differ by at most 0.1 m or three standard deviations of the noise"),
    ("in_front", "rays on which the simulated return is nearer than the real one"),
    ("behind", "rays on which the simulated return is farther than the real one"),
    ("dropped", "rays that only the real side returned, with simulated surface within 0.3 m of the return"),
    ("no_surface", "rays that only the real side returned, without simulated surface within 0.3 m of the return"),
    ("sim_only", "rays that only the simulated side returned"),
)
_ray_error = partial(Metric, unit="m", source="fidpipe")

#: Scores of the rays of a pair, in the order of the columns of `ray_scores` and `pairs`.
RAY_SCORES = (
    Metric("n_rays", "rays", "rays with a return on either side", is_count=True, better=None, equal=None),
    *(
        Metric(
            f"rays_{name}",
            f"rays {name.replace('_', ' ')}",
            f"share of the {meaning}",
            high=1.0,
            better="higher" if name == "same" else "lower",
            equal=1.0 if name == "same" else 0.0,
            source="fidpipe",
        )
        for name, meaning in _RAY_OUTCOMES
    ),
    *(
        _share(
            f"rays_{name}_f1",
            f"rays, F1 of {name}s",
            f"2 n / (2 n + d): n rays that both sides {verb}, d rays that one side alone returned",
            source="fidpipe",
        )
        for name, verb in (("hit", "returned"), ("drop", "dropped"))
    ),
    _ray_error("rays_bias_m", "range bias", "median difference of ranges, simulated minus real", low=None, better=None),
    *(
        _ray_error(
            f"rays_bias_{end}_m",
            f"range bias, {end} end",
            f"{end} end of the 95 % interval of the range bias, for independent rays",
            low=None,
            better=None,
        )
        for end in ("low", "high")
    ),
    Metric("rays_scale", "range scale", "median of simulated over real range, minus 1", low=None, better=None),
    _ray_error("rays_mae_m", "range MAE", "mean absolute difference of ranges"),
    _ray_error("rays_medae_m", "range MedAE", "median absolute difference of ranges"),
    _ray_error("rays_p90_m", "range p90", "90 % of the absolute differences of ranges are below"),
    _ray_error("rays_rmse_m", "range RMSE", "root mean square difference of ranges"),
)

#: Those whose mean over pairs describes a run.
RAY_MEANS = tuple(
    metric.column for metric in RAY_SCORES if metric.column not in ("n_rays", "rays_bias_low_m", "rays_bias_high_m")
)

#: Scores of the intensities of a pair, in the order of the columns of `pairs`.
INTENSITY_SCORES = (
    Metric(
        "intensity_rank_corr",
        "intensity, rank correlation",
        "Spearman's correlation of both intensities on rays with the same range",
        low=-1.0,
        high=1.0,
        better="higher",
        equal=1.0,
        source="fidpipe",
    ),
    Metric(
        "intensity_rank_distance",
        "intensity, rank distance",
        "Wasserstein distance of the ranks of both intensities within bins of range and incidence",
        high=1.0,
        source="fidpipe",
    ),
    Metric(
        "intensity_ratio",
        "intensity ratio",
        "mean simulated over mean real intensity on rays with the same range",
        better=None,
        equal=1.0,
        source="fidpipe",
    ),
    Metric(
        "intensity_rmse",
        "intensity RMSE",
        "root mean square difference, if input.intensity_scale is same",
        source="fidpipe",
    ),
    *(
        Metric(
            f"intensity_{side}_by_{cause}",
            f"{side} intensity by {cause}",
            f"share of the variance of the ranks of the {word} intensity that {cause} explains",
            high=1.0,
            better=None,
            equal=None,
            source="fidpipe",
        )
        for side, word in _SIDES
        for cause in ("range", "incidence", "class")
    ),
)

#: Scores of the displacement of the simulated surface.
SHIFT_COLUMNS = ("shift_x_m", "shift_y_m", "shift_z_m", "shift_m")


def _baseline(method: str, column: str, meaning: str, **others: Any) -> Metric:
    """Baseline metric, headed by its column; the ending _m or _m2 of the column is the unit."""
    ending = column.rpartition("_")[2]
    return Metric(column, column, meaning, unit=ending if ending in ("m", "m2") else None, method=method, **others)


#: The baseline metrics, in the order in which they are computed and shown.
BASELINES = (
    _baseline(
        "chamfer",
        "chamfer_mean_m",
        "mean distance to the nearest point of the other side, from both sides, added; not squared",
    ),
    _baseline(
        "chamfer",
        "chamfer_squared_m2",
        "mean squared distance to the nearest point of the other side, from both sides, added",
    ),
    _baseline(
        "chamfer",
        "chamfer_one_way_sum_m",
        "sum over real points of the distance to the nearest simulated point",
        source="paper, equation of the Chamfer distance",
    ),
    _baseline("hausdorff", "hausdorff_m", "largest distance of a point of either side to the other side"),
    _baseline(
        "f_score",
        "f_score",
        "harmonic mean of the shares of points nearer than metrics.f_score_distance_m to the other side",
        high=1.0,
        better="higher",
        equal=1.0,
    ),
    _baseline(
        "dcd",
        "dcd",
        "published density-aware Chamfer distance, the real object scaled to a bounding box of diagonal 1",
        high=1.0,
        source="Wu et al., Density-aware Chamfer Distance, NeurIPS 2021",
    ),
    _baseline(
        "emd",
        "emd_mean_m",
        "exact earth mover's distance of all points of the object; all points of a side have the same weight",
        source="Rubner et al., The earth mover's distance, IJCV 2000",
    ),
    _baseline(
        "emd",
        "emd_kept_mean_m",
        "exact earth mover's distance of the kept nodes only, equally many on each side, mean per node",
    ),
    _baseline(
        "emd",
        "emd_centred_mean_m",
        "earth mover's distance of the kept nodes with both sides centred: the cost of the alignment",
    ),
    _baseline("sliced_wasserstein", "sliced_wasserstein_m", "mean earth mover's distance along random lines"),
    _baseline(
        "histogram", "histogram", "Minkowski distance of the histograms of pairwise distances divided by the maximum"
    ),
    _baseline(
        "icp",
        "icp_fitness",
        "share of simulated points within metrics.icp_distance_m of a real one after point-to-point ICP",
        high=1.0,
        better="higher",
        equal=1.0,
    ),
    _baseline("icp", "icp_rmse_m", "root mean square distance of these points"),
    _baseline(
        "netlsd",
        "netlsd",
        "distance of the heat-trace signatures of both graphs, all nodes",
        source="Tsitsulin et al., NetLSD, KDD 2018",
    ),
    _baseline(
        "r_h",
        "r_h",
        "change of the heat kernel over t times the change of the Laplacian, 0 to 1",
        high=1.0,
        source="source of the paper, not in its text",
    ),
)

_LIDAR4D = "Zheng et al., LiDAR4D, CVPR 2024: utils/metrics.py"
_LIDARGEN = "Zyrianov et al., LiDARGen, ECCV 2022, as R2DM's metrics/bev.py"
_NO_RETURN = "over all pixels of the range image, a pixel without a return being 0"


def _nvs(column: str, meaning: str, **others: Any) -> Metric:
    """Score of a paper on LiDAR synthesis, headed by its column."""
    ending = column.rpartition("_")[2]
    unit = {"m": "m", "m2": "m2", "db": "dB"}.get(ending)
    return Metric(column, column, meaning, unit=unit, **({"source": _LIDAR4D} | others))


def _nvs_image(what: str, ending: str, words: str) -> tuple[Metric, ...]:
    return (
        _nvs(f"nvs_{what}_rmse{ending}", f"root mean square difference of {words}, {_NO_RETURN}"),
        _nvs(f"nvs_{what}_medae{ending}", f"median absolute difference of {words}, {_NO_RETURN}"),
        _nvs(
            f"nvs_{what}_psnr_db",
            f"peak signal-to-noise ratio of the image of {words}",
            low=None,
            better="higher",
            equal=None,
        ),
        _nvs(
            f"nvs_{what}_ssim",
            f"structural similarity of the images of {words}",
            low=-1.0,
            high=1.0,
            better="higher",
            equal=1.0,
        ),
    )


#: Of a pair, and of all scans of a dataset at once.
BEV_JSD = _nvs(
    "bev_jsd_100x100_160m",
    "root of the Jensen-Shannon divergence of the points in 100 x 100 cells of 1.6 m seen from above, 3 to 70 m",
    high=math.sqrt(math.log(2)),
    source=_LIDARGEN,
)
#: Scores of papers on LiDAR synthesis as their code defines them, in the order in which they are computed and shown.
NVS_SCORES = (
    *_nvs_image("depth", "_m", "ranges"),
    *_nvs_image("intensity", "", "intensities"),
    _nvs("nvs_raydrop_rmse", "root of the share of pixels with a return on one side only", high=1.0),
    *(
        _nvs(f"nvs_raydrop_{name}", meaning, high=1.0, better="higher", equal=1.0)
        for name, meaning in (
            ("accuracy", "share of pixels with a return on both sides or on neither"),
            ("hit_f1", "F1 of the pixels with a return (not of the drops)"),
        )
    ),
    _nvs(
        "nvs_chamfer_m2", "mean squared distance to the nearest point of the other range image, both directions added"
    ),
    _nvs(
        "nvs_f_score_0p05m2",
        "harmonic mean of the shares of points with a squared distance below 0.05 m2 (22.4 cm) to the other image",
        high=1.0,
        better="higher",
        equal=1.0,
    ),
    BEV_JSD,
)
#: Score of all scans of a dataset at once.
BEV_MMD = _nvs(
    "bev_mmd_100x100_160m_sigma0p5",
    "squared maximum mean discrepancy of the same maps, each of sum 1; Gaussian kernel, sigma 0.5",
    source=_LIDARGEN,
)

#: Every score by its column.
METRIC = {
    metric.column: metric
    for metric in (
        *OBJECT_SCORES,
        *PAIR_SCORES,
        *COVERAGE_SCORES,
        *SURFACE_SCORES,
        *PIECE_SCORES,
        *RAY_SCORES,
        *INTENSITY_SCORES,
        *BASELINES,
        *NVS_SCORES,
        BEV_MMD,
    )
}

#: Object scores with mean and standard deviation in `pairs`, in that order.
OBJECT_METRICS = tuple(metric.column for metric in OBJECT_SCORES if metric.has_mean)
#: Object scores whose distributions over all objects a run reports.
DISTRIBUTED = ("cdc", "r_lambda", "r_gap")
#: Limits of the quadrants of the report, by fidpipe, not by the paper; a limit itself belongs to the better quadrant.
#: CDC: the sides are on average about half a metre apart (1 - exp(-0.54^2) = 0.25, twice). r_lambda: upper end of the
#: usual values for objects of a twin meshed from scans (the paper's mean is 0.37).
QUADRANT_LIMITS = {"cdc": 0.5, "r_lambda": 0.4}
#: Scores of a pair that are repeated under other seeds.
SEEDED_SCORES = (*(metric.column for metric in PAIR_SCORES), *(METRIC[name].mean_column for name in OBJECT_METRICS))
#: Columns of `pairs` whose mean and standard deviation over pairs describe the dataset.
DATASET_SCORES = ("match_rate", *(METRIC[name].mean_column for name in OBJECT_METRICS))
#: Columns of `pairs` that describe a run, which also measures surfaces.
RUN_SCORES = (
    *DATASET_SCORES,
    *(metric.column for metric in (*COVERAGE_SCORES, *SURFACE_SCORES, *PIECE_SCORES)),
    *RAY_MEANS,
    *(metric.column for metric in INTENSITY_SCORES if metric.equal is not None),
)
#: Columns of `pairs` in a summary of pairs and dataset.
HEADLINE_SCORES = ("match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean", "centroid_distance_m_mean")
#: Valid names in the setting metrics.baselines.
BASELINE_NAMES = tuple(dict.fromkeys(metric.method for metric in BASELINES))


def metric_of(column: str) -> Metric:
    """Score of a column of any table: `cdc` for `cdc` and for its mean over a pair, `cdc_mean`.

    Raises
    ------
    KeyError
        The catalogue has no score of that name.
    """
    return METRIC[column] if column in METRIC else METRIC[column.removesuffix("_mean")]


def labels(columns: Iterable[str]) -> list[str]:
    """Headings of columns, each with its unit."""
    return [metric_of(column).label for column in columns]


def narrow_labels(columns: Iterable[str]) -> list[str]:
    """Headings of narrow columns: one word per line, the unit on the last line."""
    return [metric_of(column).narrow_label for column in columns]


def to_markdown() -> str:
    """Markdown table of our own scores: name, column, range, direction, the paper's mean, and how to read it."""
    rows = ["| score | column | range | better | paper | meaning |", "|---|---|---|---|---|---|"]
    for metric in (METRIC["match_rate"], *OBJECT_SCORES):
        high = "" if metric.high is None else f" to {metric.high:g}"
        values = f"{metric.low:g}{high or ' or more'}" if metric.low is not None else "any"
        paper = "" if metric.paper is None else f"{metric.paper}"
        cells = (metric.label, f"`{metric.column}`", values, metric.better or "", paper, metric.reading)
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"
