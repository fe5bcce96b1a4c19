// The 3D view of a pair, and the panel of a chosen object: its numbers, both point sets, its spectra, the nodes kept.
// An object is called by side and community: "real 3", "sim 7"; a matched one has one name, that of its real side.

import { byId, draw, isDark, paint, report } from "./draw.js";
import { counted, element, NULL_SIGN, number, records, shorten, shown } from "./tables.js";

const SIDES = ["real", "sim"];
const scene = { pair: null, points: null, objects: [], chosen: null, hovered: null };
const communityColour = (i) => `hsl(${Math.round((i * 137.508) % 360)}, 65%, ${[48, 62, 38][i % 3]}%)`;
const ramp = () => report.colours.ramps[isDark() ? "dark" : "light"];
const FAR = 255; // the distance to the other side is a byte, this one for report.far_m and more
const PLACE = "%{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>";
const AXES = { x: "x forward (m)", y: "y left (m)", z: "z up (m)" };
const say = (id, text) => {
  byId(id).textContent = shown(text);
};

function decode(text, Type) {
  return new Type(Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0)).buffer);
}

export function openPair(pair) {
  const view = report.views[pair];
  if (!view) return false;
  scene.pair = pair;
  const matched = records(report.matched_columns, view.matched).map((row) => ({
    ...row,
    name: `real ${row.real_id}`,
    fate: row.status === "too_small" ? "too small" : "matched",
    owns: { real: row.real_id, sim: row.sim_id },
  }));
  const unmatched = records(report.unmatched_columns, view.unmatched).map((row) => ({
    ...row,
    name: `${row.side} ${row.community_id}`,
    fate: row.status,
    owns: { [row.side]: row.community_id },
    cdc: null,
    r_lambda: null,
  }));
  scene.objects = [...matched, ...unmatched];
  scene.points = Object.fromEntries(
    Object.entries(view.sides).map(([side, packed]) => [side, unpacked(side, packed, view.step_m)]),
  );
  byId("pair").value = pair;
  const options = scene.objects.map((object) => element("option", objectTitle(object), { value: object.name }));
  byId("object").replaceChildren(element("option", "none", { value: "" }), ...options);
  const parts = Object.entries(view.sides).map(
    ([side, { n, n_shown }]) => `${counted(n_shown)} of ${counted(n)} object points (${side})`,
  );
  say(
    "scene_note",
    `Shown: ${parts.join(", ")}. Points are thinned for display only; all scores are of all points. ` +
      "Road points are not shown. Click a point, or choose in the list, to see its object.",
  );
  chooseObject(null);
  drawScene();
  return true;
}

// The points of a side, each with the place of its object in scene.objects, and its distance to the other side. Where
// the real side fixes the objects, the few simulated points of a missing one bear its number and belong to it.
function unpacked(side, { xyz, community, kept, distance, n_shown: n }, step_m) {
  const steps = decode(xyz, Int16Array);
  const [x, y, z] = [0, 1, 2].map((k) =>
    Float32Array.from(steps.subarray(k * n, (k + 1) * n), (step) => step * step_m),
  );
  const places = scene.objects.map((object, i) => [object, i]);
  const missing = places.filter(([object]) => object.fate === "missing").map(([object, i]) => [object.owns.real, i]);
  const owner = new Map([...missing, ...places.map(([object, i]) => [object.owns[side], i])]);
  const object = Int32Array.from(decode(community, Int32Array), (id) => owner.get(id));
  return { x, y, z, object, kept: decode(kept, Uint8Array), distance: decode(distance, Uint8Array) };
}

function objectTitle(object) {
  const ids = object.side ? object.name : `real ${object.real_id}, sim ${object.sim_id}`;
  const scores = object.side ? object.fate : `CDC ${number(object.cdc, 2)}, r_lambda ${number(object.r_lambda, 2)}`;
  return `${ids}: ${shorten(object.group)}, ${scores}`;
}

// plotly reads a little markup in its texts: its meaning is taken away.
const plotText = (text) => shorten(shown(text), 80).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

function objectColour(object, i, by) {
  const { none, fates } = report.colours;
  if (by === "community") return object.side ? none : communityColour(i);
  if (by === "status") return paint(fates[object.fate]);
  if (by === "quadrant") return paint(report.colours.quadrants[object.quadrant] ?? none);
  const { low, high } = report.scores[by];
  return object[by] === null ? none : rampColour((object[by] - low) / (high - low));
}

function rampColour(share) {
  const stops = ramp();
  const at = Math.min(0.9999, Math.max(0, share)) * (stops.length - 1);
  const [a, b] = [stops[Math.floor(at)], stops[Math.floor(at) + 1]];
  const mix = (k) =>
    Math.round(
      Number.parseInt(a.slice(k, k + 2), 16) * (1 - (at % 1)) + Number.parseInt(b.slice(k, k + 2), 16) * (at % 1),
    );
  return `rgb(${mix(1)},${mix(3)},${mix(5)})`;
}

const sideColour = (side) => paint(report.colours.sides[side]);

// By side, the colour of its points, one for all or one each.
function pointColours(by) {
  if (by === "side") return sideColour;
  if (by === "distance") {
    const shades = Array.from({ length: FAR + 1 }, (_, step) => rampColour(step / FAR));
    return (side) => Array.from(scene.points[side].distance, (step) => shades[step]);
  }
  const colours = scene.objects.map((object, i) => objectColour(object, i, by));
  return (side) => Array.from(scene.points[side].object, (i) => colours[i]);
}

const distanceWords = (step) =>
  step === FAR
    ? `${report.far_m} m or more to the other side`
    : `${number((step / FAR) * report.far_m, 2)} m to the other side`;

function dots(name, color, size, { symbol = "circle", ...more }) {
  const marker = { color, size, symbol, line: { width: 0 } };
  return { type: "scatter3d", mode: "markers", name, marker, ...more };
}

// Draws points in space; axisOf(axis): what more is said of "x", "y" or "z".
function drawInSpace(id, data, camera, { axisOf = () => ({}), uirevision, config } = {}) {
  const axes = Object.entries(AXES).map(([axis, text]) => [`${axis}axis`, { title: { text }, ...axisOf(axis) }]);
  const layout = { margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, uirevision };
  draw(id, { data, layout: { ...layout, scene: { ...Object.fromEntries(axes), camera } } }, config);
}

function drawScene() {
  const by = byId("colour").value;
  const titles = scene.objects.map((object) => plotText(objectTitle(object)));
  const coloursOf = pointColours(by);
  const traces = SIDES.map((side) => {
    const { x, y, z, object, distance } = scene.points[side];
    const more = (k) => (by === "distance" ? `<br>${distanceWords(distance[k])}` : "");
    return dots(side, coloursOf(side), 1.8, {
      ...{ x, y, z },
      visible: byId(`show_${side}`).checked,
      text: Array.from(object, (i, k) => titles[i] + more(k)),
      hovertemplate: `${side}: %{text}<extra></extra>`,
    });
  });
  traces.push(dots("chosen", paint("var(--ink)"), 3.6, { ...chosenPoints(), opacity: 0.9, hoverinfo: "skip" }));
  const farthest_m = ["x", "y"].map((axis) =>
    scene.points.real[axis].reduce((most, value) => Math.max(most, Math.abs(value)), 0),
  );
  const eye = { x: -0.75, y: -0.75, z: Math.min(1.1, 0.6 + 20 / Math.max(...farthest_m)) };
  const config = { displayModeBar: true, modeBarButtonsToRemove: ["resetCameraLastSave3d", "tableRotation"] };
  const camera = { eye, center: { x: 0, y: 0, z: -0.1 } };
  drawInSpace("scene", traces, camera, { uirevision: scene.pair, config });
  drawLegend(by);
}

export function redrawScene() {
  if (scene.pair === null) return;
  drawScene();
  if (scene.chosen !== null) chooseObject(scene.chosen);
}

function drawLegend(by) {
  const { sides, fates, none } = report.colours;
  const entry = (colour, text) =>
    element("span", null, {}, element("i", null, { style: `background: ${colour}` }), text);
  const score = report.scores[by];
  const entries = {
    side: () => [entry(sides.real, "real"), entry(sides.sim, "simulated")],
    status: () =>
      Object.entries(fates)
        .filter(([fate]) => scene.objects.some((object) => object.fate === fate))
        .map(([fate, colour]) => entry(colour, fate)),
    quadrant: () => Object.entries(report.colours.quadrants).map(([quadrant, colour]) => entry(colour, quadrant)),
    community: () => [
      element("span", "One colour per object; matched objects have the same on both sides."),
      entry(none, "unmatched"),
    ],
    distance: () => [
      element("span", null, {}, "0", bar, `${report.far_m} m or more to the nearest point of the other side`),
      element("span", "Far real points are missing surface, far simulated ones invented surface."),
    ],
  }[by];
  const bar = element("span", null, {
    class: "ramp",
    style: `background: linear-gradient(to right, ${ramp().join(",")})`,
  });
  const ofScore = () => [
    element("span", `${score.name}, 2 to 98 % of the run's objects: ${number(score.low, 2)} `, {}, bar),
    element("span", number(score.high, 2)),
    entry(none, "no score"),
  ];
  byId("legend").replaceChildren(...(entries ?? ofScore)());
}

// Points of an object (its place in scene.objects) on one side: those kept for the spectra, those left out, or all.
function pointsOf(side, place, isKept = null) {
  const { x, y, z, object, kept } = scene.points[side];
  const own = [];
  for (let i = 0; i < object.length; i += 1)
    if (object[i] === place && (isKept === null || kept[i] === isKept)) own.push(i);
  return { x: own.map((i) => x[i]), y: own.map((i) => y[i]), z: own.map((i) => z[i]) };
}

function chosenPoints() {
  const place = scene.objects.findIndex((object) => object.name === scene.chosen);
  const [a, b] = SIDES.map((side) => pointsOf(side, place));
  return { x: [...a.x, ...b.x], y: [...a.y, ...b.y], z: [...a.z, ...b.z] };
}

// A press and release on one spot chooses the object under it. Plotly's own click event comes once a frame as long as
// the button is down, and not at all for a fast click; its hover event is reliable.
function wireScene() {
  const plot = byId("scene");
  plot.on("plotly_hover", ({ points: [{ data, pointNumber }] }) => {
    const side = scene.points[data.name];
    scene.hovered = side ? scene.objects[side.object[pointNumber]].name : null;
  });
  plot.on("plotly_unhover", () => {
    scene.hovered = null;
  });
  let from = null;
  plot.addEventListener(
    "pointerdown",
    (event) => {
      from = event;
    },
    true,
  );
  plot.addEventListener(
    "pointerup",
    (event) => {
      const isClick = from !== null && Math.hypot(event.clientX - from.clientX, event.clientY - from.clientY) < 5;
      from = null;
      const choose = () => {
        if (scene.hovered !== null) chooseObject(scene.hovered);
      };
      // A finger has not hovered before: the object under it is known a moment later.
      if (isClick) setTimeout(choose, event.pointerType === "mouse" ? 0 : 250);
    },
    true,
  );
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

function drawPanel(place) {
  const object = scene.objects[place];
  say("panel_title", `Pair ${shorten(scene.pair, 60)}, object ${objectTitle(object)}`);
  const isTold = (key) => key in object && (object[key] !== null || !(object.side || key === "reason"));
  const facts = Object.entries(report.facts)
    .filter(([key]) => isTold(key))
    .map(([key, title]) => {
      const value = object[key];
      const text = typeof value === "number" ? number(value, 6) : (value ?? NULL_SIGN);
      return element(
        "div",
        null,
        {},
        element("span", title, { class: "name" }),
        element("span", text, { class: "value", "data-key": key }),
      );
    });
  byId("panel_numbers").replaceChildren(...facts);
  drawSides(place, object);
  drawSpectrum(object);
}

function drawSides(place, object) {
  const sides = Object.keys(object.owns);
  const all = sides.map((side) => pointsOf(side, place));
  const axisOf = (axis) => {
    const values = all.flatMap((points) => points[axis]);
    return { range: [Math.min(...values) - 0.2, Math.max(...values) + 0.2], nticks: 4 };
  };
  const camera = { eye: { x: -1.6, y: -1.6, z: 1.1 }, center: { x: 0, y: 0, z: -0.15 } };
  for (const side of SIDES) byId(`object_${side}`).parentElement.hidden = !sides.includes(side);
  for (const [k, side] of sides.entries()) {
    const kept = object.side ? all[k] : pointsOf(side, place, 1);
    const traces = [
      dots("kept", sideColour(side), 2.4, { ...kept, hovertemplate: object.side ? PLACE : `kept: ${PLACE}` }),
    ];
    if (!object.side) {
      const leftOut = { ...pointsOf(side, place, 0), symbol: "cross", hovertemplate: PLACE };
      traces.unshift(dots("left out", paint("var(--soft)"), 3, leftOut));
    }
    drawInSpace(`object_${side}`, traces, camera, { axisOf });
    const n = counted(object.side ? object.n_points : object[`n_${side}`]);
    const nodes = object.side
      ? "Unmatched: no counterpart, no score."
      : `Coloured dots: nodes kept for the spectral scores (${counted(object.n_keep)} of ${n}); grey crosses: left out.`;
    const nShown = counted(all[k].x.length);
    say(`object_${side}_note`, `${side === "real" ? "Real" : "Simulated"}: ${nShown} of ${n} points shown. ${nodes}`);
  }
  if (sides.length === 2) tieCameras();
}

// Turning one side of an object turns the other.
function tieCameras() {
  let isTurning = false;
  const plots = SIDES.map((side) => byId(`object_${side}`));
  plots.forEach((plot, i) => {
    plot.removeAllListeners("plotly_relayout");
    plot.on("plotly_relayout", async (change) => {
      const camera = change["scene.camera"];
      if (!camera || isTurning) return;
      isTurning = true;
      await Plotly.relayout(plots[1 - i], { "scene.camera": camera });
      isTurning = false;
    });
  });
}

function drawSpectrum(object) {
  const noCurve = { reason: "An unmatched object has no counterpart to compare spectra with" };
  const spectrum = object.side ? noCurve : report.views[scene.pair].spectra[object.real_id];
  byId("spectrum").hidden = Boolean(spectrum.reason);
  if (spectrum.reason) {
    say("spectrum_note", `Spectra: ${spectrum.reason}.`);
    return;
  }
  const x = decode(spectrum.index, Int32Array);
  const curves = SIDES.map((side) => decode(spectrum[side], Float32Array));
  const data = curves.map((y, k) => ({
    mode: "lines",
    name: ["real", "simulated"][k],
    x,
    y,
    line: { color: sideColour(SIDES[k]), width: 2, dash: ["solid", "dash"][k] },
    hovertemplate: "eigenvalue %{x}: %{y:.4f}<extra></extra>",
  }));
  const ends = curves.map((curve) => curve[spectrum.worst]);
  const color = paint("var(--ink)");
  data.push({
    mode: "lines+markers",
    name: `largest shift ${Math.abs(ends[1] - ends[0]).toFixed(3)}`,
    x: ends.map(() => x[spectrum.worst]),
    y: ends,
    line: { color, width: 3 },
    marker: { color, size: 7 },
  });
  const layout = { xaxis: { title: { text: "number of the eigenvalue, in ascending order" } } };
  draw("spectrum", { data, layout: { ...layout, yaxis: { title: { text: "eigenvalue (0 to 2)" } } } });
  const part = x.length < spectrum.n ? `, ${x.length} of them drawn` : "";
  const [above, below, ratio] = ["max_eigenvalue_shift", "laplacian_change", "r_lambda"].map((key) =>
    number(object[key], 4),
  );
  say(
    "spectrum_note",
    `Spectra of the reduced Laplacians, ${counted(spectrum.n)} eigenvalues per side${part}. ` +
      `r_lambda is the marked shift over the Laplacian change: ${above} / ${below} = ${ratio}.`,
  );
}

export function showObject(pair, name) {
  const link = report.links[pair];
  if (link && !report.views[pair]) {
    window.location.href = `${link}#${encodeURIComponent(name)}`;
    return;
  }
  if (scene.pair !== pair && !openPair(pair)) return;
  chooseObject(name);
  byId("panel").scrollIntoView({ behavior: "auto", block: "nearest" });
  byId("panel_title").focus({ preventScroll: true });
}

function stepObject(step) {
  const n = scene.objects.length;
  const now = scene.objects.findIndex((object) => object.name === scene.chosen);
  const first = step > 0 ? 0 : n - 1;
  chooseObject(scene.objects[now < 0 ? first : (now + step + n) % n].name);
}

export function startScene() {
  const pairs = Object.keys(report.views);
  if (!pairs.length) return;
  byId("viewer").hidden = false;
  byId("pair").append(...pairs.map((pair) => element("option", shorten(pair, 60), { value: pair, title: pair })));
  byId("pair").addEventListener("change", () => openPair(byId("pair").value));
  byId("object").addEventListener("change", () => chooseObject(byId("object").value || null));
  for (const id of ["colour", "show_real", "show_sim"]) byId(id).addEventListener("change", drawScene);
  byId("previous").addEventListener("click", () => stepObject(-1));
  byId("next").addEventListener("click", () => stepObject(1));
  openPair(pairs[0]);
  wireScene();
  const asked = decodeURIComponent(window.location.hash.slice(1));
  if (scene.objects.some((object) => object.name === asked)) showObject(pairs[0], asked);
}
