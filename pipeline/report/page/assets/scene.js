"use strict";
// The 3D view of a pair, and the panel of a chosen object: its numbers, both point sets, its spectra, the nodes kept.
// An object is called by side and community: "real 3", "sim 7"; a matched one has one name, that of its real side.

const scene = { pair: null, points: null, objects: [], chosen: null, hovered: null, isWired: false };
const communityColour = (i) => `hsl(${Math.round((i * 137.508) % 360)}, 65%, ${[48, 62, 38][i % 3]}%)`;

function openPair(name) {
  const view = report.views[name];
  if (!view) return false;
  scene.pair = name;
  const matched = records(report.matched_columns, view.matched).map((row) => ({ ...row, name: `real ${row.real_id}`, fate: row.status === "too_small" ? "too small" : "matched" }));
  const unmatched = records(report.unmatched_columns, view.unmatched).map((row) => ({ ...row, name: `${row.side} ${row.community_id}`, fate: row.status, cdc: null, r_lambda: null }));
  scene.objects = [...matched, ...unmatched];
  const owner = { real: new Map(), sim: new Map() };
  scene.objects.forEach((object, i) => {
    if (object.side) owner[object.side].set(object.community_id, i);
    else { owner.real.set(object.real_id, i); owner.sim.set(object.sim_id, i); }
  });
  scene.points = {};
  for (const [side, of] of Object.entries(view.sides)) {
    const xyz = decode(of.xyz, Int16Array);
    const n = of.n_shown;
    const axis = (k) => Float32Array.from(xyz.subarray(k * n, (k + 1) * n), (step) => step * view.step_m);
    const community = decode(of.community, Int32Array);
    scene.points[side] = { x: axis(0), y: axis(1), z: axis(2), object: Int32Array.from(community, (id) => owner[side].get(id)), kept: decode(of.kept, Uint8Array), n: of.n };
  }
  byId("pair").value = name;
  const list = byId("object");
  list.replaceChildren(element("option", "none", { value: "" }), ...scene.objects.map((object) => element("option", objectTitle(object), { value: object.name })));
  const said = Object.entries(view.sides).map(([side, of]) => `${of.n_shown.toLocaleString("en")} of ${of.n.toLocaleString("en")} object points (${side})`);
  say("scene_note", `Shown: ${said.join(", ")}. Points are thinned for display only; all scores are of all points. Road points are not shown. Click a point, or choose in the list, to see its object.`);
  chooseObject(null);
  drawScene();
  return true;
}

function objectTitle(object) {
  const ids = object.side ? `${object.side} ${object.community_id}` : `real ${object.real_id}, sim ${object.sim_id}`;
  const scores = object.side ? object.fate : `CDC ${number(object.cdc, 2)}, r_lambda ${number(object.r_lambda, 2)}`;
  return `${ids}: ${shorten(object.group)}, ${scores}`;
}

function pointColours(side, by) {
  const { object } = scene.points[side];
  if (by === "side") return { color: COLOURS[side] };
  const ofObject = scene.objects.map((one, i) => {
    if (by === "community") return one.side ? NONE : communityColour(i);
    if (by === "status") return FATES[one.fate];
    return one[by] === null ? NONE : rampColour(one[by] / report.histograms[by].bound);
  });
  return { color: Array.from(object, (i) => ofObject[i]) };
}

function rampColour(share) {
  const stops = ramp();
  const at = Math.min(0.9999, Math.max(0, share)) * (stops.length - 1);
  const [a, b] = [stops[Math.floor(at)], stops[Math.floor(at) + 1]];
  const mix = (k) => Math.round(parseInt(a.slice(k, k + 2), 16) * (1 - at % 1) + parseInt(b.slice(k, k + 2), 16) * (at % 1));
  return `rgb(${mix(1)},${mix(3)},${mix(5)})`;
}

function sceneLayout(more = {}) {
  const axis = (title) => ({ title: { text: title }, gridcolor: css("--line"), zerolinecolor: css("--line"), color: css("--soft"), showbackground: false, showspikes: false, ...(more[title[0]] || {}) });
  return { scene: { aspectmode: "data", xaxis: axis("x forward (m)"), yaxis: axis("y left (m)"), zaxis: axis("z up (m)"), camera: more.camera, dragmode: "orbit" }, margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, uirevision: more.uirevision };
}

function drawScene() {
  const by = byId("colour").value;
  const traces = ["real", "sim"].map((side) => {
    const { x, y, z, object } = scene.points[side];
    return {
      type: "scatter3d", mode: "markers", name: side, x, y, z, visible: byId(`show_${side}`).checked, marker: { size: 1.8, opacity: 1, line: { width: 0 }, ...pointColours(side, by) },
      text: Array.from(object, (i) => plotText(objectTitle(scene.objects[i]), 80)), hovertemplate: `${side}: %{text}<extra></extra>`,
    };
  });
  traces.push({ type: "scatter3d", mode: "markers", name: "chosen", ...chosenPoints(), hoverinfo: "skip", marker: { size: 3.6, color: css("--ink"), opacity: 0.9, line: { width: 0 } } });
  const farthest = Math.max(...["x", "y"].map((axis) => Math.max(...scene.points.real[axis].map(Math.abs))));
  const near = { eye: { x: -0.75, y: -0.75, z: Math.min(1.1, 0.6 + 20 / farthest) }, center: { x: 0, y: 0, z: -0.1 } };
  draw("scene", traces, sceneLayout({ camera: near, uirevision: scene.pair }), { displayModeBar: true, modeBarButtonsToRemove: ["resetCameraLastSave3d", "tableRotation"] });
  if (!scene.isWired) wireScene();
  drawLegend(by);
}

function chosenPoints() {
  const chosen = scene.objects.findIndex((object) => object.name === scene.chosen);
  const parts = ["real", "sim"].map((side) => inObject(side, chosen, () => true));
  return Object.fromEntries(["x", "y", "z"].map((axis) => [axis, parts.flatMap((part) => part[axis])]));
}

// A press and release on one spot chooses the object under it. Plotly's own click event comes once a frame as long as
// the button is down, and not at all for a fast click; its hover event is reliable.
function wireScene() {
  scene.isWired = true;
  const plot = byId("scene");
  plot.on("plotly_hover", (event) => {
    const point = event.points[0];
    const side = point.data.name;
    scene.hovered = side in scene.points ? scene.objects[scene.points[side].object[point.pointNumber]].name : null;
  });
  plot.on("plotly_unhover", () => { scene.hovered = null; });
  let from = null;
  plot.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; }, true);
  plot.addEventListener("pointerup", (event) => {
    const moved = from === null ? Infinity : Math.hypot(event.clientX - from[0], event.clientY - from[1]);
    from = null;
    // A finger has not hovered before: the object under it is known a moment later.
    if (moved < 5) setTimeout(() => { if (scene.hovered !== null) chooseObject(scene.hovered); }, event.pointerType === "mouse" ? 0 : 250);
  }, true);
}

function drawLegend(by) {
  const entry = (colour, text) => { const one = element("span"); const dot = element("i"); dot.style.background = colour; one.append(dot, text); return one; };
  const legend = byId("legend");
  if (by === "side") legend.replaceChildren(entry(COLOURS.real, "real"), entry(COLOURS.sim, "simulated"));
  else if (by === "status") legend.replaceChildren(...Object.entries(FATES).filter(([fate]) => scene.objects.some((one) => one.fate === fate)).map(([fate, colour]) => entry(colour, fate)));
  else if (by === "community") legend.replaceChildren(element("span", "One colour an object; matched objects have the same on both sides."), entry(NONE, "unmatched"));
  else {
    const bar = element("span", null, { class: "ramp" });
    bar.style.background = `linear-gradient(to right, ${ramp().join(",")})`;
    const one = element("span", "0");
    one.append(bar, `${report.histograms[by].bound} (${report.histograms[by].name})`);
    legend.replaceChildren(one, entry(NONE, "no score"));
  }
}

function inObject(side, index, wanted) {
  const { x, y, z, object, kept } = scene.points[side];
  const own = [];
  for (let i = 0; i < object.length; i += 1) if (object[i] === index && wanted(kept[i])) own.push(i);
  return { x: own.map((i) => x[i]), y: own.map((i) => y[i]), z: own.map((i) => z[i]) };
}

function chooseObject(name) {
  scene.chosen = name;
  byId("object").value = name ?? "";
  byId("panel").hidden = name === null;
  if (name !== null) drawPanel(scene.objects.findIndex((object) => object.name === name));
  if (byId("scene").data) {
    const { x, y, z } = chosenPoints();
    Plotly.restyle("scene", { x: [x], y: [y], z: [z] }, [2]);
  }
}

const PANEL = [
  ["quadrant", "quadrant"], ["status", "status"], ["reason", "reason"], ["group", report.class_is === "label" ? "class" : "shape"], ["range_m", "range (m)"], ["bearing_deg", "bearing (°, left positive)"],
  ["n_points", "points"], ["n_real", "points, real"], ["n_sim", "points, simulated"], ["n_keep", "nodes kept"], ["cdc", "CDC"], ["r_lambda", "r_lambda"], ["r_gap", "r_gap"],
  ["max_eigenvalue_shift", "largest eigenvalue shift"], ["laplacian_change", "Laplacian change"], ["eigenspectrum_distance", "eigenspectrum distance"],
  ["gap_real", "spectral gap, real"], ["gap_sim", "spectral gap, simulated"], ["alignment_rms_m", "alignment r.m.s. (m)"], ["centroid_distance_m", "centroid distance (m)"],
];

function drawPanel(index) {
  const object = scene.objects[index];
  say("panel_title", `Pair ${shorten(scene.pair, 60)}, object ${objectTitle(object)}`);
  byId("panel_numbers").replaceChildren(...PANEL.filter(([key]) => key in object && !(key === "reason" && object[key] === null)).map(([key, title]) => {
    const fact = element("div");
    fact.append(element("span", title, { class: "name" }), element("span", typeof object[key] === "number" ? number(object[key], 6) : object[key] ?? "–", { class: "value", "data-key": key }));
    return fact;
  }));
  drawSides(index, object);
  drawSpectrum(object);
}

function drawSides(index, object) {
  const sides = object.side ? [object.side] : ["real", "sim"];
  const parts = Object.fromEntries(sides.map((side) => [side, inObject(side, index, () => true)]));
  const limits = {};
  for (const axis of ["x", "y", "z"]) {
    const all = sides.flatMap((side) => parts[side][axis]);
    limits[axis] = { range: [Math.min(...all) - 0.2, Math.max(...all) + 0.2], nticks: 4 };
  }
  for (const side of ["real", "sim"]) {
    byId(`object_${side}`).parentElement.hidden = !sides.includes(side);
    if (!sides.includes(side)) continue;
    const kept = inObject(side, index, (is) => is === 1);
    const left = inObject(side, index, (is) => is === 0);
    const hasNodes = !object.side;
    const traces = [
      { type: "scatter3d", mode: "markers", name: hasNodes ? "left out" : "point", ...left, hovertemplate: "%{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>", marker: hasNodes ? { size: 3, symbol: "cross", color: css("--soft"), line: { width: 0 } } : { size: 2.4, color: COLOURS[side], line: { width: 0 } } },
      { type: "scatter3d", mode: "markers", name: "kept", ...kept, hovertemplate: "kept: %{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>", marker: { size: 2.4, color: COLOURS[side], line: { width: 0 } } },
    ];
    draw(`object_${side}`, traces, sceneLayout({ ...limits, camera: { eye: { x: -1.6, y: -1.6, z: 1.1 }, center: { x: 0, y: 0, z: -0.15 } } }));
    const n = object.side ? object.n_points : object[`n_${side}`];
    const nShown = kept.x.length + left.x.length;
    say(`object_${side}_note`, `${side === "real" ? "Real" : "Simulated"}: ${nShown.toLocaleString("en")} of ${n.toLocaleString("en")} points shown. ${hasNodes ? `Coloured dots: nodes kept for the spectral scores (${object.n_keep.toLocaleString("en")} of ${n.toLocaleString("en")}); grey crosses: left out.` : "Unmatched: no counterpart, no score."}`);
  }
  if (sides.length === 2) tieCameras();
}

let isTurning = false;
function tieCameras() {
  const plots = ["object_real", "object_sim"].map(byId);
  plots.forEach((plot, i) => {
    plot.removeAllListeners("plotly_relayout");
    plot.on("plotly_relayout", (change) => {
      const camera = change["scene.camera"];
      if (!camera || isTurning) return;
      isTurning = true;
      Plotly.relayout(plots[1 - i], { "scene.camera": camera }).then(() => { isTurning = false; });
    });
  });
}

function drawSpectrum(object) {
  const of = object.side ? { reason: "An unmatched object has no counterpart to compare spectra with" } : report.views[scene.pair].spectra[object.real_id];
  const place = byId("spectrum");
  place.hidden = Boolean(of.reason);
  if (of.reason) {
    say("spectrum_note", `Spectra: ${of.reason}.`);
    return;
  }
  const index = decode(of.index, Int32Array);
  const curves = { real: decode(of.real, Float32Array), sim: decode(of.sim, Float32Array) };
  const at = index[of.worst];
  const ends = [curves.real[of.worst], curves.sim[of.worst]];
  const traces = ["real", "sim"].map((side) => ({ type: "scatter", mode: "lines", name: side === "real" ? "real" : "simulated", x: index, y: curves[side], line: { color: COLOURS[side], width: 2, dash: side === "real" ? "solid" : "dash" }, hovertemplate: "eigenvalue %{x}: %{y:.4f}<extra></extra>" }));
  traces.push({ type: "scatter", mode: "lines+markers", name: `largest shift ${Math.abs(ends[1] - ends[0]).toFixed(3)}`, x: [at, at], y: ends, line: { color: css("--ink"), width: 3 }, marker: { size: 7, color: css("--ink") } });
  draw("spectrum", traces, { xaxis: { title: { text: "number of the eigenvalue, in ascending order" } }, yaxis: { title: { text: "eigenvalue (0 to 2)" } } });
  say("spectrum_note", `Spectra of the reduced Laplacians, ${of.n.toLocaleString("en")} eigenvalues a side${index.length < of.n ? `, ${index.length} of them drawn` : ""}. r_lambda is the marked shift over the Laplacian change: ${number(object.max_eigenvalue_shift, 4)} / ${number(object.laplacian_change, 4)} = ${number(object.r_lambda, 4)}.`);
}

function showObject(pair, name) {
  const link = (report.links || {})[pair];
  if (link && !report.views[pair]) { window.location.href = `${link}#${encodeURIComponent(name)}`; return; }
  if (scene.pair !== pair && !openPair(pair)) return;
  chooseObject(name);
  byId("panel").scrollIntoView({ behavior: "auto", block: "nearest" });
  byId("panel_title").focus({ preventScroll: true });
}

function startScene() {
  const names = Object.keys(report.views);
  say("view_note", report.view_note);
  if (!names.length) return;
  byId("viewer").hidden = false;
  byId("pair").append(...names.map((name) => element("option", shorten(name, 60), { value: name, title: name })));
  byId("pair").addEventListener("change", () => openPair(byId("pair").value));
  byId("object").addEventListener("change", () => chooseObject(byId("object").value || null));
  for (const id of ["colour", "show_real", "show_sim"]) byId(id).addEventListener("change", drawScene);
  for (const [id, by] of [["previous", -1], ["next", 1]]) {
    byId(id).addEventListener("click", () => {
      const n = scene.objects.length;
      const now = scene.objects.findIndex((object) => object.name === scene.chosen);
      chooseObject(scene.objects[now < 0 ? (by > 0 ? 0 : n - 1) : (now + by + n) % n].name);
    });
  }
  openPair(names[0]);
  const asked = decodeURIComponent(window.location.hash.slice(1));
  if (scene.objects.some((object) => object.name === asked)) showObject(names[0], asked);
}
