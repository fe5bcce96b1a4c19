"""The worked pictures of docs/scores.md: matched objects whose scores are near given values, and why they are so.

`tools/pictures.py` draws them. Nothing is chosen by hand: of a run the object nearest to each value.
"""

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from matplotlib.collections import LineCollection
from PIL import Image

from fidpipe.pipeline.report.figures import style
from fidpipe.pipeline.report.look import SIDE_COLOURS
from fidpipe.pipeline.report.run_frames import coordinates
from fidpipe.schemas.columns import SIDES
from fidpipe.schemas.metric_catalogue import METRIC
from fidpipe.stages.coverage import nearest_distances
from fidpipe.stages.linalg.laplacian import induced_laplacian
from fidpipe.stages.linalg.spectrum import eigenvalues
from fidpipe.stages.linalg.subgraph import Edges, split_by_community

#: Nodes that an object needs to be looked at, and the most that a picture can show.
FEWEST_NODES, MOST_NODES = 150, 2000
GOOD_ALIGNMENT_M, BAD_ALIGNMENT_M = 0.5, 2.0
DPI, N_COLOURS = 150, 256
MOST_EDGES = 6000  #: more are thinned out evenly in a picture
WORDS = {"real": "real", "sim": "simulated"}


@dataclass(frozen=True)
class Example:
    """Criteria for an example object: its score, the value of the score, and the quality of its alignment."""

    name: str
    score: str
    value: float
    least_rms_m: float = 0.0
    most_rms_m: float = np.inf

    @property
    def heading(self):
        """Heading of its column: `r_lambda near 0.1`."""
        note = ", misaligned" if self.least_rms_m else ""
        return f"{METRIC[self.score].heading} near {self.value:g}{note}"


EXAMPLES = (
    *(
        Example(f"r_lambda_{value}", "r_lambda", value, most_rms_m=GOOD_ALIGNMENT_M)
        for value in (0.1, 0.4, 0.7)
    ),
    *(Example(f"cdc_{value}", "cdc", value) for value in (0.1, 0.5, 1.0)),
    Example("r_lambda_misaligned", "r_lambda", 0.1, least_rms_m=BAD_ALIGNMENT_M),
)
#: What the table under a picture has of its object, by column of `metrics`.
NUMBERS = (
    *(
        "n_real",
        "n_sim",
        "n_keep",
        "cdc",
        "centroid_distance_m",
        "max_eigenvalue_shift",
        "laplacian_change",
    ),
    *("r_lambda", "r_gap", "alignment_rms_m"),
)


def choose(matched, example):
    """The row of the object nearest to the value, of equally near ones the first, among those that can be drawn."""
    drawable = matched[matched.n_keep.between(FEWEST_NODES, MOST_NODES)]
    drawable = drawable[
        drawable.alignment_rms_m.between(example.least_rms_m, example.most_rms_m)
    ]
    drawable = drawable.assign(off=(drawable[example.score] - example.value).abs())
    return drawable.sort_values(["off", "pair_id", "real_id"]).iloc[0]


def numbers_table(rows):
    """Markdown: one column for each chosen object, what it is and its scores."""
    lines = ["| | " + " | ".join(own.heading for own in rows) + " |"]
    lines.append("|---|" + "---|" * len(rows))
    cells = [f"`{row.pair_id} {row.real_id}`, {row.group}" for row in rows.values()]
    lines.append(f"| pair and object | {' | '.join(cells)} |")
    for column in NUMBERS:
        cells = [
            f"{row[column]:.0f}" if column[:2] == "n_" else f"{row[column]:.3f}"
            for row in rows.values()
        ]
        lines.append(f"| `{column}` | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


class MatchedObject:
    """One matched object of a run: its points and graph on both sides and its aligned nodes.

    across : (3,) horizontal direction in which it is widest; pictures show it from the side, across and up
    """

    def __init__(self, results, row):
        selection = results.run.store.read_table("selection", row.pair_id).to_pandas()
        kept = selection[selection.real_id == row.real_id]
        self.row = row
        self.graphs = {}
        self.nodes = {}
        for side in SIDES:
            points = results.run.points(row.pair_id, side).query("not is_ground")
            ids = points.point_id.to_numpy()
            edges = results.run.edges(row.pair_id, side)
            ends = (np.searchsorted(ids, edges[end]).astype(np.int32) for end in ("src", "dst"))
            graph = Edges(*ends, edges.length_m.to_numpy())
            own_id = row[f"{side}_id"]
            community = points.community_id.to_numpy(np.int32)
            own = split_by_community(ids, coordinates(points), graph, community, [own_id])[
                own_id
            ]
            self.graphs[side] = own
            self.nodes[side] = np.searchsorted(own.point_ids, kept[f"{side}_point_id"])
        flat = np.concatenate([graph.points for graph in self.graphs.values()])[:, :2]
        self.across = np.append(
            np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][0], 0.0
        )

    def seen(self, points):
        """Points as the picture has them, (n, 2): metres across and up."""
        return np.column_stack([points @ self.across, points[:, 2]])

    def kept(self, side, *, centred=True):
        """The kept nodes of a side as the picture has them, in aligned order; by default about their own mean."""
        points = self.graphs[side].points[self.nodes[side]]
        return self.seen(points - points.mean(axis=0) if centred else points)

    def kept_edges(self, side):
        """The edges among the kept nodes of a side, (m, 2), by place in the aligned order."""
        own = self.graphs[side].adjacency[self.nodes[side]][:, self.nodes[side]].tocoo()
        return np.column_stack([own.row, own.col])[own.row < own.col]

    def laplacian(self, side):
        """The normalised Laplacian of the kept nodes of a side."""
        return induced_laplacian(self.graphs[side], self.nodes[side])


def draw(example, chosen, results, folder):
    """Writes the picture of an object that was chosen by its CDC or by its r_lambda."""
    draw_one = draw_geometry if example.score == "cdc" else draw_structure
    draw_one(MatchedObject(results, chosen), folder / f"{example.name}.png")


def draw_structure(own, path):
    """Left the graphs that are compared and their alignment, right why r_lambda is what it is."""
    row = own.row
    spectra = {side: eigenvalues(own.laplacian(side)) for side in SIDES}
    shifts = np.abs(spectra["sim"] - spectra["real"])
    with style.new_figure(9, 5, _title(row)) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=(1.35, 1))
        axes, between = three_views(left, np.concatenate([own.kept(side) for side in SIDES]))
        whole, apart = right.subplots(2, 1)
        for axis, side in zip(axes, SIDES, strict=False):
            places = own.kept(side)
            ends = own.kept_edges(side)
            shown = ends[:: len(ends) // MOST_EDGES + 1]
            look = {
                "colors": SIDE_COLOURS[side],
                "linewidths": 0.3,
                "alpha": 0.12,
                "rasterized": True,
            }
            axis.add_collection(LineCollection(places[shown], **look))
            style.dots(axis, places, 2.5, "black")
            title = (
                f"{WORDS[side]}:",
                f"{row.n_keep} of {row[f'n_{side}']} nodes,",
                f"{len(ends):,} edges",
            )
            axis.set_title(between.join(title))
        real, sim = own.kept("real"), own.kept("sim")
        axes[2].add_collection(
            LineCollection(np.stack([real, sim], axis=1), colors="black", linewidths=0.3)
        )
        for side, places in (("real", real), ("sim", sim)):
            style.dots(axes[2], places, 4, SIDE_COLOURS[side])
        axes[2].set_title(between.join(["aligned:", f"{row.alignment_rms_m:.2f} m apart"]))

        index = np.arange(1, len(shifts) + 1)
        for side, spectrum in spectra.items():
            whole.plot(
                index, spectrum, color=SIDE_COLOURS[side], linewidth=1.4, label=WORDS[side]
            )
        at = int(np.argmax(shifts))
        ends = sorted(spectrum[at] for spectrum in spectra.values())
        whole.vlines(at + 1, *ends, color="black", linewidth=1.2, zorder=3)
        whole.set(title="ordered eigenvalues of both Laplacians", ylabel="λ", ylim=(0, None))
        whole.legend(loc="upper left")
        apart.fill_between(index, shifts, color="#999999", linewidth=0, alpha=0.5)
        apart.plot(at + 1, shifts[at], "o", color="black", markersize=4)
        apart.axhline(row.laplacian_change, color="black", linewidth=1)
        apart.set(
            title=f"r_lambda = shift / change = {row.max_eigenvalue_shift:.3f} / {row.laplacian_change:.3f}"
            f" = {row.r_lambda:.3f}",
            xlabel="number of the eigenvalue, logarithmic", ylabel="|λ(sim) - λ(real)|",
            ylim=(0, 1.25 * row.laplacian_change),
        )  # fmt: skip
        apart.text(
            1, row.laplacian_change, " change: by Weyl no eigenvalue shifts more", va="bottom"
        )
        is_late = (at + 1) ** 2 > len(index)
        apart.annotate(
            "largest shift", (at + 1, shifts[at]), (-7 if is_late else 7, 2), textcoords="offset points",
            ha="right" if is_late else "left",
        )  # fmt: skip
        for axis in (whole, apart):
            axis.set(xscale="log", xlim=(1, len(index) * 1.05))
            ticks = [n for n in (1, 3, 10, 30, 100, 300, 1000) if n <= len(index)]
            axis.set_xticks(ticks, map(str, ticks))
        save(figure, path)


def draw_geometry(own, path):
    """Left how far each point is from the other side, right how that adds up to the CDC."""
    row = own.row
    points = {side: own.graphs[side].points for side in SIDES}
    distances = dict(zip(SIDES, nearest_distances(*points.values()), strict=True))
    costs = {side: 1 - np.exp(-(distances[side] ** 2)) for side in SIDES}
    with style.new_figure(9, 5, _title(row)) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=(1.35, 1))
        axes, between = three_views(
            left, np.concatenate([own.seen(points[side]) for side in SIDES])
        )
        far, total = right.subplots(2, 1, height_ratios=(1.8, 1))
        for axis, side in zip(axes, SIDES, strict=False):
            look = {"cmap": style.FIDELITY_COLOURS, "vmin": 0, "vmax": 1}
            coloured = style.dots(axis, own.seen(points[side]), 4, costs[side], **look)
            title = (
                f"{WORDS[side]}:",
                f"{len(points[side]):,} points,",
                f"mean cost {costs[side].mean():.3f}",
            )
            axis.set_title(between.join(title))
            style.dots(axes[2], own.seen(points[side]), 2.5, SIDE_COLOURS[side])
        axes[2].set_title(
            between.join(
                ["both as given,", "centroids", f"{row.centroid_distance_m:.2f} m apart"]
            )
        )
        left.colorbar(
            coloured,
            ax=axes,
            label="cost of a point, 1 - exp(-d²)",
            location="bottom",
            shrink=0.7,
            aspect=40,
        )

        reach = max(2.0, *(np.quantile(own_m, 0.99) for own_m in distances.values()))
        for side, own_m in distances.items():
            shares = np.arange(len(own_m) + 1) / len(own_m)
            look = {
                "where": "post",
                "color": SIDE_COLOURS[side],
                "label": f"{WORDS[side]} points nearer than d",
            }
            far.step(np.append(0, np.sort(own_m)), shares, **look)
        d = np.linspace(0, reach, 200)
        far.plot(
            d,
            1 - np.exp(-(d**2)),
            color="black",
            linewidth=1,
            linestyle="--",
            label="cost, 1 - exp(-d²)",
        )
        far.set(
            xlabel="d, distance to the other side (m)",
            ylabel="share of the points",
            xlim=(0, reach),
        )
        far.set_ylim(0, 1.02)
        far.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))
        sum_so_far = 0.0
        for side in SIDES:
            total.barh(
                0, costs[side].mean(), left=sum_so_far, color=SIDE_COLOURS[side], height=0.5
            )
            sum_so_far += costs[side].mean()
        total.set(xlim=(0, 2), ylim=(-0.6, 0.6), yticks=[], xlabel="0: the same points; 2: nothing near",
                  title=f"CDC = {costs['real'].mean():.3f} (real) + {costs['sim'].mean():.3f} (simulated)"
                  f" = {row.cdc:.3f}")  # fmt: skip
        save(figure, path)


def three_views(figure, places):
    """Axes of three views of the same places, true to scale, in a row or one above the other by their shape.

    Second comes what may stand between the parts of a title: a blank, or a new line where views are narrow.
    """
    low = places.min(axis=0)
    high = places.max(axis=0)
    width, height = high - low
    is_wide = width > 1.5 * height
    axes = figure.subplots(3, 1, sharex=True) if is_wide else figure.subplots(1, 3, sharey=True)
    margin = 0.03 * (high - low).max()
    for axis in axes:
        axis.set(
            xlim=(low[0] - margin, high[0] + margin),
            ylim=(low[1] - margin, high[1] + margin),
            aspect="equal",
        )
        axis.locator_params(nbins=8 if is_wide else 3, axis="x")
        axis.locator_params(nbins=3 if is_wide else 8, axis="y")
    for axis in axes[2:] if is_wide else axes:
        axis.set_xlabel("across (m)")
    for axis in axes if is_wide else axes[:1]:
        axis.set_ylabel("up (m)")
    return axes, " " if is_wide else "\n"


def save(figure, path):
    """Writes a figure as PNG of few colours: a page of them is small."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=DPI, bbox_inches="tight", pad_inches=0.08)
    Image.open(content).convert("RGB").quantize(N_COLOURS, dither=Image.Dither.NONE).save(
        path, optimize=True
    )


def _title(row):
    return f"pair {row.pair_id}, real object {row.real_id}: {row.group}, {row.range_m:.0f} m from the sensor"


def chosen_objects(results):
    """The chosen row of `results.matched` for each example."""
    return {example: choose(results.matched, example) for example in EXAMPLES}
