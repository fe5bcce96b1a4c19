// The 3D view of a pair: its points, the road, the sensor, which object is chosen, and the address of that object.

import { byId, draw, drawInView, paint, report } from "./draw.js";
import { describe, describePoints } from "./object.js";
import {
  at,
  boxEdges,
  cameraOn,
  colouring,
  dots,
  drawInSpace,
  extent,
  FAR,
  objectsOf,
  objectTitle,
  ownPlaces,
  plotText,
  pointsOf,
  roadDots,
  SIDE_WORDS,
  SIDES,
  say,
  sideColour,
  signedMetres,
  strokes,
  swatch,
  turnTogether,
} from "./points.js";
import { counted, element, number, shorten } from "./tables.js";

const MOST_DRAWN = 9000; // of a side in the whole pair, and of each object at least FEWEST_DRAWN; the panel has all
const FEWEST_DRAWN = 80;
const BOX_MARGIN_M = 0.2;
const PANEL_MARGIN_M = 0.3;
const AROUND_M = 1.5;
const SENSOR_AXIS_M = 4;
// pair: {name, view, objects, points, drawn, ranges}, the open one; opening: the name of the one being opened
const scene = { pair: null, opening: null, chosen: null, hovered: null };

// The address of a pair, or of an object, within the page that shows it.
const linkWithin = (pair, name) =>
  `#pair=${encodeURIComponent(pair)}${name ? `&object=${encodeURIComponent(name)}` : ""}`;

// Pairs that the page shows in 3D, worst first. A name may be any, also that of a property of all objects.
const pairs = report.names.filter((name) => Object.hasOwn(report.views, name));

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
  const thinned = "thinned for display only; all scores are of all points";
  say("scene_note", `Shown: ${parts.join(", ")}, ${thinned}. A click on a point shows its object below.`);
  setChosen(null);
  drawInView("signed", drawSigned);
  look(wholePair);
  return true;
}

// Draws the pair when it is in view. camera: a function that is called then, when the scene has its full height; by
// default the camera that its user has turned.
function look(camera) {
  scene.camera = camera ?? scene.camera;
  drawInView("scene", () => {
    drawScene(scene.camera?.() ?? byId("scene").layout?.scene.camera);
    if (!byId("scene").dataset.wired) wireScene();
    scene.camera = null;
  });
}

// How far the simulated points are in front of the real planes next to them, and behind.
function drawSigned() {
  const { points } = scene.pair;
  const { signed_m: most } = report;
  const said = [];
  const data = Object.entries({ road: points.road.sim.signed, objects: points.sim.signed }).map(([name, steps]) => {
    const known = steps.filter((step) => step !== FAR);
    const x = Array.from(known, signedMetres).sort((a, b) => a - b);
    const middle = x[Math.floor(x.length / 2)];
    if (x.length)
      said.push(
        `${name}: median ${number(Math.abs(100 * middle), 1)} cm ${middle < 0 ? "behind" : "in front"}, ` +
          `${Math.round((100 * x.length) / steps.length)} % of the points have a real plane within ${most} m`,
      );
    const marker = { color: name === "road" ? paint("var(--soft)") : sideColour("sim") };
    const xbins = { start: -most, end: 1.04 * most, size: 0.04 * most };
    return { type: "histogram", histnorm: "percent", name, x, xbins, opacity: 0.6, marker };
  });
  const line = { type: "line", x0: 0, x1: 0, y0: 0, y1: 1, yref: "paper", line: { width: 1, dash: "dash" } };
  const xaxis = { title: { text: "simulated behind (−) or in front of (+)<br>the real surface (m)" } };
  draw("signed", { data, layout: { xaxis, yaxis: { title: { text: "%" } }, shapes: [line], barmode: "overlay" } });
  const words = said.length ? `${said.join("; ")}.` : "no simulated point has a real plane next to it.";
  say("signed_note", `Signed distance of the simulated points to the real planes next to them: ${words}`);
}

// Every Nth point of each object, so that about MOST_DRAWN remain.
function drawnOf({ object, ranges }) {
  const every = Math.ceil(object.length / MOST_DRAWN);
  return [...ranges.values()].flatMap(([from, to]) => {
    const step = Math.max(1, Math.min(every, (to - from) / FEWEST_DRAWN));
    return Array.from({ length: Math.ceil((to - from) / step) }, (_, k) => Math.floor(from + k * step));
  });
}

// The points of the pieces that only one side has, on top of all others.
const PIECES = { real: "missing", sim: "invented" };
function pieceTraces({ points }) {
  return SIDES.map((side) => {
    const places = [...points[side].piece.keys()].filter((i) => points[side].piece[i]);
    const visible = byId(`show_${PIECES[side]}`).checked;
    return dots(PIECES[side], sideColour(side), 3, { ...at(points[side], places), visible, hoverinfo: "skip" });
  });
}

function contextTraces({ points }, shades) {
  const road = SIDES.map((side) => ({
    ...roadDots(side, points.road[side], null, shades),
    visible: byId("show_road").checked && byId(`show_${side}`).checked,
  }));
  const ink = paint("var(--ink)");
  const box = scene.chosen === null ? [] : boxEdges(extentOf(placeOf(scene.chosen), BOX_MARGIN_M));
  const ends = [0, SENSOR_AXIS_M].map((x) => ({ x, y: 0, z: 0 }));
  const mark = dots("sensor", ink, 5, { x: [0], y: [0], z: [0], symbol: "square", text: ["sensor"] });
  const text = { mode: "markers+text", textposition: "top center", textfont: { color: ink, size: 13 } };
  const sensor = { ...mark, ...text, hovertemplate: "sensor; the line points ahead<extra></extra>" };
  return [strokes("chosen", ink, box, 4), ...road, strokes("forward", ink, ends, 5), sensor];
}

function drawScene(camera) {
  const { pair } = scene;
  const shades = colouring(pair, byId("colour").value);
  const titles = pair.objects.map((object) => plotText(objectTitle(object)));
  const traces = SIDES.map((side) => {
    const [own, places] = [pair.points[side], pair.drawn[side]];
    const words = (i) => [titles[own.object[i]], shades.words?.(side, i)].filter(Boolean).join("<br>");
    return dots(side, shades.colours(side, places), shades.faint === side ? 1 : 1.8, {
      opacity: shades.faint === side ? 0.4 : 1,
      ...at(own, places),
      visible: byId(`show_${side}`).checked,
      text: places.map(words),
      customdata: places.map((i) => pair.objects[own.object[i]].name),
      hovertemplate: `${SIDE_WORDS[side]}: %{text}<extra></extra>`,
    });
  });
  traces.push(...pieceTraces(pair), ...contextTraces(pair, shades));
  const modeBarButtons = [["toImage", "zoom3d", "pan3d", "orbitRotation", "resetCameraDefault3d"]];
  drawInSpace("scene", traces, camera, pair.ranges, { displayModeBar: true, modeBarButtons });
  const road = byId("show_road").checked ? [swatch("var(--line)", "road (removed as ground), thinned")] : [];
  byId("legend").replaceChildren(...shades.legend, "Large dots: missing and invented pieces.", ...road);
}

function redrawPair() {
  if (scene.pair === null) return;
  look(undefined);
  showPanel(false);
}

// The points of one object of both sides in one box, coloured as the scene.
// isNew: seen from the side of the sensor, else by the camera of now.
function drawObject({ objects, points }, place, isNew) {
  const by = byId("colour").value;
  const shades = colouring({ objects, points }, by);
  const places = Object.fromEntries(SIDES.map((side) => [side, ownPlaces(points, side, place)]));
  const ranges = extentOf(place, PANEL_MARGIN_M);
  const data = [];
  for (const side of SIDES.filter((one) => byId(`show_${one}`).checked)) {
    const others = insideOf(points[side], ranges).filter((i) => points[side].object[i] !== place);
    const faint = { ...at(points[side], others), hoverinfo: "skip", opacity: 0.3 };
    data.push(dots(`others ${side}`, sideColour(side), 1.6, faint));
    const road = points.road[side];
    if (byId("show_road").checked) data.push(roadDots(side, road, insideOf(road, ranges), shades));
    const hovertemplate = `${SIDE_WORDS[side]}: %{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>`;
    const [symbol, size] = by !== "side" && side === "sim" ? ["diamond", 3.2] : ["circle", 2.2];
    const look = { ...at(points[side], places[side]), hovertemplate, symbol };
    data.push(dots(`own ${side}`, shades.colours(side, places[side]), size, look));
  }
  const camera = (!isNew && byId("overlay").layout?.scene?.camera) || cameraOn("overlay", ranges, ranges);
  drawInSpace("overlay", data, camera, ranges);
  describePoints(objects[place], places);
}

function insideOf({ x, y, z }, ranges) {
  const holds = ([low, high], value) => low <= value && value <= high;
  const inside = [];
  for (let i = 0; i < x.length; i += 1)
    if (holds(ranges.x, x[i]) && holds(ranges.y, y[i]) && holds(ranges.z, z[i])) inside.push(i);
  return inside;
}

// Draws the chosen object when the panel is in view, from the side of the sensor if it is new there.
function showPanel(isNew) {
  let looksAnew = isNew;
  drawInView("overlay", () => {
    if (scene.chosen === null) return;
    drawObject(scene.pair, placeOf(scene.chosen), looksAnew);
    looksAnew = false;
    turnTogether(["scene", "overlay"]);
  });
}

const placeOf = (name) => scene.pair.objects.findIndex((object) => object.name === name);

// Where an object is: the points of both sides.
function extentOf(place, margin_m) {
  const { points } = scene.pair;
  return extent(
    SIDES.map((side) => at(points[side], ownPlaces(points, side, place))),
    margin_m,
  );
}

const wholePair = () => cameraOn("scene", scene.pair.ranges, scene.pair.ranges);
const objectInPair = (place) => cameraOn("scene", extentOf(place, AROUND_M), scene.pair.ranges);

// A press and release on one spot chooses the object under it. Plotly's own click event comes once a frame as long as
// the button is down, and not at all for a fast click; its hover event is reliable.
function wireScene() {
  const plot = byId("scene");
  plot.dataset.wired = "yes";
  const hover = (name) => {
    scene.hovered = name ?? null;
  };
  plot.on("plotly_hover", ({ points: [{ customdata }] }) => hover(customdata));
  plot.on("plotly_unhover", () => hover(null));
  const choose = () => scene.hovered !== null && chooseObject(scene.hovered);
  const press = (down) => {
    const release = (up) => {
      // A finger has not hovered before: the object under it is known a moment later.
      if (Math.hypot(up.clientX - down.clientX, up.clientY - down.clientY) < 5)
        setTimeout(choose, up.pointerType === "mouse" ? 0 : 250);
    };
    plot.addEventListener("pointerup", release, { capture: true, once: true });
  };
  plot.addEventListener("pointerdown", press, true);
}

function setChosen(name) {
  scene.chosen = name;
  byId("object").value = name ?? "";
  byId("panel").hidden = name === null;
}

// Shows an object, or none, in list, table, address and panel; looksAt: whether the camera goes there too.
function chooseObject(name, looksAt = false, isAsked = true) {
  const { pair } = scene;
  setChosen(name);
  const link = linkWithin(pair.name, name);
  if (isAsked) window.history.replaceState(null, "", link);
  say("asked", "");
  if (name !== null) {
    describe(pair, pair.objects[placeOf(name)], link);
    showPanel(true);
  }
  look(looksAt ? (name === null ? wholePair : () => objectInPair(placeOf(name))) : undefined);
}

// Shows the pair and object of the address, #pair=...&object=..., or a note if they do not exist.
export async function showAsked() {
  const asked = new URLSearchParams(window.location.hash.slice(1));
  const [pair, name] = [asked.get("pair"), asked.get("object")];
  if (pair === null) return;
  byId("view").scrollIntoView();
  if (!pairs.includes(pair)) {
    const elsewhere = " is not among those that this page shows in 3D; fidpipe report with --pairs shows it.";
    const isKnown = report.names.includes(pair);
    say(
      "asked",
      `${isKnown ? "Pair" : "This run has no scored pair"} ${shorten(pair, 60)}${isKnown ? elsewhere : "."}`,
    );
    return;
  }
  if (scene.pair?.name !== pair && !(await openPair(pair))) return;
  const { objects } = scene.pair;
  const found =
    objects.find((object) => object.name === name) ?? objects.find(({ sim_id }) => `sim ${sim_id}` === name);
  if (name !== null && !found) {
    say(
      "asked",
      `Pair ${shorten(pair, 60)} has no object ${shorten(name, 60)}; its objects are called as in the list below.`,
    );
    return;
  }
  chooseObject(found?.name ?? null, true);
  byId(found ? "panel_title" : "pair").focus({ preventScroll: true });
}

function stepObject(step) {
  if (scene.pair === null) return;
  const n = scene.pair.objects.length;
  const now = placeOf(scene.chosen);
  const first = step > 0 ? 0 : n - 1;
  chooseObject(scene.pair.objects[now < 0 ? first : (now + step + n) % n].name, true);
}

export async function startScene() {
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
    const worst = new URLSearchParams(document.querySelector("#worst a")?.getAttribute("href").slice(1));
    await openPair(pairs.includes(worst.get("pair")) ? worst.get("pair") : pairs[0]);
    const first = scene.pair.objects.find(({ name }) => name === worst.get("object"));
    if (first) chooseObject(first.name, true, false);
  }
  await showAsked();
}
