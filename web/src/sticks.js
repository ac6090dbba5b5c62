// Straight pieces with a thickness: arrows of forces, and the pieces of a curve. Shapes lie along +Z, from 0 to 1.
import {
  Color, ConeGeometry, CylinderGeometry, InstancedMesh, Matrix4, MeshBasicMaterial, MeshStandardMaterial, Quaternion,
  SRGBColorSpace, SphereGeometry, Vector3,
} from "three";
import { between } from "./environment.js";
import { gapColor } from "./colors.js";

const UP = new Vector3(0, 0, 1);
const FROM = new Vector3();
const ALONG = new Vector3();
const SCALE = new Vector3();
const TURN = new Quaternion();
const MATRIX = new Matrix4();
const NOWHERE = new Matrix4().makeScale(0, 0, 0);

function upright(geometry) {
  return geometry.translate(0, 0.5, 0).rotateX(Math.PI / 2);
}

function placed(mesh, i, from, along, length, width) {
  if (length > 0) TURN.setFromUnitVectors(UP, ALONG.copy(along).multiplyScalar(1 / along.length()));
  mesh.setMatrixAt(i, length > 0 ? MATRIX.compose(from, TURN, SCALE.set(width, width, length)) : NOWHERE);
}

function interpolated(out, array, at, axis) {
  const { data } = array;
  const component = (k) => {
    const first = data[at.first + axis + k];
    return at.part > 0 ? first + at.part * (data[at.second + axis + k] - first) : first;
  };
  return out.set(component(0), component(1), component(2));
}

/** A spring, a rope or a line. */
export class Curve {
  constructor(about, { points, shown }, width) {
    this.points = points;
    this.shown = shown;
    this.width = width;
    this.pieces = points.shape[1] - 1;
    const material = new MeshStandardMaterial({ color: new Color().setRGB(...about.color, SRGBColorSpace), roughness: 0.8 });
    this.mesh = new InstancedMesh(upright(new CylinderGeometry(1, 1, 1, 8, 1)), material, this.pieces);
    this.mesh.frustumCulled = false;
    this.mesh.castShadow = true;
  }

  place(moment) {
    const at = between(this.points, moment);
    this.mesh.visible = this.shown.data[between(this.shown, moment).first] > 0.5;
    const next = new Vector3();
    for (let i = 0; i < this.pieces; i++) {
      interpolated(FROM, this.points, at, 3 * i);
      interpolated(next, this.points, at, 3 * i + 3).sub(FROM);
      placed(this.mesh, i, FROM, next, next.length(), this.width);
    }
    this.mesh.instanceMatrix.needsUpdate = true;
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.mesh.dispose();
  }
}

// What belongs to a contact is inside of what touches: it is drawn over it.
function overlay(color) {
  return new MeshBasicMaterial({ color, depthTest: false, depthWrite: false, transparent: true });
}

/** The forces of a contact as arrows, and its points coloured by their gaps. */
export class Touch {
  constructor(about, { points, forces, gaps }, scene) {
    this.points = points;
    this.forces = forces;
    this.gaps = gaps;
    this.scene = scene;
    this.count = points.shape[1];
    const color = new Color().setRGB(...about.color, SRGBColorSpace);
    this.shafts = new InstancedMesh(upright(new CylinderGeometry(1, 1, 1, 10, 1)), overlay(color), this.count);
    this.heads = new InstancedMesh(upright(new ConeGeometry(1, 1, 14, 1)), overlay(color), this.count);
    this.dots = gaps ? new InstancedMesh(new SphereGeometry(1, 12, 8), overlay(0xffffff), this.count) : null;
    this.meshes = [this.shafts, this.heads, this.dots].filter(Boolean);
    this.meshes.forEach((mesh, i) => {
      mesh.frustumCulled = false;
      mesh.renderOrder = 10 + i;
    });
    this.acting = 0;
    this.touching = 0;
  }

  show(arrows, gaps) {
    this.shafts.visible = this.heads.visible = arrows;
    if (this.dots) this.dots.visible = gaps;
  }

  place(moment) {
    const p = between(this.points, moment);
    const f = between(this.forces, moment);
    const force = new Vector3();
    const tip = new Vector3();
    const width = 0.02 * this.scene.size;
    this.acting = 0;
    for (let i = 0; i < this.count; i++) {
      interpolated(FROM, this.points, p, 3 * i);
      interpolated(force, this.forces, f, 3 * i).multiplyScalar(this.scene.forceScale);
      const length = force.length();
      // Quantised forces are never quite zero.
      const there = length > 2e-4 * this.scene.size;
      if (there) this.acting++;
      const head = Math.min(0.4 * length, 0.16 * this.scene.size);
      tip.copy(force).multiplyScalar(there ? 1 - head / length : 0).add(FROM);
      placed(this.shafts, i, FROM, force, there ? length - head : 0, width);
      placed(this.heads, i, tip, force, there ? head : 0, 2.8 * width);
    }
    if (this.dots) this.#placeDots(p, between(this.gaps, moment));
    for (const mesh of this.meshes) mesh.instanceMatrix.needsUpdate = true;
  }

  #placeDots(p, g) {
    const { size, deepest, gapColors } = this.scene;
    const color = new Color();
    const radius = 0.032 * size;
    this.touching = 0;
    for (let i = 0; i < this.count; i++) {
      const first = this.gaps.data[g.first + i];
      const gap = g.part > 0 ? first + g.part * (this.gaps.data[g.second + i] - first) : first;
      if (gap < 0) this.touching++;
      interpolated(FROM, this.points, p, 3 * i);
      const near = Number.isFinite(gap) && gap <= size;
      this.dots.setMatrixAt(i, near ? MATRIX.compose(FROM, TURN.identity(), SCALE.setScalar(radius)) : NOWHERE);
      this.dots.setColorAt(i, gapColor(color, near ? gap : 0, gapColors, deepest, size));
    }
    this.dots.instanceColor.needsUpdate = true;
  }

  dispose() {
    for (const mesh of this.meshes) {
      mesh.geometry.dispose();
      mesh.material.dispose();
      mesh.dispose();
    }
  }
}
