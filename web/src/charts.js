// Draws the chosen environment and time into the charts, which are there without any script.
import { follow } from "./selection.js";
import { block } from "./unpack.js";

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 50;
const RIGHT = 348;
const TOP = 10;
const FLOOR = 164;

export function startCharts() {
  const data = block("series") || [];
  const charts = [...document.querySelectorAll("svg[data-series]")].map((svg, i) => seriesChart(svg, data[i]));
  follow("env", (env) => {
    for (const chart of charts) chart.showEnv(env);
    for (const loop of document.querySelectorAll("svg[data-loops] [data-env]")) {
      loop.classList.toggle("chosen", loop.dataset.env === String(env));
      if (loop.dataset.env === String(env)) loop.parentNode.append(loop); // above the others
    }
  });
  follow("time", (time) => {
    for (const chart of charts) chart.showTime(time);
  });
}

function seriesChart(svg, data) {
  const marks = svg.querySelector(".marks");
  const curve = marks.appendChild(document.createElementNS(SVG, "path"));
  curve.setAttribute("class", "chosen");
  const cursor = marks.appendChild(document.createElementNS(SVG, "line"));
  cursor.setAttribute("class", "cursor");
  cursor.setAttribute("y1", TOP);
  cursor.setAttribute("y2", FLOOR);
  const first = Number(svg.dataset.t0);
  const last = Number(svg.dataset.t1);
  return {
    showEnv(env) {
      const line = data?.lines[env];
      curve.setAttribute("d", line ? pathOf(line) : "");
    },
    showTime(time) {
      const x = last > first ? LEFT + ((time - first) / (last - first)) * (RIGHT - LEFT) : LEFT;
      cursor.setAttribute("x1", x);
      cursor.setAttribute("x2", x);
    },
  };
}

/** Returns the path of a curve of differences in tenths of units; null in y: a gap. */
function pathOf({ x, y }) {
  let [path, across, up, down] = ["", 0, 0, false];
  for (let i = 0; i < x.length; i++) {
    across += x[i];
    if (y[i] !== null) {
      up += y[i];
      path += `${down ? "L" : "M"}${across / 10} ${up / 10}`;
    }
    down = y[i] !== null;
  }
  return path;
}
