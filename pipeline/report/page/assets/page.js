"use strict";
// Fills the page and keeps it in step with the theme.

function fillVerdict() {
  document.title = `fidpipe report: ${report.title}`;
  say("title", report.title);
  say("sentence", report.verdict);
  say("weakest", report.weakest);
  const { n, first } = report.failures;
  const named = Object.entries(first).map(([name, why]) => `${shorten(name)} (${shorten(why, 120)})`);
  say("failures", n ? `${n.toLocaleString("en")} more pair${n > 1 ? "s" : ""} failed and count nowhere here: ${named.join("; ")}${named.length < n ? " …" : ""}` : "");
  byId("numbers").replaceChildren(...report.numbers.map((of) => {
    const tile = element("div", null, { class: "tile" });
    const value = element("div", of.mean === null ? number(null) : of.mean.toFixed(of.digits), { class: "value" });
    value.append(element("span", ` ± ${of.std === null ? number(null) : of.std.toFixed(of.digits)}`, { class: "spread" }));
    tile.append(element("div", of.name, { class: "name" }), value, element("p", `${of.scale}: ${of.meaning}`));
    return tile;
  }));
  say("box_scan_note", report.boxes.scan_note);
  say("box_class_note", report.boxes.class_note);
}

function fillTables() {
  const titles = {
    pair_id: ["pair", true], group: [report.class_is === "label" ? "class" : "shape", true], quadrant: ["quadrant", true], status: ["status", true], object: ["object", true],
    match_rate: ["match rate"], n_matched: ["matched"], n_missing: ["missing"], n_hallucinated: ["hallucinated"], cdc_mean: ["CDC"], r_lambda_mean: ["r_lambda"], r_gap_mean: ["r_gap"],
    max_eigenvalue_shift_mean: ["shift"], laplacian_change_mean: ["change"], alignment_rms_m_mean: ["alignment m"], centroid_distance_m_mean: ["offset m"],
    range_m: ["range m"], n_real: ["points real"], n_sim: ["points sim"], n_keep: ["nodes"], cdc: ["CDC"], r_lambda: ["r_lambda"], r_gap: ["r_gap"],
    max_eigenvalue_shift: ["shift"], laplacian_change: ["change"], alignment_rms_m: ["alignment m"], centroid_distance_m: ["offset m"],
  };
  const columns = (keys) => keys.map((key) => ({ key, title: titles[key][0], text: Boolean(titles[key][1]), up: key === "match_rate", digits: key === "range_m" ? 1 : 3 }));
  const open = (pair, name) => {
    if (report.views[pair]) return () => { if (name) showObject(pair, name); else { openPair(pair); byId("view").scrollIntoView(); byId("pair").focus({ preventScroll: true }); } };
    const link = (report.links || {})[pair];
    return link ? (name ? `${link}#${encodeURIComponent(name)}` : link) : null;
  };
  makeTable(byId("pairs_table"), "pairs", columns(report.pairs.columns), records(report.pairs.columns, report.pairs.rows), (row) => open(row.pair_id, null), report.pairs.note);
  makeTable(byId("objects_table"), "objects", columns(report.objects.columns), records(report.objects.columns, report.objects.rows), (row) => open(row.pair_id, row.object.split(", ")[0]), report.objects.note);
  makeKeyTable(byId("settings"), report.settings);
  makeKeyTable(byId("versions"), report.versions);
}

function startTheme() {
  const choice = byId("theme");
  const redraw = () => { drawCharts(); if (scene.pair !== null) { drawScene(); if (scene.chosen !== null) chooseObject(scene.chosen); } };
  choice.addEventListener("change", () => {
    if (choice.value === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = choice.value;
    redraw();
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

fillVerdict();
fillTables();
drawCharts();
startScene();
startTheme();
document.documentElement.dataset.ready = "yes";
