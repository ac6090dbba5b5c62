// The arrays of one environment, in the order in which warpcontact/visualize/report/replay.py packs them.
import { unpack } from "./unpack.js";

/** Returns what moves in one environment: figures, curves, touches and areas of contact. */
export async function unpackEnvironment(pack, scene) {
  const arrays = await unpack(pack);
  let next = 0;
  const take = () => arrays[next++];
  return {
    figures: scene.figures.map(() => ({ positions: take(), turns: take(), scales: take() })),
    curves: scene.curves.map(() => ({ points: take(), shown: take() })),
    touches: scene.touches.map((about) => ({ points: take(), forces: take(), gaps: about.gaps ? take() : null })),
    patches: scene.pressure
      ? { records: take(), vertexStarts: take(), faceStarts: take(), vertices: take(), pressures: take(), faces: take() }
      : null,
  };
}

/** Returns the shapes: {vertices, faces, normals, colors}. */
export async function unpackShapes(scene) {
  const arrays = await unpack(scene.shapes);
  let next = 0;
  const take = () => arrays[next++].data;
  return scene.about.map((about) => ({
    vertices: take(),
    faces: take(),
    normals: about.normals ? take() : null,
    colors: about.colors ? take() : null,
  }));
}

/** Where two records of an array (time|1, …) begin that a moment lies between, and how far it is from the first. */
export function between(array, moment) {
  const row = array.shape.slice(1).reduce((product, length) => product * length, 1);
  const last = array.shape[0] - 1;
  const first = Math.min(moment.record, last);
  return { first: first * row, second: Math.min(moment.record + 1, last) * row, part: moment.part };
}

/** Returns the record before a time, and how far the time is from it to the next one (0…1). */
export function momentOf(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle;
  }
  if (times.length === 1 || time <= times[0]) return { record: 0, part: 0 };
  if (time >= times[high]) return { record: high, part: 0 };
  return { record: low, part: (time - times[low]) / (times[high] - times[low]) };
}

/** Returns the box, as {low, high}, of nearly all positions of what moves; of all figures if nothing does. */
export function boundsOf(environment, scene, shapes) {
  const axes = [[], [], []];
  const add = (positions, reach) => {
    const { data } = positions;
    const every = Math.max(1, Math.floor(data.length / 3 / 20000));
    for (let i = 0; i + 2 < data.length; i += 3 * every) {
      for (let axis = 0; axis < 3; axis++) axes[axis].push(data[i + axis] - reach, data[i + axis] + reach);
    }
  };
  environment.figures.forEach(({ positions }, i) => {
    if (scene.figures[i].moves) add(positions, 0.4 * scene.size);
  });
  if (!axes[0].length) environment.figures.forEach(({ positions, scales }, i) => {
    if (positions.data.length) add(positions, Math.max(...scales.data.slice(0, 3)) * reachOf(shapes[scene.figures[i].shape]));
  });
  if (!axes[0].length) environment.curves.forEach(({ points }) => add(points, 0));
  if (!axes[0].length) return { low: [-1, -1, -1], high: [1, 1, 1] };
  const at = (values, part) => values[Math.round(part * (values.length - 1))];
  const sorted = axes.map((values) => values.filter(Number.isFinite).sort((a, b) => a - b));
  return { low: sorted.map((values) => at(values, 0.01)), high: sorted.map((values) => at(values, 0.99)) };
}

function reachOf(shape) {
  return shape.vertices.reduce((reach, value) => Math.max(reach, Math.abs(value)), 0);
}
