// Gaps as colours, which warpcontact/drawing/colors.py chooses: from the deepest overlap over touch to far away.
import { SRGBColorSpace } from "three";

/** Sets the colour of a gap [m] among `stops` (−1…1, RGB): −deepest and less is the one end, `far` and more the other. */
export function gapColor(color, gap, stops, deepest, far) {
  const value = Math.max(-1, Math.min(1, gap < 0 ? gap / (deepest || 1) : gap / far));
  const next = stops.findIndex(([stop]) => value <= stop) || 1;
  const [[low, a], [high, b]] = [stops[next - 1], stops[next]];
  const part = (value - low) / (high - low);
  const mixed = a.map((component, i) => (component + part * (b[i] - component)) / 255);
  return color.setRGB(...mixed, SRGBColorSpace);
}

/** Returns the background of a bar with all colours. */
export function gapBar(stops) {
  return `linear-gradient(to right, ${stops.map(([, color]) => `rgb(${color.join(" ")})`).join(", ")})`;
}
