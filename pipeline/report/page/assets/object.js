// The panel of a chosen object: what is wrong with it, its numbers, and both sides in one box, as given or aligned.

import { byId, paint, report } from "./draw.js";
import {
  at,
  cameraAt,
  colouring,
  distanceWords,
  dots,
  drawInSpace,
  extent,
  objectTitle,
  ownPlaces,
  plotText,
  roadDots,
  roadWords,
  SIDE_WORDS,
  SIDES,
  say,
  sideColour,
  sizeOf,
  strokes,
  xyz,
} from "./points.js";
import { counted, element, NULL_SIGN, number, shorten } from "./tables.js";

const MARGIN_M = 0.3;
const MOST_FIRST = 8;

// pair: {name, view, objects, points}; link: the address of both
export function describe(pair, object, link) {
  say("panel_title", `Pair ${shorten(pair.name, 60)}, ${objectTitle(object)}`);
  byId("object_link").href = link;
  say("panel_sentence", judged(object));
  const isKnown = (key) => key in object && (object[key] !== null || !(object.side || key === "reason"));
  const known = Object.keys(report.facts).filter(isKnown);
  const first = report.first_facts.filter((key) => known.includes(key)).slice(0, MOST_FIRST);
  byId("panel_numbers").replaceChildren(...first.map((key) => factOf(object, key)));
  const rest = known.filter((key) => !first.includes(key));
  byId("more_numbers").replaceChildren(...rest.map((key) => factOf(object, key)));
  for (const id of ["lie", "show_lines"]) byId(id).disabled = !object.move;
}

function factOf(object, key) {
  const { title, digits } = report.facts[key];
  const value = object[key];
  const text = typeof value === "number" ? number(value, digits) : (value ?? NULL_SIGN);
  const shownValue = element("span", text, { class: "value", "data-key": key, title: value ?? "no value" });
  return element("div", null, {}, element("span", title, { class: "name" }), shownValue);
}

// What is wrong with an object, as a sentence.
function judged(object) {
  const percent = (value) => `${Math.round(100 * value)} %`;
  if (object.side) {
    const covered = object[`covered_${object.side}_0p3m`];
    const verdict = object.side === "real" ? "Missing in the simulation" : "Invented by the simulation";
    const road = roadWords(object);
    return `${verdict}: ${percent(covered)} of its points have one of the other side within 0.3 m${road ? `; ${road}` : ""}.`;
  }
  const words = {
    faithful: "Faithful",
    "structure lost": `Structure lost (r_lambda ${number(object.r_lambda, 2)}), shape right`,
    displaced: `Displaced or misshapen (CDC ${number(object.cdc, 2)}), structure right`,
    failed: `Shape and structure differ (CDC ${number(object.cdc, 2)}, r_lambda ${number(object.r_lambda, 2)})`,
  };
  const least = Math.min(object.covered_real_0p3m, object.covered_sim_0p3m);
  if (least < 0.6) words.faithful = "Faithful by CDC and r_lambda, but its surface differs";
  const judgement = words[object.quadrant] ?? `Without a spectral score (${object.reason ?? object.status})`;
  const [real, sim] = [object.covered_real_0p3m, object.covered_sim_0p3m].map(percent);
  const unsure =
    object.alignment_rms_m > 1
      ? ` Its r_lambda is unreliable: the nodes were aligned ${number(object.alignment_rms_m, 1)} m apart.`
      : "";
  return (
    `${judgement}: ${real} of the real surface is simulated within 0.3 m, ${sim} of the simulated one is real; ` +
    `centroids ${number(object.centroid_distance_m, 2)} m apart.${unsure}`
  );
}

// The points of one object of both sides in one box, coloured as the scene; simulated ones moved onto the real ones if
// that is chosen. isNew: seen from the side of the sensor, else by the camera of now.
export function drawOverlay({ objects, points }, place, isNew) {
  const object = objects[place];
  const isAligned = Boolean(object.move) && byId("lie").value === "aligned";
  const by = byId("colour").value;
  const shades = colouring({ objects, points }, by, isAligned);
  const places = Object.fromEntries(SIDES.map((side) => [side, ownPlaces(points, side, place)]));
  const moved = (set, move = [0, 0, 0]) => xyz((axis) => set[axis].map((value) => value + move["xyz".indexOf(axis)]));
  const given = at(points.sim, places.sim);
  const sets = { real: at(points.real, places.real), sim: isAligned ? moved(given, object.move) : given };
  // The box is that of both ways to lie, so that the eye can compare them.
  const ranges = extent([sets.real, given, moved(given, object.move)], MARGIN_M);
  const data = [];
  for (const side of SIDES.filter((one) => byId(`show_${one}`).checked)) {
    if (!(isAligned && side === "sim")) {
      const others = insideOf(points[side], ranges).filter((i) => points[side].object[i] !== place);
      const text = others.map((i) => plotText(objectTitle(objects[points[side].object[i]])));
      const hovertemplate = `other object, ${SIDE_WORDS[side]}: %{text}<extra></extra>`;
      const look = { ...at(points[side], others), text, hovertemplate, opacity: 0.3 };
      data.push(dots(`others ${side}`, sideColour(side), 1.6, look));
      const road = points.road[side];
      if (byId("show_road").checked) data.push(roadDots(side, road, insideOf(road, ranges), shades));
    }
    const steps = points[side][isAligned ? "aligned" : "distance"];
    const text = places[side].map((i) => distanceWords(steps[i]));
    const hovertemplate = `${SIDE_WORDS[side]}: %{x:.2f}, %{y:.2f}, %{z:.2f} m<br>%{text} to the other side<extra></extra>`;
    const [symbol, size] = by !== "side" && side === "sim" ? ["diamond", 3.2] : ["circle", 2.2];
    const look = { ...sets[side], text, hovertemplate, symbol };
    data.push(dots(`own ${side}`, shades.colours(side, places[side]), size, look));
  }
  if (object.move && byId("show_lines").checked) {
    const own = [...points.lines.real.keys()].filter((k) => points.real.object[points.lines.real[k]] === place);
    const [from, to] = SIDES.map((side) =>
      at(
        points[side],
        Array.from(own, (k) => points.lines[side][k]),
      ),
    );
    const ends = [from, isAligned ? moved(to, object.move) : to];
    const lines = own.flatMap((_, k) => ends.map((end) => xyz((axis) => end[axis][k])));
    data.push(strokes("lines", paint("var(--soft)"), lines, 1.5));
  }
  const { layout, offsetWidth, offsetHeight } = byId("overlay");
  const farther = Math.max(1.25, (1.3 * offsetHeight) / offsetWidth); // where the window is narrow
  const camera = (!isNew && layout?.scene?.camera) || cameraAt(ranges, ranges, farther * sizeOf(ranges));
  drawInSpace("overlay", data, camera, ranges);
  sayOverlay(object, places, isAligned);
}

function insideOf({ x, y, z }, ranges) {
  const holds = ([low, high], value) => low <= value && value <= high;
  const inside = [];
  for (let i = 0; i < x.length; i += 1)
    if (holds(ranges.x, x[i]) && holds(ranges.y, y[i]) && holds(ranges.z, z[i])) inside.push(i);
  return inside;
}

function sayOverlay(object, places, isAligned) {
  const all = (side) => (object.side ? object.n_points : object[`n_${side}`]);
  const sides = Object.keys(object.owns);
  const parts = sides.map(
    (side) => `${counted(places[side].length)} of ${counted(all(side))} ${SIDE_WORDS[side]} points`,
  );
  const isThinned = sides.some((side) => places[side].length < all(side));
  const notes = [`${parts.join(", ")}${isThinned ? ", thinned for display only" : ""}.`];
  if (!object.side) notes.push(`${counted(object.n_keep)} nodes a side are kept for the spectral scores.`);
  if (isAligned) {
    const move = object.move.map((value) => value.toFixed(2)).join(", ");
    notes.push(
      `Aligned: simulated points moved by (${move}) m, so that the kept nodes of both sides have one mean, as ` +
        "node alignment uses; without rotation. CDC uses the points as given. Distances are to the moved partner.",
    );
  }
  say("overlay_note", notes.join(" "));
}
