// Areas of body contacts, coloured by pressure, as warpcontact/visualize/report/pressure.py packs them.
import { BufferAttribute, BufferGeometry, Color, DoubleSide, Mesh, MeshBasicMaterial, SRGBColorSpace } from "three";

/** Sets the colour of a pressure [Pa] among evenly spaced `stops`, from 0 to the largest pressure. */
export function pressureColor(color, pressure, { largest, stops }) {
  const value = Math.max(0, Math.min(1, pressure / largest)) * (stops.length - 1);
  const first = Math.min(Math.floor(value), stops.length - 2);
  const mixed = stops[first].map((component, i) => component + (value - first) * (stops[first + 1][i] - component));
  return color.setRGB(...mixed, SRGBColorSpace);
}

/** Returns the background of a bar with all colours. */
export function pressureBar({ stops }) {
  const css = stops.map((color) => `rgb(${color.map((component) => Math.round(255 * component)).join(" ")})`);
  return `linear-gradient(to right, ${css.join(", ")})`;
}

/** The areas of all body contacts of an environment. They lie inside of bodies, and are drawn over them. */
export class Patches {
  constructor({ records, vertexStarts, faceStarts, vertices, pressures, faces }, scale) {
    this.records = records.data;
    this.vertexStarts = vertexStarts.data;
    this.faceStarts = faceStarts.data;
    this.vertices = vertices.data;
    this.faces = faces.data;
    this.colors = new Float32Array(3 * pressures.data.length);
    const color = new Color();
    pressures.data.forEach((pressure, i) => pressureColor(color, pressure, scale).toArray(this.colors, 3 * i));
    const material = new MeshBasicMaterial({
      vertexColors: true, side: DoubleSide, depthTest: false, depthWrite: false, transparent: true, opacity: 0.85,
    });
    this.mesh = new Mesh(new BufferGeometry(), material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 9; // before arrows
    this.shown = -1;
    this.triangles = 0;
  }

  /** Shows the areas at the record that is nearest to a moment, or before it. */
  place({ record, part }) {
    const at = part > 0.5 ? record + 1 : record;
    let number = 0;
    while (number + 1 < this.records.length && this.records[number + 1] <= at) number++;
    if (number === this.shown) return;
    this.shown = number;
    const [first, end] = [this.vertexStarts[number], this.vertexStarts[number + 1]];
    const faces = this.faces.slice(3 * this.faceStarts[number], 3 * this.faceStarts[number + 1]);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(this.vertices.slice(3 * first, 3 * end), 3));
    geometry.setAttribute("color", new BufferAttribute(this.colors.slice(3 * first, 3 * end), 3));
    geometry.setIndex(new BufferAttribute(faces, 1));
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometry;
    this.triangles = faces.length / 3;
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}
