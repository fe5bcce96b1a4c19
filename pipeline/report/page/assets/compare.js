// The comparison of runs: places in 3D, before and after side by side, coloured by the signed distance to the real side.

import { byId, drawInView, paint, report, start } from "./draw.js";
import { cameraOn, dots, drawInSpace, extent, say, signedColour, signedLegend, turnTogether } from "./points.js";

const MARGIN_M = 0.3;
const setOf = ([x, y, z]) => ({ x, y, z });

// Both views of a place: real points, and the simulated ones of each run.
function drawPlace(section, place) {
  const { real, sims } = report.places[section][place];
  const ranges = extent([setOf(real), ...sims.map(({ points }) => setOf(points))], MARGIN_M);
  const ids = ["before", "after"].map((when) => `${when}_${section}`);
  byId(`legend_${section}`).replaceChildren(...signedLegend());
  ids.forEach((id, k) => {
    const { words, points, signed_m } = sims[k];
    say(`${id}_words`, words);
    drawInView(id, () => {
      const text = signed_m.map((metres) => (metres === null ? "no real plane next to it" : `${metres} m`));
      const look = { ...setOf(points), text, hovertemplate: "%{text}<extra></extra>" };
      const data = [
        dots("real", paint("var(--line)"), 1.8, { ...setOf(real), hoverinfo: "skip" }),
        dots("simulated", signed_m.map(signedColour), 2.6, look),
      ];
      drawInSpace(id, data, cameraOn(id, ranges, ranges), ranges);
      turnTogether(ids);
    });
  });
}

for (const choice of document.querySelectorAll("select.place")) {
  const { section } = choice.dataset;
  choice.addEventListener("change", () => drawPlace(section, choice.value));
  drawPlace(section, 0);
}
start();
