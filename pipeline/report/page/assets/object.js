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
}

function factOf(object, key) {
  const column = report.columns[key];
  const value = object[key];
  const text = cellText(value, column);
  const shownValue = element("span", text, { class: "value", "data-key": key, title: value ?? "no value" });
  return element("div", null, {}, element("span", column.title, { class: "name" }), shownValue);
}

// places: of the drawn points by side.
export function describePoints(object, places) {
  const all = (side) => object[`n_${side}`];
  const sides = Object.keys(object.owns);
  const parts = sides.map(
    (side) => `${counted(places[side].length)} of ${counted(all(side))} ${SIDE_WORDS[side]} points`,
  );
  const isThinned = sides.some((side) => places[side].length < all(side));
  const nodes = object.side ? "" : ` ${counted(object.n_keep)} nodes a side are kept for the spectral scores.`;
  say("overlay_note", `${parts.join(", ")}${isThinned ? ", thinned for display only" : ""}.${nodes}`);
}
