"use strict";
// The charts over all objects: each function draws one, from the report's data.

function drawHistogram(column) {
  const of = report.histograms[column];
  const width = of.edges[1] - of.edges[0];
  const middles = of.counts.map((_, i) => of.edges[i] + width / 2);
  const median = of.median === null ? [] : [{ type: "line", x0: of.median, x1: of.median, yref: "paper", y0: 0, y1: 1, line: { color: css("--ink"), dash: "dash", width: 1.5 } }];
  draw(`hist_${column}`, [{ type: "bar", x: middles, y: of.counts, width, marker: { color: COLOURS[column] }, hovertemplate: "%{x:.2f}: %{y} objects<extra></extra>" }], {
    title: { text: `${of.name}, ${of.n.toLocaleString("en")} objects${of.median === null ? "" : `, median ${of.median.toFixed(2)}`}`, font: { size: 13 } },
    shapes: median, xaxis: { range: [0, of.bound], title: { text: `${of.name} (no unit)` } }, yaxis: { title: { text: "objects" } }, margin: { l: 55, r: 15, t: 40, b: 45 },
  });
}

function drawQuadrants() {
  const all = report.scatter;
  const limits = report.limits;
  const traces = Object.entries(report.quadrants).filter(([key]) => key !== "no score").map(([key, of]) => {
    const own = all.quadrant.map((name, i) => i).filter((i) => all.quadrant[i] === key);
    return {
      type: "scatter", mode: "markers", name: `${of.title}: ${of.n} (${Math.round(100 * of.n / Math.max(1, report.n_matched))} %)`,
      x: own.map((i) => all.cdc[i]), y: own.map((i) => all.r_lambda[i]), customdata: own.map((i) => [all.pair[i], all.real_id[i]]),
      text: own.map((i) => `pair ${plotText(report.names[all.pair[i]])}, object ${all.real_id[i]}`),
      hovertemplate: "%{text}<br>CDC %{x:.3f}<br>r_lambda %{y:.3f}<extra></extra>",
      marker: { color: QUADRANT_COLOURS[key], size: 6, opacity: 0.8 }, cliponaxis: false,
    };
  });
  const line = { color: css("--ink"), width: 1 };
  const narrow = byId("quadrants").clientWidth < 600;
  draw("quadrants", traces, {
    xaxis: { range: [0, 2.02], title: { text: "geometry: CDC (no unit)" } }, yaxis: { range: [0, 1.02], title: { text: "structure: r_lambda (no unit)" } },
    shapes: [{ type: "line", x0: limits.cdc, x1: limits.cdc, y0: 0, y1: 1, yref: "paper", line }, { type: "line", y0: limits.r_lambda, y1: limits.r_lambda, x0: 0, x1: 1, xref: "paper", line }],
    legend: { orientation: "h", y: 1.01, yanchor: "bottom", x: 0, font: { size: narrow ? 10 : 12 } }, margin: { l: 55, r: 15, t: narrow ? 100 : 40, b: 45 },
  });
  byId("quadrants").removeAllListeners?.("plotly_click");
  byId("quadrants").on("plotly_click", (event) => {
    const [pair, id] = event.points[0].customdata;
    showObject(report.names[pair], `real ${id}`);
  });
  const sampled = all.cdc.length < report.n_matched ? ` ${all.cdc.length.toLocaleString("en")} of ${report.n_matched.toLocaleString("en")} objects are drawn, evenly over the order from worst to best; the counts are of all.` : "";
  say("quadrant_note", `Limits: ${report.limits.words}.${sampled}`);
}

function drawBoxes(id, groups) {
  // Names can be alike when shortened, so that boxes stand at numbers.
  const traces = Object.entries(report.histograms).flatMap(([column, of], k) => {
    const known = groups.map((group, i) => [group[column], i + (k ? 0.2 : -0.2)]).filter(([box]) => box);
    const pick = (name) => known.map(([box]) => box[name]);
    return [
      {
        type: "box", name: of.name, x: known.map(([, x]) => x), width: 0.34, q1: pick("q1"), median: pick("median"), q3: pick("q3"),
        lowerfence: pick("low"), upperfence: pick("high"), marker: { color: COLOURS[column] }, line: { width: 1.2 }, hoverinfo: "y",
      },
      {
        type: "scatter", mode: "markers", showlegend: false, x: known.flatMap(([box, x]) => box.outside.map(() => x)), y: known.flatMap(([box]) => box.outside),
        marker: { color: COLOURS[column], size: 3 }, hovertemplate: "%{y:.3f}<extra></extra>",
      },
    ];
  });
  draw(id, traces, {
    xaxis: { tickvals: groups.map((_, i) => i), ticktext: groups.map((group) => `${plotText(group.name, 14)} (${group.n})`), range: [-0.6, groups.length - 0.4] },
    yaxis: { range: [0, 2.05], title: { text: "score of an object" } }, boxmode: "overlay",
  });
}

function drawPolar() {
  const traces = ["missing", "hallucinated"].map((fate) => {
    const own = report.unmatched_points.filter((row) => row[0] === fate);
    return {
      type: "scatterpolar", mode: "markers", name: `${fate} (${report.fates[fate].toLocaleString("en")})`, r: own.map((row) => row[1]), theta: own.map((row) => row[2]),
      marker: { color: FATES[fate], size: 6, symbol: fate === "missing" ? "circle-open" : "x-thin", line: { width: 1.5, color: FATES[fate] } },
      customdata: own.map((row) => [row[3], row[4]]), text: own.map((row) => `pair ${plotText(report.names[row[3]])}, ${fate} object ${row[4]}`),
      hovertemplate: "%{text}<br>%{r:.1f} m, %{theta:.0f}°<extra></extra>",
    };
  });
  const grid = { gridcolor: css("--line"), linecolor: css("--soft") };
  draw("polar", traces, {
    polar: {
      bgcolor: "rgba(0,0,0,0)", radialaxis: { ...grid, ticksuffix: " m", angle: 45, tickangle: 45, nticks: 5 },
      angularaxis: { ...grid, rotation: 90, direction: "counterclockwise", tickvals: [0, 45, 90, 135, 180, 225, 270, 315], ticktext: ["ahead", "", "left", "", "behind", "", "right", ""] },
    },
    margin: { l: 45, r: 45, t: 65, b: 30 }, legend: { orientation: "h", y: 1.1, yanchor: "bottom", x: 0 },
  });
  byId("polar").removeAllListeners?.("plotly_click");
  byId("polar").on("plotly_click", (event) => {
    const point = event.points[0];
    showObject(report.names[point.customdata[0]], `${point.data.name.startsWith("missing") ? "real" : "sim"} ${point.customdata[1]}`);
  });
  const n = report.fates.missing + report.fates.hallucinated;
  const sampled = report.unmatched_points.length < n ? ` ${report.unmatched_points.length.toLocaleString("en")} of ${n.toLocaleString("en")} are drawn, largest first.` : "";
  say("polar_note", `Unmatched objects of all pairs around the sensor, at their centroids, seen from above.${sampled}`);
}

function drawBands() {
  const traces = ["matched", "missing", "hallucinated"].map((fate) => ({
    type: "bar", name: fate, x: report.bands.map((band) => band.name), y: report.bands.map((band) => band[fate]), marker: { color: FATES[fate], pattern: { shape: { matched: "", missing: "/", hallucinated: "x" }[fate], solidity: 0.25 } },
    customdata: report.bands.map((band) => Math.round(100 * band[fate] / (band.matched + (fate === "hallucinated" ? band.hallucinated : band.missing)))),
    hovertemplate: `%{y} ${fate}, %{customdata} % of the ${fate === "hallucinated" ? "simulated" : "real"} objects<extra></extra>`,
  }));
  draw("bands", traces, { barmode: "group", xaxis: { type: "category" }, yaxis: { title: { text: "objects" } } });
}

function drawTimes() {
  const stages = [...new Set(report.times.map((row) => row.stage))];
  const shades = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#999999"];
  const steps = [...new Set(report.times.map((row) => row.step))];
  const traces = steps.map((step, i) => {
    const own = report.times.filter((row) => row.step === step);
    return { type: "bar", orientation: "h", name: step, y: own.map((row) => row.stage), x: own.map((row) => row.seconds), marker: { color: shades[i % shades.length], pattern: { shape: i < shades.length ? "" : "/" } }, hovertemplate: `%{y}, ${plotText(step)}: %{x:.3f} s<extra></extra>` };
  });
  draw("times", traces, { barmode: "stack", showlegend: false, xaxis: { title: { text: "seconds a pair" } }, yaxis: { categoryorder: "array", categoryarray: [...stages].reverse() } });
}

function drawCharts() {
  for (const column of Object.keys(report.histograms)) drawHistogram(column);
  drawQuadrants();
  drawBoxes("box_scan", report.boxes.scan);
  drawBoxes("box_class", report.boxes.class);
  drawPolar();
  drawBands();
  drawTimes();
}
