// Puts the tables, the 3D view and the charts of a report together.

import { byId, drawCharts, report, startCharts } from "./draw.js";
import { openPair, redrawScene, showObject, startScene } from "./scene.js";
import { makeTable } from "./tables.js";

// What a row of a table opens: the 3D view here, or the page of its pair.
function opener(pair, name) {
  const link = report.links[pair];
  if (!report.views[pair]) return link ? (name ? `${link}#${encodeURIComponent(name)}` : link) : null;
  if (name) return () => showObject(pair, name);
  return () => {
    openPair(pair);
    byId("view").scrollIntoView();
    byId("pair").focus({ preventScroll: true });
  };
}

function startTheme() {
  const choice = byId("theme");
  choice.addEventListener("change", () => {
    if (choice.value === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = choice.value;
    drawCharts();
    redrawScene();
  });
}

makeTable(byId("pairs_table"), "pairs", report.pairs, (row) => opener(row.pair_id, null));
makeTable(byId("objects_table"), "objects", report.objects, (row) => opener(row.pair_id, row.object.split(", ")[0]));
startTheme();
startScene();
startCharts(redrawScene);
for (const id of ["quadrants", "polar"]) {
  byId(id).on(
    "plotly_click",
    ({
      points: [
        {
          customdata: [pair, name],
        },
      ],
    }) => showObject(report.names[pair], name),
  );
}
