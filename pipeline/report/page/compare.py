"""A comparison of runs as one HTML page: tables and inline SVG, no script, nothing from the network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from ....stages.statistics.comparison import CONFIDENCE, N_RESAMPLES, SEED
from ...results.compare import Comparison, ScoreChange
from ..terminal.compare import OBJECTS_NOTE, beyond_seeds, changed, has_seeds, remarks, signed, verdict
from ..terminal.layout import number

MOST_OBJECTS, MOST_PAIRS = 300, 200
_WIDTH, _ROW, _MARGIN, _MOST_DOTS = 560, 34, 12, 300

_WORDS = ("verdict", "what", "class")  # headings of columns of words

_STYLE = """
:root{--back:#fff;--ink:#1b1f24;--faint:#6a737d;--line:#d5dae0;--good:#0b62b0;--bad:#b8500a;--open:#5f6670}
@media (prefers-color-scheme:dark){:root{--back:#14181d;--ink:#e6e9ec;--faint:#9aa4af;--line:#343b44;
--good:#6db3f2;--bad:#f0994f;--open:#a3abb5}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:70rem;background:var(--back);color:var(--ink);
font:16px/1.5 system-ui,sans-serif;overflow-wrap:anywhere}
h1{font-size:1.5rem}h2{font-size:1.2rem;margin-top:2rem}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.875rem;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .6rem;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
td.name{min-width:6rem;max-width:16rem;white-space:normal;overflow-wrap:anywhere}
th:first-child,td:first-child,th.word,td.word{text-align:left}
.better,.appeared{color:var(--good);font-weight:600}.worse,.vanished{color:var(--bad);font-weight:600}
.faint{color:var(--faint)}
svg{width:100%;min-width:34rem;max-width:52rem;height:auto;display:block}
svg text{fill:var(--ink);font-size:12px}
"""


def compare_page(found: Sequence[Comparison]) -> str:
    """The whole page; every name is escaped."""
    body = "".join(_section(comparison) for comparison in found)
    method = (
        f"Differences are after less before, means over pairs. Intervals: {100 * CONFIDENCE:.0f} %, paired bootstrap "
        f"over pairs (BCa, {N_RESAMPLES} resamples, seed {SEED}); each stands for itself, and one in twenty leaves out "
        f"0 by chance. {OBJECTS_NOTE}"
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f"<title>fidpipe: comparison of runs</title><style>{_STYLE}</style></head>\n"
        f'<body><h1>Comparison of simulator versions</h1>\n{body}<p class="faint">{escape(method)}</p></body></html>\n'
    )


def _section(found: Comparison) -> str:
    objects = changed(found)
    parts = [
        f"<h2>{escape(str(found.other))} against {escape(str(found.base))}</h2>",
        f"<p><strong>{escape(verdict(found))}.</strong> {len(found.pairs)} pairs.</p>",
        "".join(f'<p class="faint">Note: {escape(text)}.</p>' for text in remarks(found)),
        _scores(found),
        "<h3>Change of each pair (dots), their mean and its interval (bar)</h3>",
        f'<div class="wide" tabindex="0">{_chart(found.scores)}</div>',
    ]
    if found.objects:
        parts += ["<h3>What has become of the real objects</h3>", _kinds(found)]
        shown = f" (the first {MOST_OBJECTS} of {len(objects)})" if len(objects) > MOST_OBJECTS else ""
        parts.append(f"<h3>Objects that have changed{shown}</h3>")
        headings = ("pair", "what", "class", "object", "range, m", "points", "CDC", "after", "r_lambda", "after")
        rows = (
            [
                f'<td class="name">{escape(of.pair_id)}</td>',
                _word(of.kind),
                f'<td class="word">{escape(of.label or "-")}</td>',
                *(_plain(text) for text in (str(of.real_id), number(of.range_m, 1), str(of.n_points))),
                *(_plain(number(value)) for value in (of.cdc_before, of.cdc_after)),
                *(_plain(number(value)) for value in (of.r_lambda_before, of.r_lambda_after)),
            ]
            for of in objects[:MOST_OBJECTS]
        )
        parts.append(_table(headings, rows))
    parts += ["<h3>Pairs</h3>", _pairs(found)]
    return "\n".join(parts)


def _scores(found: Comparison) -> str:
    with_seeds = has_seeds(found)
    headings = ("score", "verdict", "before", "after", "change", "from", "to")
    rows = (
        [_plain(of.name), _word(of.verdict), *_numbers(of), *([_plain(beyond_seeds(of))] if with_seeds else [])]
        for of in found.scores
    )
    return _table((*headings, *(("more than seeds make",) if with_seeds else ())), rows)


def _kinds(found: Comparison) -> str:
    rows = (
        [_word(kind), _plain(str(n)), _plain(f"{100 * n / len(found.objects):.0f} %")]
        for kind, n in found.kinds.items()
    )
    return _table(("what", "objects", "share"), rows)


def _pairs(found: Comparison) -> str:
    by_name = {of.name: of for of in found.scores}
    columns = [by_name[name] for name in ("match rate", "CDC", "r_lambda", "r_gap", "missing objects")]
    names = sorted(found.pairs, key=lambda name: -(by_name["r_lambda"].of_pairs[name] or 0.0))
    rows = (
        [f'<td class="name">{escape(name)}</td>', *(_plain(signed(of.of_pairs[name])) for of in columns)]
        for name in names[:MOST_PAIRS]
    )
    shown = f"<p>The {MOST_PAIRS} of {len(names)} whose r_lambda rose most.</p>" if len(names) > MOST_PAIRS else ""
    return shown + _table(("pair (change)", *(of.name for of in columns)), rows)


def _chart(scores: Sequence[ScoreChange]) -> str:
    """A strip a score: zero in the middle, each strip to its own scale, which is written at its end."""
    left, right = 170, _WIDTH - 60
    middle, half = (left + right) / 2, (right - left) / 2 - _MARGIN
    height = _ROW * len(scores) + 2 * _MARGIN
    parts = [
        f'<svg viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="change of each score, see the table above">',
        f'<line x1="{middle}" x2="{middle}" y1="0" y2="{height}" stroke="var(--faint)"/>',
    ]
    for i, of in enumerate(scores):
        y = _MARGIN + _ROW * (i + 0.5)
        known = [value for value in of.of_pairs.values() if value is not None]
        d = of.difference
        reach = max((abs(value) for value in (*known, d.low or 0.0, d.high or 0.0)), default=0.0) or 1.0
        colour = {"better": "var(--good)", "worse": "var(--bad)"}.get(of.verdict, "var(--open)")

        def at(value: float, reach: float = reach) -> float:
            return round(middle + half * value / reach, 1)

        parts.append(f'<text x="0" y="{y + 4}">{escape(of.name)}</text>')
        parts.append(f'<text x="{_WIDTH}" y="{y + 4}" text-anchor="end">\u00b1{reach:.2g}</text>')
        step = -(-len(known) // _MOST_DOTS) or 1
        parts += [
            f'<circle cx="{at(value)}" cy="{y}" r="3" fill="{colour}" fill-opacity="0.35"/>' for value in known[::step]
        ]
        if d.low is not None and d.high is not None and d.difference is not None:
            parts.append(
                f'<line x1="{at(d.low)}" x2="{at(d.high)}" y1="{y}" y2="{y}" stroke="{colour}" stroke-width="3"/>'
            )
            parts.append(
                f'<line x1="{at(d.difference)}" x2="{at(d.difference)}" y1="{y - 8}" y2="{y + 8}" '
                f'stroke="{colour}" stroke-width="3"/>'
            )
    return "".join([*parts, "</svg>"])


def _numbers(of: ScoreChange) -> list[str]:
    d = of.difference
    return [_plain(text) for text in (number(d.before), number(d.after), *map(signed, (d.difference, d.low, d.high)))]


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(
        f'<th class="word">{escape(heading)}</th>' if heading in _WORDS else f"<th>{escape(heading)}</th>"
        for heading in headings
    )
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return f'<div class="wide" tabindex="0"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _plain(text: str) -> str:
    return f"<td>{escape(text)}</td>"


def _word(text: str) -> str:
    return f'<td class="word {escape(text.split(maxsplit=1)[0])}">{escape(text)}</td>'
