"""Which score sees which flaw of a simulator, and how many pairs does it take?

    python benchmarks/power.py ../shared/data/kitti_twin TWINS --every 4 --out power

Each pair is scored as it is and again with a known flaw on its simulated side, in three amounts, under both presets. t
is the mean change of a score over the pairs in standard errors; *pairs* how many are needed to see that change in 80 %
of the cases at 5 % (`power_analysis.py`). Rows are kept in POWER.csv beside the table and the figure, and
a run that was stopped goes on. Two standard errors are nothing: among twenty scores one is expected by chance.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import zlib
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np
import pandas as pd

import fidpipe
from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.metric_catalogue import metric_of
from fidpipe.schemas.settings import load
from fidpipe.stages.generate.flaws import FLAWS as TWIN_FLAWS
from power_analysis import effect_size, paired_t, pairs_needed
from wrong_beams import BEAMS

FLAWS = TWIN_FLAWS | {"beams": BEAMS}
AMOUNTS = {
    "dropout": (0.1, 0.3, 0.5),
    "far-dropout": (0.3, 0.6, 0.9),
    "holes": (6, 12, 24),
    "ghosts": (0.02, 0.05, 0.1),
    "foliage": (0.25, 0.5, 1.0),
    "noise": (0.02, 0.05, 0.1),
    "offset": (0.05, 0.1, 0.2),
    "yaw": (0.25, 0.5, 1.0),
    "blur": (0.1, 0.2, 0.4),
    "beams": (0.25, 0.5, 1.0),
    "mirrored": (1,),
}
#: The table of the issue that asked for this benchmark: flaws that every preset should see.
CORE = (
    *(("dropout", 0.1), ("dropout", 0.3), ("far-dropout", 0.6), ("holes", 12)),
    *(("ghosts", 0.05), ("noise", 0.1), ("offset", 0.2)),
)
PRESETS = ("paper", "reference")
BASELINES = "chamfer,hausdorff,f_score,dcd"
NONE = "none"
OWN = (
    *("match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean", "eigenspectrum_distance_mean"),
    *("centroid_distance_m_mean", "n_not_found", "n_extra"),
    *(
        f"covered_{side}_{reach}"
        for side in ("real", "sim")
        for reach in ("0p1m", "0p3m", "1m")
    ),
    *("shift_x_m", "shift_y_m", "shift_z_m", "shift_m", "roughness_bias_m", "roughness_area_m"),
)


def tasks(datasets, flaws):
    """One for each pair, flaw, amount and preset."""
    wanted = [
        (NONE, 0.0),
        *((name, float(amount)) for name in flaws for amount in AMOUNTS[name]),
    ]
    for folder in datasets:
        for pair in read_dataset(folder).pairs:
            if pair.T_real_sim is not None:
                raise SystemExit(
                    f"{folder}, pair {pair.pair_id}: T_real_sim is not supported here"
                )
            for flaw, amount in wanted:
                for preset in PRESETS:
                    yield (
                        f"{folder.name}/{pair.pair_id}",
                        flaw,
                        amount,
                        preset,
                        pair.real,
                        pair.sim,
                    )


def scored(name, flaw, amount, preset, real, sim, every):
    """The row of one task."""
    points = [read_scan(path).points[::every] for path in (real, sim)]
    if flaw != NONE:
        seed = 0 if FLAWS[flaw].is_systematic else zlib.crc32(f"{name} {flaw}".encode())
        points[1] = FLAWS[flaw](points[1], amount, np.random.default_rng(seed))
    # Distances of whole scans do not depend on the objects: once is enough
    settings = load(
        None, [f"metrics.baselines={BASELINES}"] if preset == PRESETS[0] else [], preset=preset
    )
    row = {"pair": name, "flaw": flaw, "amount": amount, "preset": preset}
    try:
        result = fidpipe.evaluate_pair(*points, settings)
    except StageError as error:
        return row | {"reason": str(error)}
    row |= {name: result.summary[name] for name in OWN}
    if result.baselines is not None:
        scans = result.baselines[result.baselines.real_id.isna()]
        row |= dict(zip(scans.baseline, scans.value, strict=True))
    return row


def measure(args, path):
    """All rows, those that are there already and those that are made now."""
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    done = {(row["pair"], row["flaw"], row["amount"], row["preset"]) for row in rows}
    todo = [task for task in tasks(args.datasets, args.flaws) if task[:4] not in done]
    with ProcessPoolExecutor(args.workers) as pool:
        futures = [pool.submit(scored, *task, args.every) for task in todo]
        for n, future in enumerate(as_completed(futures), 1):
            rows.append(future.result())
            if n % 20 == 0 or n == len(todo):
                pd.DataFrame(rows).to_csv(path, index=False)
                print(f"\r{n} of {len(todo)}", end="", flush=True)
    print()
    return pd.DataFrame(rows)


def worse(score):
    """+1 where a larger value is worse, -1 where it is better, 0 where it says neither."""
    better = metric_of(score).better
    return {"lower": 1, "higher": -1, None: 0}[better]


def changes(rows):
    """One row per preset, flaw, amount and score: t (positive: worse, or larger where neither is) and pairs needed."""
    keys = ["pair", "preset"]
    scores = [name for name in rows.columns if name not in (*keys, "flaw", "amount", "reason")]
    base = rows[rows.flaw == NONE].set_index(keys)[scores]
    found = []
    for (preset, flaw, amount), own in rows[rows.flaw != NONE].groupby(
        ["preset", "flaw", "amount"]
    ):
        change = own.set_index(keys)[scores].astype(float) - base.loc[
            own.set_index(keys).index
        ].astype(float)
        for score in scores:
            values = change[score].to_numpy()
            if np.isnan(values).all():
                continue
            effect = effect_size(values)
            t = paired_t(values)
            found.append(
                {
                    "preset": preset,
                    "flaw": flaw,
                    "amount": amount,
                    "score": score,
                    "n": int(np.isfinite(values).sum()),
                    "change": float(np.nanmean(values)),
                    "t": None if t is None else t * (worse(score) or 1),
                    "signed": bool(worse(score)),
                    "pairs": None if effect is None else pairs_needed(effect),
                }
            )
    return pd.DataFrame(found)


def table(found):
    """Markdown: for each flaw and preset the scores that answer most, and those that are far on the wrong side."""
    lines = [
        "| flaw | amount | preset | best scores: t (pairs) | says better, t below -2.3 |",
        "|---|---|---|---|---|",
    ]
    order = {name: i for i, name in enumerate(AMOUNTS)}
    found = found.assign(rank=found.flaw.map(order)).sort_values(["rank", "amount", "preset"])
    for (_, flaw, amount, preset), own in found.groupby(
        ["rank", "flaw", "amount", "preset"], sort=False
    ):
        right = own[(own.t > 0) | ~own.signed]
        best = right.reindex(right.t.abs().sort_values(ascending=False).index).head(4)
        wrong = own[own.signed & (own.t < -2.3)].sort_values("t").head(3)
        lines.append(f"| {flaw} | {amount:g} | {preset} | {_cell(best)} | {_cell(wrong)} |")
    return "\n".join(lines)


def _cell(rows):
    return ", ".join(
        f"{row.score} {row.t:.1f} ({_count(row.pairs)})" for row in rows.itertuples()
    )


def core_table(found):
    """Markdown: the flaws that every preset should see, CDC, r_lambda and match rate beside the best score."""
    names = ("cdc_mean", "r_lambda_mean", "match_rate")
    heads = [
        f"{preset}: {what}"
        for preset in PRESETS
        for what in ("CDC, r_lambda, match rate", "best score")
    ]
    lines = [f"| flaw | {' | '.join(heads)} |", "|---|" + "---|" * len(heads)]
    for flaw, amount in CORE:
        cells = []
        for preset in PRESETS:
            own = found[
                (found.preset == preset) & (found.flaw == flaw) & (found.amount == amount)
            ].set_index("score")
            cells.append(", ".join(f"{own.t[name]:.1f}" for name in names))
            right = own[(own.t > 0) | ~own.signed]
            best = right.t.abs().idxmax()
            cells.append(f"**{right.t[best]:.1f}** {best} ({_count(right.pairs[best])} pairs)")
        lines.append(f"| {flaw} {amount:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(found, path):
    """A picture: t of each score (columns) under each flaw (rows), one panel per preset; strongest amount."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    strongest = found[found.amount == found.groupby("flaw").amount.transform("max")]
    flaws = [name for name in AMOUNTS if name in set(strongest.flaw)]
    scores = list(dict.fromkeys(found.score))
    figure, axes = plt.subplots(
        len(PRESETS), 1, figsize=(11, 7.5), sharex=True, layout="constrained"
    )
    for axis, preset in zip(axes, PRESETS, strict=True):
        own = strongest[strongest.preset == preset].pivot(
            index="flaw", columns="score", values="t"
        )
        values = own.reindex(index=flaws, columns=scores).to_numpy(dtype=float)
        image = axis.imshow(
            np.clip(values, -10, 10), cmap="RdBu_r", vmin=-10, vmax=10, aspect="auto"
        )
        for (i, j), value in np.ndenumerate(values):
            if abs(value) >= 2.3:
                colour = "white" if abs(value) > 6 else "black"
                axis.text(
                    j, i, f"{value:.0f}", ha="center", va="center", fontsize=6, color=colour
                )
        if (unknown := np.flatnonzero(np.isnan(values).all(axis=0))).size:
            axis.text(
                unknown.mean(),
                len(flaws) / 2,
                "as above: does not depend on the objects",
                ha="center",
                fontsize=8,
            )
        axis.set_yticks(
            range(len(flaws)), [f"{n} {max(AMOUNTS[n]):g}" for n in flaws], fontsize=8
        )
        axis.set_title(f"preset {preset}", fontsize=10, loc="left")
    axes[-1].set_xticks(range(len(scores)), scores, rotation=60, ha="right", fontsize=7)
    bar = figure.colorbar(image, ax=axes, shrink=0.6, extend="both")
    bar.set_label("t of the change; red: worse (or larger), blue: better", fontsize=8)
    figure.savefig(path, dpi=150)


def _count(pairs):
    if pd.isna(pairs):
        return "-"
    return f"{int(pairs)}" if pairs < 1000 else "over 999"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("datasets", type=Path, nargs="+", help="folders of pairs")
    parser.add_argument("--every", type=int, default=4, help="take each n-th row of both scans")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--flaws", nargs="+", choices=AMOUNTS, default=list(AMOUNTS))
    parser.add_argument(
        "--out", type=Path, default=Path("power"), help="name of the table and the figure"
    )
    arguments = parser.parse_args()
    measured = changes(measure(arguments, arguments.out.with_suffix(".csv")))
    measured.to_csv(arguments.out.with_name(arguments.out.name + "-t.csv"), index=False)
    draw(measured, arguments.out.with_suffix(".png"))
    print(core_table(measured), table(measured), sep="\n\n")
