// The page of a report: theme, charts, table and replay.
import { startCharts } from "./charts.js";
import { startReplay, tell } from "./replay.js";
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
  const done = (started) => {
    replay = started;
    if (!replay) select("env", scene.envs[0].env);
    window.warpcontact.ready = true;
  };
  startReplay(scene).then(done, (error) => {
    tell(`The replay cannot be shown: ${error.message}`);
    done(null);
  });
} else window.warpcontact.ready = true;
