// The page of a report: theme, charts, table and replay.
import { startCharts } from "./charts.js";
import { startReplay } from "./replay.js";
import { select } from "./selection.js";
import { startLinks, startTable } from "./table.js";
import { startTheme } from "./theme.js";
import { block } from "./unpack.js";

const scene = block("replay");
const replayed = new Set(scene ? scene.envs.map(({ env }) => env) : []);
let replay = null;

window.warpcontact = { state: () => replay?.state() ?? null, ready: false };

startTheme();
startCharts();
startTable(replayed);
startLinks(replayed);
if (scene) {
  startReplay(scene).then((started) => {
    replay = started;
    if (!replay) select("env", scene.envs[0].env);
    window.warpcontact.ready = true;
  });
} else window.warpcontact.ready = true;
