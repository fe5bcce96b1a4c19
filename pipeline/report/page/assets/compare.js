// The comparison of runs: charts, and the worst changes in 3D, before and after side by side.

import { drawInView, paint, ready, report, startCharts } from "./draw.js";
import { cameraOn, dots, drawInSpace, extent, say, sideColour, turnTogether } from "./points.js";

const MARGIN_M = 0.3;
const WHEN = ["before", "after"];
const setOf = ([x, y, z]) => ({ x, y, z });

// Both views of a place: real points, and the simulated ones of the run.
function drawPlace(section, place) {
  const [real, ...sims] = report.places[section][place];
  const sets = [setOf(real.own), ...sims.flatMap(({ own, others }) => [setOf(own), setOf(others)])];
  const ranges = extent(sets, MARGIN_M);
  const ids = WHEN.map((when) => `${when}_${section}`);
  ids.forEach((id, k) => {
    say(`${id}_words`, `real: ${real.words}; simulated: ${sims[k].words}`);
    const data = [
      dots("other objects", paint("var(--line)"), 1.6, { ...setOf(sims[k].others), hoverinfo: "skip" }),
      dots("real", sideColour("real"), 2.4, setOf(real.own)),
      dots("simulated", sideColour("sim"), 2.4, setOf(sims[k].own)),
    ];
    drawInView(id, () => {
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
startCharts();
ready();
