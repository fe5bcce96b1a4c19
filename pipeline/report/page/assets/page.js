// Puts the tables, the 3D view and the charts of a report together.

import { byId, drawCharts, report, startCharts } from "./draw.js";
import { linkTo, markRow, redrawScene, startScene } from "./scene.js";
import { makeTable } from "./tables.js";

function startTheme() {
  const choice = byId("theme");
  choice.addEventListener("change", () => {
    if (choice.value === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = choice.value;
    drawCharts();
    redrawScene();
  });
}

makeTable(byId("pairs_table"), "pairs", report.pairs, (row) => linkTo(row.pair_id, null));
makeTable(byId("objects_table"), "objects", report.objects, (row) => linkTo(row.pair_id, row.object.split(", ")[0]));
for (const change of ["click", "input"]) byId("objects_table").addEventListener(change, markRow);
startTheme();
await startCharts(redrawScene);
for (const id of ["quadrants", "polar"]) {
  byId(id).on(
    "plotly_click",
    ({
      points: [
        {
          customdata: [pair, name],
        },
      ],
    }) => {
      const link = linkTo(report.names[pair], name);
      if (link !== null) window.location.href = link;
    },
  );
}
await startScene();
