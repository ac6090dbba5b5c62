// What keys do, while nothing is typed into a field.
import { select } from "./selection.js";

const PATIENCE = 700; // ms between the digits of a number

export function startKeys(replay) {
  let digits = "";
  let waiting = 0;
  const press = (id) => document.getElementById(id).click();
  const actions = {
    " ": () => replay.toggle(),
    ArrowLeft: (event) => replay.step(event.shiftKey ? -10 : -1),
    ArrowRight: (event) => replay.step(event.shiftKey ? 10 : 1),
    Home: () => replay.step(-Infinity),
    End: () => replay.step(Infinity),
    "[": () => replay.turn(-1),
    "]": () => replay.turn(1),
    "+": () => replay.faster(1),
    "=": () => replay.faster(1),
    "-": () => replay.faster(-1),
    a: () => press("replay-arrows"),
    g: () => press("replay-gaps"),
    p: () => press("replay-pressure"),
    f: () => replay.fit(),
    "?": () => document.getElementById("replay-help").showModal(),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const { target } = event;
    if (target.matches?.("select, textarea, input:not([type=checkbox])") || target.closest?.("pre, .scroll")) return;
    // Buttons and links have keys of their own.
    if (event.key === " " && target.matches?.("button, a, summary, input")) return;
    if (/^\d$/.test(event.key)) {
      clearTimeout(waiting);
      digits += event.key;
      waiting = setTimeout(() => {
        if (replay.envs.includes(Number(digits))) select("env", Number(digits));
        digits = "";
      }, PATIENCE);
      return;
    }
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (action && inView()) {
      event.preventDefault();
      action(event);
    }
  });
}

/** Whether any of the replay is seen: keys do nothing to what is elsewhere. */
function inView() {
  const { top, bottom } = document.getElementById("replay-viewer").getBoundingClientRect();
  return bottom > 0 && top < window.innerHeight;
}
