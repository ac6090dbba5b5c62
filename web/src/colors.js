// Gaps as colours: red where surfaces overlap, blue where they are apart, pale where they just touch.
import { SRGBColorSpace } from "three";

// The same as in the legend, warpcontact/run_report/page.css.
const STOPS = [
  [-1, [178, 24, 43]],
  [-0.5, [239, 138, 98]],
  [0, [247, 247, 247]],
  [0.5, [103, 169, 207]],
  [1, [33, 102, 172]],
];

/** Sets the colour of a gap [m]: −deepest and less is the one end, `far` and more the other. */
export function gapColor(color, gap, deepest, far) {
  const value = Math.max(-1, Math.min(1, gap < 0 ? gap / (deepest || 1) : gap / far));
  const next = STOPS.findIndex(([stop]) => value <= stop) || 1;
  const [[low, a], [high, b]] = [STOPS[next - 1], STOPS[next]];
  const part = (value - low) / (high - low);
  const mixed = a.map((component, i) => (component + part * (b[i] - component)) / 255);
  return color.setRGB(...mixed, SRGBColorSpace);
}
