// The points of a pair as the page holds them, and what the views of a pair share to draw them in space.
// An object is called by side and community: "real 3", "sim 7"; a matched one has one name, that of its real side.

import { byId, draw, isDark, paint, report } from "./draw.js";
import { element, number, records, shorten, shown } from "./tables.js";

export const SIDES = ["real", "sim"];
export const SIDE_WORDS = { real: "real", sim: "simulated" };
export const FAR = 255; // the distance to the other side is a byte, this one for report.far_m and more
const AXES = { x: "x forward (m)", y: "y left (m)", z: "z up (m)" };
export const other = (side) => (side === "real" ? "sim" : "real");
export const sideColour = (side) => paint(report.colours.sides[side]);
const ramp = () => report.colours.ramps[isDark() ? "dark" : "light"];
export const say = (id, text) => {
  byId(id).textContent = shown(text);
};

export const decode = (text, Type) => new Type(Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0)).buffer);

// The columns of a pair by name; see page/pair.py for how they are packed.
async function inflate({ parts, deflated }) {
  const stream = new Blob([decode(deflated, Uint8Array)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const columns = {};
  let at = 0;
  for (const [name, width, n] of parts) {
    columns[name] = width === 1 ? bytes.subarray(at, at + n) : summed(bytes.subarray(at, at + width * n), width, n);
    at += width * n;
  }
  return columns;
}

// Integers from their differences; sums beyond the width begin again, as they do in the type of the result.
function summed(bytes, width, n) {
  const values = width === 2 ? new Int16Array(n) : new Int32Array(n);
  let sum = 0;
  for (let i = 0; i < n; i += 1) {
    let step = 0;
    for (let k = 0; k < width; k += 1) step |= bytes[k * n + i] << (8 * k);
    sum += step;
    values[i] = sum;
    sum = values[i];
  }
  return values;
}

// Rows of the page as objects: what each is called, its fate, which communities it owns on which side.
export function objectsOf(view) {
  const matched = records(report.matched_columns, view.matched).map((row) => ({
    ...row,
    name: `real ${row.real_id}`,
    fate: row.status === "too_small" ? "too small" : "matched",
    owns: { real: row.real_id, sim: row.sim_id },
    move: view.moves[row.real_id],
  }));
  const unmatched = records(report.unmatched_columns, view.unmatched).map((row) => ({
    ...row,
    name: `${row.side} ${row.community_id}`,
    fate: row.status,
    owns: { [row.side]: row.community_id },
    cdc: null,
    r_lambda: null,
  }));
  return [...matched, ...unmatched];
}

// By side the points, each with the place of its object among the objects (`object`), whether it is a kept node, its
// distance to the other side (`distance`) and to its aligned partner (`aligned`), whether a piece that only one side has
// holds it (`piece`), if simulated its signed distance to the planes of the real side (`signed`), and by place where the
// points of an object are (`ranges`); the road points; and between which points lines of alignment are. Where the real side fixes
// the objects, the few simulated points of a missing one bear its number and belong to it.
export async function pointsOf(view, objects) {
  const columns = await inflate(view.packed);
  const inSpace = (name) =>
    Object.fromEntries(
      ["x", "y", "z"].map((axis) => [
        axis,
        Float32Array.from(columns[`${name}_${axis}`], (step) => step * view.step_m),
      ]),
    );
  const points = {};
  for (const side of SIDES) {
    const { ids, counts } = view.sides[side];
    const owner = new Map();
    objects.forEach(({ fate, owns }, i) => {
      if (fate === "missing") owner.set(owns.real, i);
    });
    objects.forEach(({ owns }, i) => {
      if (side in owns) owner.set(owns[side], i);
    });
    const object = new Int32Array(counts.reduce((sum, n) => sum + n, 0));
    const ranges = new Map();
    let from = 0;
    ids.forEach((id, k) => {
      ranges.set(owner.get(id), [from, from + counts[k]]);
      object.fill(owner.get(id), from, from + counts[k]);
      from += counts[k];
    });
    const own = ["kept", "distance", "aligned", "piece", "signed"].map((name) => [name, columns[`${side}_${name}`]]);
    points[side] = { ...inSpace(side), object, ranges, ...Object.fromEntries(own) };
  }
  const road = Object.fromEntries(
    SIDES.map((side) => [side, { ...inSpace(`${side}_road`), signed: columns[`${side}_road_signed`] }]),
  );
  return { ...points, road, rays: columns.rays, lines: { real: columns.real_line, sim: columns.sim_line } };
}

// Places among the points of a side that an object has.
export function ownPlaces(points, side, place) {
  const [from, to] = points[side].ranges.get(place) ?? [0, 0];
  return Array.from({ length: to - from }, (_, i) => from + i);
}

export const at = ({ x, y, z }, places) => ({
  x: places.map((i) => x[i]),
  y: places.map((i) => y[i]),
  z: places.map((i) => z[i]),
});

// Smallest and largest coordinate of sets of points by axis.
export function extent(sets) {
  const found = {};
  for (const axis of ["x", "y", "z"]) {
    let [low, high] = [Infinity, -Infinity];
    for (const set of sets)
      for (const value of set[axis]) {
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    found[axis] = [low, high];
  }
  return found;
}

export function objectTitle(object) {
  const ids = object.side ? object.name : `real ${object.real_id}, sim ${object.sim_id}`;
  const scores = object.side ? object.fate : `CDC ${number(object.cdc, 2)}, r_lambda ${number(object.r_lambda, 2)}`;
  return `${ids}: ${shorten(object.group)}, ${scores}`;
}

// Share of an unmatched object that is road to the other side, as text; "" for 0.
export function roadWords(object) {
  const share = object.side ? object[`road_share_${object.side}`] : null;
  return share >= 0.005
    ? `${Math.round(100 * share)} % of it is road on the ${SIDE_WORDS[other(object.side)]} side`
    : "";
}

// plotly reads a little markup in its texts: its meaning is taken away.
export const plotText = (text) =>
  shorten(shown(text), 80).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

export function rampColour(share, stops = ramp()) {
  const along = Math.min(0.9999, Math.max(0, share)) * (stops.length - 1);
  const [a, b] = [stops[Math.floor(along)], stops[Math.floor(along) + 1]];
  const mix = (k) =>
    Math.round(
      Number.parseInt(a.slice(k, k + 2), 16) * (1 - (along % 1)) + Number.parseInt(b.slice(k, k + 2), 16) * (along % 1),
    );
  return `rgb(${mix(1)},${mix(3)},${mix(5)})`;
}

export const rampBar = (stops = ramp()) =>
  element("span", null, { class: "ramp", style: `background: linear-gradient(to right, ${stops.join(",")})` });

// The colour of each distance that a byte can be.
export const distanceShades = () => Array.from({ length: FAR + 1 }, (_, step) => rampColour(step / FAR));

// The signed distance to the real side is a byte from -report.signed_m to report.signed_m, FAR for none.
export const signedMetres = (step) => ((2 * step) / (FAR - 1) - 1) * report.signed_m;
export const signedShades = () =>
  Array.from({ length: FAR + 1 }, (_, step) =>
    step === FAR
      ? paint("var(--line)")
      : rampColour((signedMetres(step) / report.signed_ramp_m + 1) / 2, report.colours.signed),
  );
export const signedWords = (step) =>
  step === FAR
    ? "no real plane next to it"
    : `${number(Math.abs(signedMetres(step)), 2)} m ${signedMetres(step) < 0 ? "behind" : "in front of"} the real surface`;

export const distanceWords = (step) =>
  step === FAR ? `${report.far_m} m or more` : `${number((step / FAR) * report.far_m, 2)} m`;

export function dots(name, color, size, { symbol = "circle", opacity = 1, ...more }) {
  const marker = { color, size, symbol, opacity, line: { width: 0 } };
  return { type: "scatter3d", mode: "markers", name, marker, ...more };
}

// Road points of a side, all or some of them, as a context that nothing is asked of.
export function roadDots(side, road, size, places = null, colour = paint("var(--line)")) {
  const set = places ? at(road, places) : { x: road.x, y: road.y, z: road.z };
  return dots(`road ${side}`, colour, size, { ...set, hoverinfo: "skip" });
}

// Lines between pairs of points: ends [a, b, a, b ...] of which each two are one.
export function strokes(name, color, ends, width = 2, more = {}) {
  const axis = (key) => ends.flatMap((end, i) => (i % 2 ? [end[key], null] : [end[key]]));
  const line = { color, width };
  return {
    type: "scatter3d",
    mode: "lines",
    name,
    x: axis("x"),
    y: axis("y"),
    z: axis("z"),
    line,
    hoverinfo: "skip",
    ...more,
  };
}

// The twelve edges of the box around an extent.
export function boxEdges({ x, y, z }, margin_m = 0) {
  const corner = (i) => ({
    x: i & 1 ? x[1] + margin_m : x[0] - margin_m,
    y: i & 2 ? y[1] + margin_m : y[0] - margin_m,
    z: i & 4 ? z[1] + margin_m : z[0] - margin_m,
  });
  const ends = [];
  for (let i = 0; i < 8; i += 1) for (const bit of [1, 2, 4]) if (!(i & bit)) ends.push(corner(i), corner(i | bit));
  return ends;
}

// The same direction of view at a place's own distance, for two places that turn together.
export function turnTogether(ids) {
  let isTurning = false;
  const turned = (from) => () => {
    const own = byId(from)._fullLayout.scene._scene.getCamera();
    if (isTurning) return;
    isTurning = true;
    const away = ({ eye, center }) => ["x", "y", "z"].map((axis) => eye[axis] - center[axis]);
    const direction = away(own);
    const length = Math.hypot(...direction);
    const others = ids.filter((id) => id !== from && byId(id)?.data);
    Promise.all(
      others.map((id) => {
        const camera = byId(id)._fullLayout.scene._scene.getCamera();
        const far = Math.hypot(...away(camera));
        const eye = Object.fromEntries(
          ["x", "y", "z"].map((axis, k) => [axis, camera.center[axis] + (direction[k] / length) * far]),
        );
        return Plotly.relayout(id, { "scene.camera": { ...camera, eye, up: own.up } });
      }),
    ).finally(() => {
      isTurning = false;
    });
  };
  for (const id of ids) {
    const place = byId(id);
    if (place.dataset.turns || !place.on) continue;
    place.dataset.turns = "yes";
    for (const name of ["plotly_relayout", "plotly_relayouting"]) place.on(name, turned(id));
  }
}

// Draws points in space. ranges: by axis from where to where; the box has their proportions.
export function drawInSpace(id, data, camera, ranges, config) {
  const axes = Object.entries(AXES).map(([axis, text]) => [
    `${axis}axis`,
    { title: { text }, range: ranges[axis], autorange: false, nticks: 5 },
  ]);
  const unit = unitOf(ranges);
  const ratio = Object.fromEntries(Object.entries(ranges).map(([axis, [low, high]]) => [axis, (high - low) / unit]));
  const scene = { ...Object.fromEntries(axes), aspectmode: "manual", aspectratio: ratio, camera };
  const layout = { margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, scene };
  draw(id, { data, layout }, config);
}

// How many metres are one unit of plotly's camera: the geometric mean of the sides of the box.
function unitOf(ranges) {
  return Math.cbrt(Object.values(ranges).reduce((product, [low, high]) => product * (high - low), 1));
}

// A camera that looks at the middle of an extent, from the side of the sensor and from above.
export function cameraAt(target, ranges, distance_m) {
  const unit = unitOf(ranges);
  const middle = ([low, high]) => (low + high) / 2;
  const [x, y] = [middle(target.x), middle(target.y)];
  const away = Math.hypot(x, y) || 1;
  const steps = { x: (-0.75 * x) / away, y: (-0.75 * y) / away, z: 0.66 };
  const center = {};
  const eye = {};
  for (const axis of ["x", "y", "z"]) {
    center[axis] = (middle(target[axis]) - middle(ranges[axis])) / unit;
    eye[axis] = center[axis] + (steps[axis] * distance_m) / unit;
  }
  return { center, eye, up: { x: 0, y: 0, z: 1 } };
}
