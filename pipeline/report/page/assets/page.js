// Puts the tables, the 3D view and the charts of a report together.

import { byId, ready, report, startCharts } from "./draw.js";
import { linkTo, startScene } from "./scene.js";
import { startTable } from "./tables.js";

startTable(byId("pairs_table"), "pairs", report.pairs, (row) => linkTo(row.pair_id, null));
startTable(byId("objects_table"), "objects", report.objects, (row) => linkTo(row.pair_id, row.object.split(", ")[0]));
startCharts();
await startScene();
ready();
