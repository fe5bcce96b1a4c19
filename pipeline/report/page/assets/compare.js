// The comparison of runs: charts, and the worst changes in 3D, before and after side by side.

import { drawInView, paint, ready, report, startCharts } from "./draw.js";
import { cameraAt, dots, drawInSpace, extent, sideColour, sizeOf, turnTogether } from "./points.js";

const MARGIN_M = 0.3;
const WHEN = ["before", "after"];
const setOf = ([x, y, z]) => ({ x, y, z });

// Both views of a place: real points, and the simulated ones of the run.
function drawPlace(section, place) {
  const [real, ...sims] = report.places[section][place];
  const sets = [real, ...sims].flatMap((layers) => Object.values(layers).map(setOf));
  const ranges = extent(sets, MARGIN_M);
  const ids = WHEN.map((when) => `${when}_${section}`);
  ids.forEach((id, k) => {
    const data = [
      dots("other objects", paint("var(--line)"), 1.6, { ...setOf(sims[k].others), hoverinfo: "skip" }),
      dots("real", sideColour("real"), 2.4, setOf(real.real)),
      dots("simulated", sideColour("sim"), 2.4, setOf(sims[k].sim)),
    ];
    drawInView(id, () => {
      drawInSpace(id, data, cameraAt(ranges, ranges, 1.1 * sizeOf(ranges)), ranges);
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
