// The panel of a chosen object: its title, what is wrong with it, its numbers, and which of its points are drawn.

import { byId, report } from "./draw.js";
import { objectTitle, roadWords, SIDE_WORDS, say } from "./points.js";
import { counted, element, NULL_SIGN, number, shorten } from "./tables.js";

const MOST_FIRST = 8;

// pair: {name, view, objects, points}; link: the address of both
export function describe(pair, object, link) {
  say("panel_title", `Pair ${shorten(pair.name, 60)}, ${objectTitle(object)}`);
  byId("object_link").href = link;
  say("panel_sentence", judged(object));
  const isKnown = (key) => object[key] !== null || !(object.side || key === "reason");
  const facts = report.facts.filter(isKnown).map((key) => factOf(object, key));
  byId("panel_numbers").replaceChildren(...facts.slice(0, MOST_FIRST));
  byId("more_numbers").replaceChildren(...facts.slice(MOST_FIRST));
  for (const id of ["lie", "show_lines"]) byId(id).disabled = !object.move;
}

function factOf(object, key) {
  const { title, digits } = report.columns[key];
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

// places: of the drawn points by side; isAligned: simulated ones are moved onto the real ones.
export function describePoints(object, places, isAligned) {
  const all = (side) => object[`n_${side}`];
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
        "node alignment uses; without rotation. CDC and all distances are those of the points as given.",
    );
  }
  say("overlay_note", notes.join(" "));
}
