// The points of a pair as the page holds them, how they are coloured, and what all views in space share.
// An object is called by side and community: "real 3", "sim 7"; a matched one has one name, that of its real side.

import { byId, draw, isDark, paint, report } from "./draw.js";
import { element, number, shorten, shown } from "./tables.js";

export const SIDES = ["real", "sim"];
export const SIDE_WORDS = { real: "real", sim: "simulated" };
export const FAR = 255; // the byte of a point without a signed distance
const LABELS_PX = { x: 140, y: 110 };
const AXES = { x: "x forward (m)", y: "y left (m)", z: "z up (m)" };
export const sideColour = (side) => paint(report.colours.sides[side]);
export const say = (id, text) => {
  byId(id).textContent = shown(text);
};
export const xyz = (make) => ({ x: make("x"), y: make("y"), z: make("z") });

// A packed array of the page, as numbers; see page/pair_data.py.
async function unpack(text, NumberArray) {
  const deflated = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
  const stream = new Blob([deflated]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new NumberArray(await new Response(stream).arrayBuffer());
}

// Objects with the communities that they own by side, their fate, and their side if they have only one.
export function objectsOf(view) {
  return view.objects.map((row) => {
    const owns = Object.fromEntries(SIDES.map((side) => [side, row[`${side}_id`]]).filter(([, id]) => id >= 0));
    const [side, partner] = Object.keys(owns);
    return partner ? { ...row, owns, fate: "matched" } : { ...row, owns, side, fate: row.status };
  });
}

// By side the points, each with the place of its object among the objects (`object`), whether a piece that only one
// side has holds it (`piece`), if simulated its signed distance to the planes of the real side (`signed`), and by place
// where the points of an object are (`ranges`); and the road points, which follow those of objects in the page.
export async function pointsOf(view, objects) {
  const points = { road: {} };
  for (const side of SIDES) {
    const packed = view.sides[side];
    const metres = Float32Array.from(await unpack(packed.points, Int16Array), (step) => step * view.step_m);
    const signed = packed.signed ? await unpack(packed.signed, Uint8Array) : undefined;
    const places = placesOf(packed, ownersOf(objects, side));
    const n = metres.length / 3;
    const part = (from, to) => ({
      ...xyz((axis) => metres.subarray("xyz".indexOf(axis) * n).subarray(from, to)),
      signed: signed?.subarray(from, to),
    });
    const nObjects = places.object.length;
    points[side] = { ...part(0, nObjects), ...places, piece: await unpack(packed.piece, Uint8Array) };
    points.road[side] = part(nObjects, n);
  }
  return points;
}

// The place of the object that each community of a side belongs to. Where the real side fixes the objects, the few
// simulated points of a missing one bear its number and belong to it.
function ownersOf(objects, side) {
  const owners = new Map();
  objects.forEach(({ fate, owns }, place) => {
    if (fate === "not_found") owners.set(owns.real, place);
  });
  objects.forEach(({ owns }, place) => {
    if (side in owns) owners.set(owns[side], place);
  });
  return owners;
}

// The object of each point of a side, whose points are ordered by community, and the range of points of each object.
function placesOf({ ids, counts }, owners) {
  const object = new Int32Array(counts.reduce((sum, n) => sum + n, 0));
  const ranges = new Map();
  let from = 0;
  ids.forEach((id, k) => {
    const to = from + counts[k];
    ranges.set(owners.get(id), [from, to]);
    object.fill(owners.get(id), from, to);
    from = to;
  });
  return { object, ranges };
}

// Places among the points of a side that an object has.
export function ownPlaces(points, side, place) {
  const [from, to] = points[side].ranges.get(place) ?? [0, 0];
  return Array.from({ length: to - from }, (_, i) => from + i);
}

export const at = (set, places) => xyz((axis) => places.map((i) => set[axis][i]));

// Smallest and largest coordinate of sets of points by axis, with a margin.
export const extent = (sets, margin_m = 0) =>
  xyz((axis) => {
    let [low, high] = [Infinity, -Infinity];
    for (const set of sets)
      for (const value of set[axis]) {
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    return [low - margin_m, high + margin_m];
  });

export function objectTitle(object) {
  const ids = object.side ? object.name : `real ${object.real_id}, sim ${object.sim_id}`;
  const scores = object.side ? object.fate : `CDC ${number(object.cdc, 2)}, r_lambda ${number(object.r_lambda, 2)}`;
  return `${ids}: ${shorten(object.group)}, ${scores}`;
}

// plotly reads a little markup in its texts: its meaning is taken away.
export const plotText = (text) =>
  shorten(shown(text), 80).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

function rampColour(share, stops) {
  const along = Math.min(0.9999, Math.max(0, share)) * (stops.length - 1);
  const [a, b] = [0, 1].map((k) =>
    stops[Math.floor(along) + k].match(/\w\w/g).map((part) => Number.parseInt(part, 16)),
  );
  return `rgb(${a.map((value, k) => Math.round(value * (1 - (along % 1)) + b[k] * (along % 1))).join(",")})`;
}

// The signed distance to the real side is a byte from -report.signed_m to report.signed_m, FAR for none.
export const signedMetres = (step) => ((2 * step) / (FAR - 1) - 1) * report.signed_m;
const signedWords = (step) =>
  step === FAR
    ? "no real plane next to it"
    : `${number(Math.abs(signedMetres(step)), 2)} m ${signedMetres(step) < 0 ? "behind" : "in front of"} the real surface`;

// The colour of a signed distance to the real side in metres, null for none.
export const signedColour = (metres) =>
  metres === null ? paint("var(--line)") : rampColour((metres / report.signed_ramp_m + 1) / 2, report.colours.signed);
export const signedLegend = () => {
  const reach = `${report.signed_ramp_m} m or more`;
  return [
    rampBar(`${reach} behind `, report.colours.signed, ` ${reach} in front of the real surface, seen from the sensor`),
    swatch("var(--line)", "real, or no real plane next to it"),
  ];
};

// An entry of a legend: a colour, or a ramp from one value to another.
export const swatch = (colour, text) =>
  element("span", null, {}, element("i", null, { style: `background: ${colour}` }), text);
const rampBar = (from, stops, to) => {
  const style = `background: linear-gradient(to right, ${stops.join(",")})`;
  return element("span", null, {}, from, element("span", null, { class: "ramp", style }), to);
};

// How points are coloured: `colours` of some places of a side (one for all or one each), `words` of a place (or none),
// the colour of a road point, the side that is context only (`faint`), and the legend.
export function colouring({ objects, points }, by) {
  const { none, sides, quadrants, ramps } = report.colours;
  const ramp = ramps[isDark() ? "dark" : "light"];
  const bytes = Array.from({ length: FAR + 1 }, (_, step) => step);
  const ofPoints = (shade) => (side, places) => places.map((i) => shade(side, i));
  const ofObjects = (shade) => {
    const shades = objects.map(shade);
    return ofPoints((side, i) => shades[points[side].object[i]]);
  };
  const kinds = {
    side: () => ({ colours: sideColour, legend: SIDES.map((side) => swatch(sides[side], SIDE_WORDS[side])) }),
    quadrant: () => ({
      colours: ofObjects(({ quadrant }) => paint(quadrants[quadrant] ?? none)),
      legend: Object.entries(quadrants).map(([quadrant, colour]) => swatch(colour, quadrant)),
    }),
    community: () => ({
      colours: ofObjects(({ side }, i) =>
        side ? none : `hsl(${Math.round((i * 137.508) % 360)}, 65%, ${[48, 62, 38][i % 3]}%)`,
      ),
      legend: ["One colour per object; matched objects have the same on both sides.", swatch(none, "unmatched")],
    }),
    signed: () => {
      const shades = bytes.map((step) => signedColour(step === FAR ? null : signedMetres(step)));
      return {
        faint: "real",
        colours: ofPoints((side, i) => (side === "real" ? signedColour(null) : shades[points.sim.signed[i]])),
        road: (step) => shades[step],
        words: (side, i) => (side === "sim" ? signedWords(points.sim.signed[i]) : ""),
        legend: signedLegend(),
      };
    },
  };
  if (by in kinds) return kinds[by]();
  const { name, limit } = report.scores[by];
  const shade = (object) => (object[by] === null ? none : rampColour(object[by] / (2 * limit), ramp));
  const to = ` ${number(2 * limit, 1)} or more; faithful up to ${limit}`;
  return { colours: ofObjects(shade), legend: [rampBar(`${name} 0 `, ramp, to), swatch(none, "no score")] };
}

export function dots(name, color, size, { symbol = "circle", opacity = 1, ...more }) {
  const marker = { color, size, symbol, opacity, line: { width: 0 } };
  return { type: "scatter3d", mode: "markers", name, marker, ...more };
}

// Road points of a side, all or some of them, as a context that nothing is asked of.
export function roadDots(side, road, places, { road: shade } = {}) {
  const own = places ?? [...road.x.keys()];
  const isShaded = shade && road.signed;
  const colour = isShaded ? own.map((i) => shade(road.signed[i])) : paint("var(--line)");
  return dots(`road ${side}`, colour, isShaded ? 2 : 1.6, { ...at(road, own), hoverinfo: "skip" });
}

// Lines between pairs of points: ends [a, b, a, b ...] of which each two are one.
export function strokes(name, color, ends, width) {
  const axes = xyz((axis) => ends.flatMap((end, i) => (i % 2 ? [end[axis], null] : [end[axis]])));
  return { type: "scatter3d", mode: "lines", name, ...axes, line: { color, width }, hoverinfo: "skip" };
}

const cornersOf = ({ x, y, z }) =>
  Array.from({ length: 8 }, (_, i) => ({ x: x[i & 1], y: y[(i >> 1) & 1], z: z[(i >> 2) & 1] }));

// The twelve edges of the box around an extent.
export function boxEdges(ranges) {
  const corners = cornersOf(ranges);
  return corners.flatMap((corner, i) => [1, 2, 4].flatMap((bit) => (i & bit ? [] : [corner, corners[i | bit]])));
}

// The same direction of view at a place's own distance, for two places that turn together.
export function turnTogether(ids) {
  const cameraOf = (id) => byId(id)._fullLayout.scene._scene.getCamera();
  const away = ({ eye, center }) => xyz((axis) => eye[axis] - center[axis]);
  const length = ({ x, y, z }) => Math.hypot(x, y, z);
  const turn = (from) => {
    const own = cameraOf(from);
    for (const id of ids.filter((one) => one !== from && byId(one).data)) {
      const camera = cameraOf(id);
      const scale = length(away(camera)) / length(away(own));
      const eye = xyz((axis) => camera.center[axis] + scale * away(own)[axis]);
      // The other place answers with its own event, which ends where both agree.
      if (length(xyz((axis) => eye[axis] - camera.eye[axis] + own.up[axis] - camera.up[axis])) > 1e-6)
        Plotly.relayout(id, { "scene.camera": { ...camera, eye, up: own.up } });
    }
  };
  for (const id of ids) {
    const place = byId(id);
    if (place.dataset.turns || !place.on) continue;
    place.dataset.turns = "yes";
    for (const name of ["plotly_relayout", "plotly_relayouting"]) place.on(name, () => turn(id));
  }
}

// Draws points in space. ranges: by axis from where to where; the box has their proportions.
export function drawInSpace(id, data, camera, ranges, config) {
  const unit = unitOf(ranges);
  const scene = {
    aspectmode: "manual",
    aspectratio: xyz((axis) => (ranges[axis][1] - ranges[axis][0]) / unit),
    camera,
  };
  const longest = Math.max(...Object.values(scene.aspectratio));
  for (const [axis, text] of Object.entries(AXES)) {
    const nticks = Math.max(2, Math.round((10 * scene.aspectratio[axis]) / longest));
    scene[`${axis}axis`] = { title: { text }, range: ranges[axis], autorange: false, nticks };
  }
  draw(id, { data, layout: { margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, scene } }, config);
}

// How many metres are one unit of plotly's camera: the geometric mean of the sides of the box.
function unitOf(ranges) {
  return Math.cbrt(Object.values(ranges).reduce((product, [low, high]) => product * (high - low), 1));
}

// A camera that sees all of an extent in a place of the page, with room for labels, from the side of the sensor and from
// above; around the sensor so that the longer side of the extent lies along that of the place.
export function cameraOn(id, target, ranges) {
  const middle = xyz((axis) => (target[axis][0] + target[axis][1]) / 2);
  const isAround = [target.x, target.y].every(([low, high]) => low <= 0 && high >= 0);
  const { offsetWidth, offsetHeight } = byId(id);
  const isAcross = target.x[1] - target.x[0] > target.y[1] - target.y[0] === offsetWidth > offsetHeight;
  const [x, y] = isAround ? [isAcross ? 0.6 : 1, isAcross ? 1 : 0.6] : [middle.x, middle.y];
  const back = scaled({ x: -x, y: -y, z: 0.75 * Math.hypot(x, y) });
  const right = scaled({ x: -back.y, y: back.x, z: 0 });
  const up = { x: -back.z * right.y, y: back.z * right.x, z: Math.hypot(back.x, back.y) };
  // Plotly's field of view is 45 degrees high. What a metre far may be to the right and up:
  const slopes = [offsetWidth - LABELS_PX.x, offsetHeight - LABELS_PX.y].map(
    (size) => (Math.tan(Math.PI / 8) * size) / offsetHeight,
  );
  let [aim, away] = [middle, 0];
  for (let i = 0; i < 4; i += 1) {
    const own = cornersOf(target).map((corner) => xyz((axis) => corner[axis] - aim[axis]));
    away = Math.max(...own.flatMap((a) => [right, up].map((b, k) => dot(a, back) + Math.abs(dot(a, b)) / slopes[k])));
    const [along, above] = [right, up].map((b) => {
      const seen = own.map((a) => dot(a, b) / (away - dot(a, back)));
      return (away * (Math.min(...seen) + Math.max(...seen))) / 2;
    });
    aim = xyz((axis) => aim[axis] + along * right[axis] + above * up[axis]);
  }
  const unit = unitOf(ranges);
  const center = xyz((axis) => (aim[axis] - (ranges[axis][0] + ranges[axis][1]) / 2) / unit);
  return { center, eye: xyz((axis) => center[axis] + (back[axis] * away) / unit), up: { x: 0, y: 0, z: 1 } };
}

const dot = (a, b) => a.x * b.x + a.y * b.y + a.z * b.z;
const scaled = (a) => xyz((axis) => a[axis] / Math.sqrt(dot(a, a)));
