// The panel of a chosen object: its title, what is wrong with it, its numbers, and which of its points are drawn.

import { byId } from "./draw.js";
import { objectTitle, SIDE_WORDS, say } from "./points.js";
import { counted, element, shorten } from "./tables.js";

// pair: {name, view, objects, points}; link: the address of both
export function describe(pair, object, link) {
  say("panel_title", `Pair ${shorten(pair.name, 60)}, ${objectTitle(object)}`);
  byId("object_link").href = link;
  say("panel_sentence", object.sentence);
  const facts = object.facts.map(([name, value]) =>
    element("div", null, {}, element("span", name, { class: "name" }), element("span", value, { class: "value" })),
  );
  byId("panel_numbers").replaceChildren(...facts);
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
