// The 3D view of a pair: its points, the road, the sensor, which object is chosen, and the address of that object.

import { byId, draw, drawInView, paint, report } from "./draw.js";
import { closePanel, drawPanel, redrawPanel, startPanel } from "./object.js";
import {
  at,
  boxEdges,
  cameraAt,
  distanceShades,
  distanceWords,
  dots,
  drawInSpace,
  extent,
  FAR,
  objectsOf,
  objectTitle,
  ownPlaces,
  plotText,
  pointsOf,
  rampBar,
  rampColour,
  roadDots,
  roadWords,
  SIDE_WORDS,
  SIDES,
  say,
  sideColour,
  signedMetres,
  signedShades,
  signedWords,
  strokes,
  turnTogether,
} from "./points.js";
import { counted, element, number, shorten, shown } from "./tables.js";

const MOST_DRAWN = 9000; // of a side in the whole pair, and of each object at least FEWEST_DRAWN; the panel has all
const FEWEST_DRAWN = 80;
const BOX_MARGIN_M = 0.2;
const SENSOR_AXIS_M = 4;
const MOST_SUGGESTED = 6;
// pair: {name, view, objects, points, drawn, ranges}, the open one; opening: the name of the one being opened
const scene = { pair: null, opening: null, chosen: null, hovered: null };
const communityColour = (i) => `hsl(${Math.round((i * 137.508) % 360)}, 65%, ${[48, 62, 38][i % 3]}%)`;

// The address of a pair, or of an object, within the page that shows it.
const linkWithin = (pair, name) =>
  `#pair=${encodeURIComponent(pair)}${name ? `&object=${encodeURIComponent(name)}` : ""}`;

// The address of a pair or of an object: here, on the page of its pair, or null if it is nowhere in 3D.
export function linkTo(pair, name) {
  if (report.views[pair]) return linkWithin(pair, name);
  return report.links[pair] ? report.links[pair] + linkWithin(pair, name) : null;
}

// Opens a pair without choosing an object; false if another one was requested meanwhile.
async function openPair(name) {
  scene.opening = name;
  const view = report.views[name];
  const objects = objectsOf(view);
  const points = await pointsOf(view, objects);
  if (scene.opening !== name) return false;
  const drawn = Object.fromEntries(SIDES.map((side) => [side, drawnOf(points[side])]));
  const sensor = { x: [0, SENSOR_AXIS_M], y: [0, 0], z: [0, 0] };
  const ranges = extent([points.real, points.sim, points.road.real, points.road.sim, sensor]);
  scene.pair = { name, view, objects, points, drawn, ranges };
  byId("pair").value = name;
  const options = objects.map((object) => element("option", objectTitle(object), { value: object.name }));
  byId("object").replaceChildren(element("option", "none", { value: "" }), ...options);
  const parts = SIDES.map(
    (side) => `${counted(drawn[side].length)} of ${counted(view.sides[side].n)} object points (${SIDE_WORDS[side]})`,
  );
  say("scene_note", `Shown: ${parts.join(", ")}, thinned for display only; all scores are of all points.`);
  suggest();
  setChosen(null);
  drawRays();
  drawInView("signed", drawSigned);
  look(wholePair());
  return true;
}

// Draws the pair when it is in view, seen by a camera; later by the one that its user has turned.
function look(camera) {
  scene.camera = camera;
  drawInView("scene", () => {
    drawScene(scene.camera ?? byId("scene").layout?.scene.camera);
    if (!byId("scene").dataset.wired) wireScene();
    scene.camera = null;
  });
}

// How far the simulated points are in front of the real planes next to them, and behind.
function drawSigned() {
  const { points } = scene.pair;
  const sets = { road: points.road.sim.signed, objects: points.sim.signed };
  const n = 50;
  const width = (2 * report.signed_m) / n;
  const x = Array.from({ length: n }, (_, k) => -report.signed_m + (k + 0.5) * width);
  const said = [];
  const data = Object.entries(sets).map(([name, steps]) => {
    const metres = Array.from(
      steps.filter((step) => step !== FAR),
      signedMetres,
    ).sort((a, b) => a - b);
    const counts = new Array(n).fill(0);
    for (const value of metres) counts[Math.min(n - 1, Math.floor((value + report.signed_m) / width))] += 1;
    const middle = metres[Math.floor(metres.length / 2)];
    if (metres.length)
      said.push(
        `${name}: median ${number(Math.abs(100 * middle), 1)} cm ${middle < 0 ? "behind" : "in front"}, ` +
          `${Math.round((100 * metres.length) / steps.length)} % of the points have a real plane within ${report.signed_m} m`,
      );
    const y = counts.map((count) => (100 * count) / Math.max(1, metres.length));
    const color = name === "road" ? paint("var(--soft)") : sideColour("sim");
    return { type: "scatter", mode: "lines", name, x, y, line: { shape: "hvh", width: 2, color } };
  });
  const line = { type: "line", x0: 0, x1: 0, y0: 0, y1: 1, yref: "paper", line: { width: 1, dash: "dash" } };
  const xaxis = { title: { text: "simulated behind (−) or in front of (+) the real surface (m)" } };
  draw("signed", { data, layout: { xaxis, yaxis: { title: { text: "%" }, rangemode: "tozero" }, shapes: [line] } });
  const words = said.length ? `${said.join("; ")}.` : "no simulated point has a real plane next to it.";
  say("signed_note", `Signed distance of the simulated points to the real planes next to them. ${words}`);
}

// The range image of the outcomes: a byte a ray, row by row from the highest beam; 255 for a ray that returned nothing.
function drawRays() {
  const { view, points } = scene.pair;
  byId("ray_figure").hidden = !view.n_beams;
  if (!view.n_beams) return;
  const canvas = byId("ray_image");
  const outcomes = Object.values(report.colours.outcomes);
  const colours = outcomes.map(({ colour }) =>
    paint(colour)
      .match(/\w\w/g)
      .map((part) => parseInt(part, 16)),
  );
  canvas.height = view.n_beams;
  canvas.width = points.rays.length / view.n_beams;
  const image = new ImageData(canvas.width, canvas.height);
  points.rays.forEach((outcome, i) => {
    if (outcome < colours.length) image.data.set([...colours[outcome], 255], 4 * i);
  });
  canvas.getContext("2d").putImageData(image, 0, 0);
  const entries = outcomes.map(({ colour, words }) =>
    element("span", null, {}, element("i", null, { style: `background: ${paint(colour)}` }), words),
  );
  byId("ray_legend").replaceChildren(...entries);
}

// Every Nth point of each object, so that about MOST_DRAWN remain.
function drawnOf({ object, ranges }) {
  const every = Math.ceil(object.length / MOST_DRAWN);
  return [...ranges.values()].flatMap(([from, to]) => {
    const step = Math.max(1, Math.min(every, (to - from) / FEWEST_DRAWN));
    const places = [];
    for (let i = from; i < to; i += step) places.push(Math.floor(i));
    return places;
  });
}

// What to look at while no object is chosen: the worst matched objects and the largest unmatched ones.
function suggest() {
  const { name, objects } = scene.pair;
  const lone = objects.filter(({ side }) => side).slice(0, MOST_SUGGESTED);
  const worst = objects.filter(({ side }) => !side).slice(0, MOST_SUGGESTED);
  const links = [...worst, ...lone].map((object) =>
    element("li", null, {}, element("a", objectTitle(object), { href: linkWithin(name, object.name) })),
  );
  byId("suggested").replaceChildren(...links);
}

function objectColour(object, i, by) {
  const { none, fates } = report.colours;
  if (by === "community") return object.side ? none : communityColour(i);
  if (by === "status") return paint(fates[object.fate]);
  if (by === "quadrant") return paint(report.colours.quadrants[object.quadrant] ?? none);
  const { low, high } = report.scores[by];
  return object[by] === null ? none : rampColour((object[by] - low) / (high - low));
}

// By side, the colour of its drawn points, one for all or one each.
function pointColours({ objects, points, drawn }, by) {
  if (by === "side") return sideColour;
  if (by === "distance") {
    const shades = distanceShades();
    return (side) => drawn[side].map((i) => shades[points[side].distance[i]]);
  }
  if (by === "signed") {
    const shades = signedShades();
    return (side) => (side === "real" ? paint("var(--line)") : drawn.sim.map((i) => shades[points.sim.signed[i]]));
  }
  const colours = objects.map((object, i) => objectColour(object, i, by));
  return (side) => drawn[side].map((i) => colours[points[side].object[i]]);
}

// The points of the pieces that only one side has, on top of all others.
const PIECES = { real: "missing", sim: "invented" };
function pieceTraces({ points }) {
  return SIDES.map((side) => {
    const places = Array.from(points[side].piece.keys()).filter((i) => points[side].piece[i]);
    return dots(PIECES[side], sideColour(side), 3, {
      ...at(points[side], places),
      visible: byId(`show_${PIECES[side]}`).checked,
      hoverinfo: "skip",
    });
  });
}

function contextTraces({ points }, by) {
  const isRoadShown = byId("show_road").checked;
  const shades = by === "signed" ? signedShades() : null;
  const road = SIDES.map((side) => {
    const own = points.road[side];
    const colour = shades && side === "sim" ? Array.from(own.signed, (step) => shades[step]) : undefined;
    return {
      ...roadDots(side, own, colour ? 2 : 1.5, null, colour),
      visible: isRoadShown && byId(`show_${side}`).checked,
    };
  });
  const ink = paint("var(--ink)");
  const [sensor, ahead] = [0, SENSOR_AXIS_M].map((x) => ({ x, y: 0, z: 0 }));
  const axis = strokes("forward", ink, [sensor, ahead], 5);
  const mark = dots("sensor", ink, 5, { x: [0], y: [0], z: [0], symbol: "square", text: ["sensor"] });
  const text = { mode: "markers+text", textposition: "top center", textfont: { color: ink, size: 13 } };
  return [...road, axis, { ...mark, ...text, hovertemplate: "sensor; the line points ahead<extra></extra>" }];
}

function drawScene(camera) {
  const { pair } = scene;
  const by = byId("colour").value;
  const titles = pair.objects.map((object) =>
    [objectTitle(object), roadWords(object)].filter(Boolean).map(plotText).join("<br>"),
  );
  const coloursOf = pointColours(pair, by);
  const traces = SIDES.map((side) => {
    const own = pair.points[side];
    const more = (i) => {
      if (by === "distance") return `<br>${distanceWords(own.distance[i])} to the other side`;
      return by === "signed" && side === "sim" ? `<br>${signedWords(own.signed[i])}` : "";
    };
    return dots(side, coloursOf(side), 1.8, {
      ...at(own, pair.drawn[side]),
      visible: byId(`show_${side}`).checked,
      text: pair.drawn[side].map((i) => titles[own.object[i]] + more(i)),
      hovertemplate: `${SIDE_WORDS[side]}: %{text}<extra></extra>`,
    });
  });
  traces.push(...pieceTraces(pair), strokes("chosen", paint("var(--ink)"), chosenBox(), 4), ...contextTraces(pair, by));
  const modeBarButtons = [["toImage", "zoom3d", "pan3d", "orbitRotation", "resetCameraDefault3d"]];
  const config = { displayModeBar: true, modeBarButtons };
  drawInSpace("scene", traces, camera, pair.ranges, config);
  drawLegend(by);
}

function redrawPair() {
  if (scene.pair === null) return;
  look(undefined);
  drawRays();
}

function drawLegend(by) {
  const { sides, fates, none } = report.colours;
  const entry = (colour, text) =>
    element("span", null, {}, element("i", null, { style: `background: ${colour}` }), text);
  const score = report.scores[by];
  const bar = rampBar();
  const entries = {
    side: () => [entry(sides.real, "real"), entry(sides.sim, "simulated")],
    status: () =>
      Object.entries(fates)
        .filter(([fate]) => scene.pair.objects.some((object) => object.fate === fate))
        .map(([fate, colour]) => entry(colour, fate)),
    quadrant: () => Object.entries(report.colours.quadrants).map(([quadrant, colour]) => entry(colour, quadrant)),
    community: () => [
      element("span", "One colour per object; matched objects have the same on both sides."),
      entry(none, "unmatched"),
    ],
    signed: () => [
      element(
        "span",
        null,
        {},
        `${report.signed_ramp_m} m or more behind`,
        rampBar(report.colours.signed),
        `${report.signed_ramp_m} m or more in front of the real surface, seen from the sensor`,
      ),
      entry("var(--line)", "real, or no real plane next to it"),
    ],
    distance: () => [
      element("span", null, {}, "0", bar, `${report.far_m} m or more to the nearest point of the other side`),
      element("span", "Far real points are missing surface, far simulated ones invented surface."),
    ],
  }[by];
  const ofScore = () => [
    element("span", `${score.name}, 2 to 98 % of the run's objects: ${number(score.low, 2)} `, {}, bar),
    element("span", number(score.high, 2)),
    entry(none, "no score"),
  ];
  const road = byId("show_road").checked ? [entry("var(--line)", "road (removed as ground), thinned")] : [];
  byId("legend").replaceChildren(...(entries ?? ofScore)(), ...road);
}

const placeOf = (name) => scene.pair.objects.findIndex((object) => object.name === name);

// Where an object is: the points of both sides.
function extentOf(place) {
  const { points } = scene.pair;
  return extent(SIDES.map((side) => at(points[side], ownPlaces(points, side, place))));
}

const chosenBox = () => (scene.chosen === null ? [] : boxEdges(extentOf(placeOf(scene.chosen)), BOX_MARGIN_M));

function wholePair() {
  const { points, ranges } = scene.pair;
  const farthest_m = ["x", "y"].map((axis) =>
    points.real[axis].reduce((most, value) => Math.max(most, Math.abs(value)), 0),
  );
  const eye = { x: -0.75, y: -0.75, z: Math.min(1.1, 0.6 + 20 / Math.max(...farthest_m)) };
  const flatter = Math.cbrt((ranges.z[1] - ranges.z[0]) / 15);
  return { eye: { ...eye, z: eye.z * Math.min(1, flatter) }, center: { x: 0, y: 0, z: -0.1 } };
}

function cameraOn(place) {
  const own = extentOf(place);
  const size_m = Math.hypot(...Object.values(own).map(([low, high]) => high - low));
  return cameraAt(own, scene.pair.ranges, Math.max(6, 1.8 * size_m));
}

// A press and release on one spot chooses the object under it. Plotly's own click event comes once a frame as long as
// the button is down, and not at all for a fast click; its hover event is reliable.
function wireScene() {
  const plot = byId("scene");
  plot.on("plotly_hover", ({ points: [{ data, pointNumber }] }) => {
    const { objects, points, drawn } = scene.pair;
    scene.hovered = drawn[data.name] ? objects[points[data.name].object[drawn[data.name][pointNumber]]].name : null;
  });
  plot.on("plotly_unhover", () => {
    scene.hovered = null;
  });
  plot.dataset.wired = "yes";
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

function setChosen(name) {
  scene.chosen = name;
  byId("object").value = name ?? "";
  byId("panel").hidden = name === null;
  byId("unchosen").hidden = name !== null;
  markRow();
}

// Shows an object, or none, in list, table, address and panel; looksAt: whether the camera goes there too.
function chooseObject(name, looksAt = false, isAsked = true) {
  const { pair } = scene;
  setChosen(name);
  const link = linkWithin(pair.name, name);
  if (isAsked) window.history.replaceState(null, "", link);
  say("asked", "");
  if (name === null) closePanel();
  else {
    drawPanel(pair, placeOf(name), link);
    drawInView("overlay", () => {
      redrawPanel();
      turnTogether(["scene", "overlay"]);
    });
  }
  look(looksAt ? (name === null ? wholePair() : cameraOn(placeOf(name))) : undefined);
}

// Marks the row of the chosen object in the table of objects, if that shows it now.
export function markRow() {
  const [objects, pairs] = ["object", "pair_id"].map((key) =>
    report.objects.columns.findIndex((one) => one.key === key),
  );
  for (const row of byId("objects_table").querySelectorAll("tbody tr")) {
    const [object, pair] = [objects, pairs].map((column) => row.cells[column].textContent);
    const isChosen = object.split(", ")[0] === scene.chosen && pair === shown(scene.pair.name);
    if (isChosen) row.setAttribute("aria-current", "true");
    else row.removeAttribute("aria-current");
  }
}

// Shows the pair and object of the address, #pair=...&object=..., or a note if they do not exist.
export async function showAsked() {
  const asked = new URLSearchParams(window.location.hash.slice(1));
  const [pair, name] = [asked.get("pair"), asked.get("object")];
  if (pair === null) return;
  if (!report.views[pair] && report.links[pair]) {
    window.location.replace(report.links[pair] + window.location.hash);
    return;
  }
  say("asked", "");
  if (!report.views[pair]) {
    const isKnown = report.names.includes(pair);
    refuse(
      isKnown
        ? `Pair ${shorten(pair, 60)} is not among those that this page shows in 3D; fidpipe report with --pairs or --folder shows it.`
        : `This run has no scored pair ${shorten(pair, 60)}.`,
    );
    return;
  }
  if (scene.pair?.name !== pair && !(await openPair(pair))) return;
  byId("view").scrollIntoView();
  if (name === null) {
    chooseObject(null, true);
    byId("pair").focus({ preventScroll: true });
    return;
  }
  const { objects } = scene.pair;
  const found =
    objects.find((object) => object.name === name) ?? objects.find(({ sim_id }) => `sim ${sim_id}` === name);
  if (!found) {
    refuse(
      `Pair ${shorten(pair, 60)} has no object ${shorten(name, 60)}; its objects are called as in the list below.`,
    );
    return;
  }
  chooseObject(found.name, true);
  byId("panel_title").focus({ preventScroll: true });
}

function refuse(text) {
  say("asked", text);
  byId("view").scrollIntoView();
}

function stepObject(step) {
  if (scene.pair === null) return;
  const n = scene.pair.objects.length;
  const now = placeOf(scene.chosen);
  const first = step > 0 ? 0 : n - 1;
  chooseObject(scene.pair.objects[now < 0 ? first : (now + step + n) % n].name, true);
}

export async function startScene() {
  const pairs = Object.keys(report.views);
  if (pairs.length && !("DecompressionStream" in window)) {
    say("asked", "This browser cannot unpack the points: Chrome 80, Firefox 113, Safari 16.4 or a later one can.");
    return;
  }
  // A link to what is shown already is followed all the same.
  document.addEventListener("click", (event) => {
    const link = event.target.closest('a[href^="#pair="]');
    if (link && link.getAttribute("href") === window.location.hash) showAsked();
  });
  window.addEventListener("hashchange", showAsked);
  for (const id of ["quadrants", "polar"])
    byId(id).addEventListener("dot", ({ detail: [pair, name] }) => {
      const link = linkTo(report.names[pair], name);
      if (link !== null) window.location.href = link;
    });
  if (pairs.length) {
    byId("viewer").hidden = false;
    byId("pair").append(...pairs.map((pair) => element("option", shorten(pair, 60), { value: pair, title: pair })));
    byId("pair").addEventListener("change", async () => {
      if (await openPair(byId("pair").value)) chooseObject(null, true);
    });
    byId("object").addEventListener("change", () => chooseObject(byId("object").value || null, true));
    for (const id of ["colour", "show_real", "show_sim", "show_road", "show_missing", "show_invented"])
      byId(id).addEventListener("change", redrawPair);
    byId("previous").addEventListener("click", () => stepObject(-1));
    byId("next").addEventListener("click", () => stepObject(1));
    startPanel();
    const worst = new URLSearchParams(document.querySelector("#worst a")?.getAttribute("href").slice(1));
    await openPair(pairs.includes(worst.get("pair")) ? worst.get("pair") : pairs[0]);
    const first = scene.pair.objects.find(({ name }) => name === worst.get("object"));
    if (first) chooseObject(first.name, true, false);
  }
  await showAsked();
}
