// The panel of a chosen object: both sides in one box, as given or aligned, its numbers, its spectra.

import { byId, draw, drawInView, paint, report } from "./draw.js";
import {
  at,
  cameraAt,
  decode,
  distanceShades,
  distanceWords,
  dots,
  drawInSpace,
  extent,
  objectTitle,
  ownPlaces,
  plotText,
  rampBar,
  roadDots,
  roadWords,
  SIDE_WORDS,
  SIDES,
  say,
  sideColour,
  strokes,
} from "./points.js";
import { counted, element, NULL_SIGN, number, shorten } from "./tables.js";

const PLACE = "%{x:.2f}, %{y:.2f}, %{z:.2f} m";
const MOST_LINES = 1500;
const MARGIN_M = 0.3;
const MOST_FIRST = 8;
const panel = { key: null, draw: () => {} };

// pair: {name, view, objects, points}; place: of the object among them; link: the address of both
export function drawPanel(pair, place, link) {
  const object = pair.objects[place];
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
  panel.draw = () => drawOverlay(pair, place);
  drawInView("spectrum", () => drawSpectrum(pair, object));
}

export const redrawPanel = () => panel.draw();

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
  if (object.quadrant === "faithful" && least < 0.6)
    words.faithful = "Faithful by CDC and r_lambda, but its surface differs";
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

export function startPanel() {
  for (const id of ["lie", "object_colour", "show_lines", "show_others", "show_road", "show_real", "show_sim"])
    byId(id).addEventListener("change", () => panel.draw());
}

export function closePanel() {
  panel.draw = () => {};
}

// The points of one object of both sides in one box; simulated ones moved onto the real ones if that is chosen.
function drawOverlay(pair, place) {
  const object = pair.objects[place];
  const { points } = pair;
  const isAligned = Boolean(object.move) && byId("lie").value === "aligned";
  const move = isAligned ? object.move : [0, 0, 0];
  byId("show_others").disabled = isAligned; // they are not moved
  const places = Object.fromEntries(SIDES.map((side) => [side, ownPlaces(points, side, place)]));
  const asLies = at(points.sim, places.sim);
  const sets = { real: at(points.real, places.real), sim: shifted(asLies, move) };
  // The box is that of both ways to lie, so that the eye can compare them.
  const box = extent([sets.real, asLies, shifted(asLies, object.move ?? move)]);
  const ranges = Object.fromEntries(
    Object.entries(box).map(([axis, [low, high]]) => [axis, [low - MARGIN_M, high + MARGIN_M]]),
  );
  const data = [];
  for (const side of SIDES) {
    const isShown = byId(`show_${side}`).checked;
    if (isShown && byId("show_road").checked && !(side === "sim" && isAligned))
      data.push(roadDots(side, points.road[side], 1.8, insideOf(points.road[side], ranges)));
    if (isShown && byId("show_others").checked && !isAligned) {
      const others = insideOf(points[side], ranges).filter((i) => points[side].object[i] !== place);
      const text = others.map((i) => plotText(objectTitle(pair.objects[points[side].object[i]])));
      const hovertemplate = `other object, ${SIDE_WORDS[side]}: %{text}<extra></extra>`;
      data.push(
        dots(`others ${side}`, sideColour(side), 1.6, {
          ...at(points[side], others),
          text,
          hovertemplate,
          opacity: 0.3,
        }),
      );
    }
    if (isShown) data.push(...ownDots(pair, side, places[side], sets[side], isAligned));
  }
  const lines = object.move && byId("show_lines").checked ? linesOf(points, places) : [];
  if (lines.length) data.push(strokes("lines", paint("var(--soft)"), lineEnds(points, lines, move), 1.5));
  const size_m = Math.hypot(...Object.values(ranges).map(([low, high]) => high - low));
  const key = `${pair.name} ${object.name}`;
  const before = panel.key === key ? byId("overlay").layout?.scene?.camera : null;
  panel.key = key;
  const { offsetWidth, offsetHeight } = byId("overlay");
  const farther = Math.max(1.25, (1.3 * offsetHeight) / offsetWidth); // where the window is narrow
  drawInSpace("overlay", data, before ?? cameraAt(ranges, ranges, farther * size_m), ranges);
  sayOverlay(object, places, lines, isAligned);
}

const shifted = (set, move) =>
  Object.fromEntries(["x", "y", "z"].map((axis, k) => [axis, set[axis].map((value) => value + move[k])]));

function insideOf({ x, y, z }, ranges) {
  const inside = [];
  const holds = ([low, high], value) => low <= value && value <= high;
  for (let i = 0; i < x.length; i += 1)
    if (holds(ranges.x, x[i]) && holds(ranges.y, y[i]) && holds(ranges.z, z[i])) inside.push(i);
  return inside;
}

// The object's own points of a side, coloured as chosen.
function ownDots({ points }, side, places, set, isAligned) {
  const by = byId("object_colour").value;
  const { kept, distance, aligned } = points[side];
  if (by === "kept") {
    const trace = (name, isKept, color, size, symbol) => {
      const some = places.flatMap((i, k) => (Boolean(kept[i]) === isKept ? [k] : []));
      return dots(name, color, size, { ...at(set, some), symbol, hovertemplate: `${name}: ${PLACE}<extra></extra>` });
    };
    return [
      trace(`left out, ${SIDE_WORDS[side]}`, false, paint("var(--soft)"), 3.4, "cross"),
      trace(`kept, ${SIDE_WORDS[side]}`, true, sideColour(side), 2.8, "circle"),
    ];
  }
  const steps = isAligned ? aligned : distance;
  const shades = by === "distance" ? distanceShades() : null;
  const color = shades ? places.map((i) => shades[steps[i]]) : sideColour(side);
  const text = places.map((i) => distanceWords(steps[i]));
  const symbol = by === "distance" && side === "sim" ? "diamond" : "circle";
  const hovertemplate = `${SIDE_WORDS[side]}: ${PLACE}<br>%{text} to the other side<extra></extra>`;
  return [dots(`own ${side}`, color, symbol === "diamond" ? 3.2 : 2.2, { ...set, text, symbol, hovertemplate })];
}

// Which lines of alignment are drawn: those of the object, evenly if there are many; `n` of how many.
function linesOf({ lines, real }, places) {
  const [from, to] = [places.real[0], places.real.at(-1)];
  const own = [];
  for (let i = 0; i < lines.real.length; i += 1)
    if (lines.real[i] >= from && lines.real[i] <= to && real.object[lines.real[i]] === real.object[from]) own.push(i);
  const every = Math.ceil(own.length / MOST_LINES);
  return Object.assign(
    own.filter((_, k) => k % every === 0),
    { n: own.length },
  );
}

function lineEnds({ lines, real, sim }, chosen, move) {
  const end = ({ x, y, z }, i, [dx, dy, dz]) => ({ x: x[i] + dx, y: y[i] + dy, z: z[i] + dz });
  return chosen.flatMap((i) => [end(real, lines.real[i], [0, 0, 0]), end(sim, lines.sim[i], move)]);
}

function sayOverlay(object, places, lines, isAligned) {
  const sides = Object.keys(object.owns);
  const all = (side) => (object.side ? object.n_points : object[`n_${side}`]);
  const parts = sides.map(
    (side) => `${counted(places[side].length)} of ${counted(all(side))} ${SIDE_WORDS[side]} points`,
  );
  const isThinned = sides.some((side) => places[side].length < all(side));
  const notes = [`${parts.join(", ")}${isThinned ? ", thinned for display only" : ""}.`];
  if (object.side) {
    const road = roadWords(object);
    notes.push(
      `Unmatched: no counterpart, no score.${road ? ` ${road[0].toUpperCase()}${road.slice(1)}: below the ground cut there.` : ""}`,
    );
  } else {
    notes.push(`${counted(object.n_keep)} nodes a side are kept for the spectral scores.`);
  }
  if (lines.length) notes.push(`${counted(lines.length)} of ${counted(lines.n)} alignment lines.`);
  if (object.move) {
    const [x, y, z] = object.move.map((value) => value.toFixed(2));
    const far = Math.hypot(...object.move).toFixed(2);
    notes.push(
      isAligned
        ? `Aligned: simulated points moved by (${x}, ${y}, ${z}) m, so that the kept nodes of both sides have one mean, as ` +
            "node alignment and its RMS use; without rotation. CDC uses the points as given."
        : `As given, in the frame of the real sensor, as CDC uses them; aligned moves simulated ones by ${far} m.`,
    );
  }
  say("overlay_note", notes.join(" "));
  drawOverlayLegend(isAligned);
}

function drawOverlayLegend(isAligned) {
  const by = byId("object_colour").value;
  const entry = (colour, text, sign = "") =>
    element("span", null, {}, element("i", sign, sign ? { class: "sign" } : { style: `background: ${colour}` }), text);
  const entries = SIDES.map((side) => entry(sideColour(side), SIDE_WORDS[side]));
  if (by === "kept") entries.push(entry(null, "left out of the spectra", "+"));
  if (by === "distance") {
    const end = isAligned ? "to the partner, aligned" : "to the other side";
    const bars = element("span", null, {}, "0", rampBar(), `${report.far_m} m or more ${end}`);
    entries.splice(0, 2, bars, entry(null, "real", "●"), entry(null, "simulated", "◆"));
  }
  byId("overlay_legend").replaceChildren(...entries);
}

function drawSpectrum(pair, object) {
  const noCurve = { reason: "An unmatched object has no counterpart to compare spectra with" };
  const spectrum = object.side ? noCurve : pair.view.spectra[object.real_id];
  byId("spectrum").hidden = Boolean(spectrum.reason);
  if (spectrum.reason) {
    say("spectrum_note", `Spectra: ${spectrum.reason}.`);
    return;
  }
  const x = decode(spectrum.index, Int32Array);
  const curves = SIDES.map((side) => decode(spectrum[side], Float32Array));
  const data = curves.map((y, k) => ({
    mode: "lines",
    name: SIDE_WORDS[SIDES[k]],
    x,
    y,
    line: { color: sideColour(SIDES[k]), width: 2, dash: ["solid", "dash"][k] },
    hovertemplate: "eigenvalue %{x}: %{y:.3f}<extra></extra>",
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
    number(object[key], 3),
  );
  say(
    "spectrum_note",
    `Spectra of the reduced Laplacians, ${counted(spectrum.n)} eigenvalues per side${part}. ` +
      `r_lambda is the marked shift over the Laplacian change: ${above} / ${below} = ${ratio}.`,
  );
}
