// The replay: one environment at one time, and what its controls do.
import { gapBar } from "./colors.js";
import { boundsOf, momentOf, unpackEnvironment, unpackShapes } from "./environment.js";
import { Figure, geometryOf } from "./figures.js";
import { force, length, number, pressure } from "./numbers.js";
import { Patches, pressureBar } from "./patches.js";
import { follow, select, selection } from "./selection.js";
import { Stage } from "./stage.js";
import { Curve, Touch } from "./sticks.js";
import { onTheme, isDark } from "./theme.js";
import { block } from "./unpack.js";
import { startKeys } from "./keys.js";

const SPEEDS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];
const COMFORTABLE = 8; // seconds that a replay takes, if nothing else is said

const element = (id) => document.getElementById(id);

/** Starts the replay, if the page has one; returns it, or null. */
export async function startReplay(scene) {
  const canvas = element("replay-canvas");
  if (!canvas) return null;
  const problem = whyNot();
  if (problem) {
    tell(problem);
    return null;
  }
  const replay = new Replay(scene, canvas);
  await replay.start();
  return replay;
}

function whyNot() {
  if (!document.createElement("canvas").getContext("webgl2")) {
    return "This browser shows no WebGL 2, which the replay needs. Everything else of the report is here.";
  }
  return typeof DecompressionStream === "undefined" ? "This browser is too old for the replay." : "";
}

/** Shows a message in place of the replay. */
export function tell(message) {
  element("replay-message").textContent = message;
  element("replay-message").hidden = false;
  element("replay-viewer").classList.add("failed");
}

class Replay {
  constructor(scene, canvas) {
    this.scene = scene;
    this.times = scene.times;
    this.envs = scene.envs.map(({ env }) => env);
    this.stage = new Stage(canvas, element("replay-stage"));
    this.playing = false;
    this.shown = null; // the environment that is drawn
    this.figures = [];
    this.curves = [];
    this.touches = [];
    this.patches = [];
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      tell("The graphics card has given up the replay; reload the page.");
    });
  }

  async start() {
    this.shapes = await unpackShapes(this.scene);
    this.geometries = this.shapes.map(geometryOf);
    this.#fillControls();
    this.#connect();
    onTheme((dark) => this.stage.background(dark));
    this.stage.background(isDark());
    await this.#showEnv(selection.env ?? this.envs[0]);
    follow("env", (env) => this.#showEnv(env));
    this.seek(this.times[0]);
    startKeys(this);
  }

  /** What is seen, for those who test it. */
  state() {
    const { record, part } = momentOf(this.times, this.time);
    const figures = this.figures.map((figure) => ({ name: figure.name, count: figure.count, moves: figure.moves,
      places: figure.places(4) }));
    return {
      env: this.shown, envs: this.envs, time: this.time, record, part, records: this.times.length,
      playing: this.playing, speed: this.speed, figures, frames: this.stage.frames,
      arrows: element("replay-arrows").checked ? this.touches.reduce((sum, touch) => sum + touch.acting, 0) : 0,
      patches: element("replay-pressure").checked ? this.patches.reduce((sum, one) => sum + one.triangles, 0) : 0,
      gaps: element("replay-gaps").checked, curves: this.curves.filter((curve) => curve.mesh.visible).length,
      camera: this.stage.camera.position.toArray(), calls: this.stage.renderer.info.render.calls,
      triangles: this.stage.renderer.info.render.triangles,
      canvas: [this.stage.canvas.clientWidth, this.stage.canvas.clientHeight],
    };
  }

  get speed() {
    return Number(element("replay-speed").value);
  }

  /** Goes to a time [s]. */
  seek(time) {
    this.time = Math.max(this.times[0], Math.min(this.times.at(-1), time));
    const slider = element("replay-time");
    slider.value = this.time;
    const last = `${number(this.times.at(-1), 4)}\u202fs`;
    const told = `${this.time.toFixed(this.decimals)}\u202fs`;
    element("replay-time-text").textContent = `${told} of ${last}`;
    element("replay-clock").textContent = told;
    slider.setAttribute("aria-valuetext", told);
    const moment = momentOf(this.times, this.time);
    for (const figure of this.figures) if (figure.moves) figure.place(moment);
    for (const one of [...this.curves, ...this.touches, ...this.patches]) one.place(moment);
    select("time", this.time);
    this.stage.draw();
  }

  /** Goes so many records on, to a record. */
  step(records) {
    this.pause();
    const { record, part } = momentOf(this.times, this.time);
    const from = records < 0 && part > 0 ? record + 1 : record;
    this.seek(this.times[Math.max(0, Math.min(this.times.length - 1, from + records))]);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.times.length < 2) return;
    if (this.time >= this.times.at(-1)) this.seek(this.times[0]);
    this.playing = true;
    this.#showPlaying();
    let before = performance.now();
    const go = (now) => {
      if (!this.playing) return;
      this.seek(this.time + ((now - before) / 1000) * this.speed);
      before = now;
      if (this.time >= this.times.at(-1)) this.pause();
      else requestAnimationFrame(go);
    };
    requestAnimationFrame(go);
  }

  pause() {
    this.playing = false;
    this.#showPlaying();
  }

  /** Shows the environment so many places after the one that is shown. */
  turn(places) {
    const next = this.envs.indexOf(this.shown) + places;
    select("env", this.envs[(next + this.envs.length) % this.envs.length]);
  }

  faster(steps) {
    const list = element("replay-speed");
    list.selectedIndex = Math.max(0, Math.min(list.options.length - 1, list.selectedIndex + steps));
  }

  fit() {
    this.stage.fit(boundsOf(this.environment, this.scene, this.shapes));
  }

  async #showEnv(env) {
    const pack = block(`replay-${env}`);
    if (!pack) return;
    const about = this.scene;
    this.wanted = env;
    const found = await unpackEnvironment(pack, about);
    if (this.wanted !== env) return; // another was asked for meanwhile
    for (const old of [...this.figures, ...this.curves, ...this.touches, ...this.patches]) old.dispose();
    const { scene } = this.stage;
    scene.remove(...(this.drawn ?? []));
    this.environment = found;
    const bounds = boundsOf(found, about, this.shapes);
    // Long lines are to be seen from where all of them is seen.
    const thickness = Math.max(0.012 * about.size, 0.0016 * Math.hypot(...bounds.high.map((end, i) => end - bounds.low[i])));
    this.figures = found.figures
      .map((arrays, i) => ({ arrays, of: about.figures[i] }))
      .filter(({ arrays }) => arrays.positions.shape[1] > 0)
      .map(({ arrays, of }) => new Figure(of, this.geometries[of.shape], arrays));
    this.curves = found.curves.map((arrays, i) => new Curve(about.curves[i], arrays, thickness));
    this.touches = found.touches.map((arrays, i) => new Touch(about.touches[i], arrays, about));
    this.patches = found.patches ? [new Patches(found.patches, about.pressure)] : [];
    this.drawn = [...this.figures, ...this.curves, ...this.patches].map(({ mesh }) => mesh);
    this.drawn.push(...this.touches.flatMap(({ meshes }) => meshes));
    scene.add(...this.drawn);
    this.shown = env;
    element("replay-env").value = env;
    select("env", env);
    this.#showTouches();
    if (!this.stage.moved) this.fit();
    this.seek(this.time ?? this.times[0]);
  }

  #showTouches() {
    for (const touch of this.touches) touch.show(element("replay-arrows").checked, element("replay-gaps").checked);
    const arrows = element("replay-arrows").checked && this.scene.largestForce > 0;
    for (const one of this.patches) one.mesh.visible = element("replay-pressure").checked;
    element("legend-pressure").hidden = !(element("replay-pressure").checked && this.scene.pressure);
    element("legend-force").hidden = !arrows;
    element("legend-gap").hidden = !(element("replay-gaps").checked && this.scene.gaps);
    this.stage.draw();
  }

  #showPlaying() {
    const button = element("replay-play");
    button.textContent = this.playing ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(this.playing));
  }

  #fillControls() {
    const span = this.times.at(-1) - this.times[0];
    this.decimals = Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(span > 0 ? span : 1))));
    const slider = element("replay-time");
    Object.assign(slider, { min: this.times[0], max: this.times.at(-1), value: this.times[0] });
    slider.disabled = element("replay-play").disabled = this.times.length < 2;
    element("replay-env").append(...this.scene.envs.map(({ env, label }) => new Option(label, env)));
    for (const id of ["replay-before", "replay-after"]) element(id).disabled = this.envs.length < 2;
    const natural = span >= 2 && span <= 20 ? 1 : nearest(span / COMFORTABLE);
    for (const speed of SPEEDS) {
      element("replay-speed").append(new Option(`× ${speed}`, speed, speed === natural, speed === natural));
    }
    const touches = this.scene.touches.length > 0;
    element("replay-arrows").disabled = !touches;
    element("replay-gaps").disabled = !this.scene.gaps;
    element("replay-pressure").disabled = !this.scene.pressure;
    if (this.scene.pressure) {
      element("legend-pressure-bar").style.background = pressureBar(this.scene.pressure);
      element("legend-pressure-low").textContent = "0";
      element("legend-pressure-high").textContent = pressure(this.scene.pressure.largest);
    }
    element("legend-bar").style.background = gapBar(this.scene.gapColors);
    element("legend-low").textContent = length(-this.scene.deepest).replace(/^-/, "−");
    element("legend-high").textContent = length(this.scene.size);
    element("legend-force").textContent = `longest arrow ${force(this.scene.largestForce)}`;
  }

  #connect() {
    element("replay-play").addEventListener("click", () => this.toggle());
    element("replay-time").addEventListener("input", (event) => {
      this.pause();
      this.seek(Number(event.target.value));
    });
    element("replay-env").addEventListener("change", (event) => select("env", Number(event.target.value)));
    element("replay-before").addEventListener("click", () => this.turn(-1));
    element("replay-after").addEventListener("click", () => this.turn(1));
    element("replay-fit").addEventListener("click", () => this.fit());
    element("replay-keys").addEventListener("click", () => element("replay-help").showModal());
    for (const id of ["replay-arrows", "replay-gaps", "replay-pressure"]) element(id).addEventListener("change", () => this.#showTouches());
  }
}

function nearest(speed) {
  const distance = (candidate) => Math.abs(Math.log(candidate / (speed > 0 ? speed : 1)));
  return SPEEDS.reduce((best, candidate) => (distance(candidate) < distance(best) ? candidate : best));
}
