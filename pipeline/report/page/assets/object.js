// The panel of a chosen object: its title, what is wrong with it, its numbers, and which of its points are drawn.

import { byId, report } from "./draw.js";
import { objectTitle, SIDE_WORDS, say } from "./points.js";
import { cellText, counted, element, shorten } from "./tables.js";

const MOST_FIRST = 8;

// pair: {name, view, objects, points}; link: the address of both
export function describe(pair, object, link) {
  say("panel_title", `Pair ${shorten(pair.name, 60)}, ${objectTitle(object)}`);
  byId("object_link").href = link;
  say("panel_sentence", object.sentence);
  const isKnown = (key) => object[key] !== null || !(object.side || key === "reason");
  const facts = report.facts.filter(isKnown).map((key) => factOf(object, key));
  byId("panel_numbers").replaceChildren(...facts.slice(0, MOST_FIRST));
  byId("more_numbers").replaceChildren(...facts.slice(MOST_FIRST));
  for (const id of ["lie", "show_lines"]) byId(id).disabled = !object.move;
}

function factOf(object, key) {
  const column = report.columns[key];
  const value = object[key];
  const text = cellText(value, column);
  const shownValue = element("span", text, { class: "value", "data-key": key, title: value ?? "no value" });
  return element("div", null, {}, element("span", column.title, { class: "name" }), shownValue);
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
