// Puts the tables and the 3D view of a report together.

import { start } from "./draw.js";
import { startScene } from "./scene.js";
import { startTable } from "./tables.js";

for (const place of document.querySelectorAll(".table_place")) startTable(place);
await startScene();
start();
