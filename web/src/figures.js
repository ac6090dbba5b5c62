// Bodies and surfaces: copies of a shape, placed in every record.
import {
  BufferAttribute, BufferGeometry, Color, DoubleSide, FrontSide, InstancedMesh, Matrix4, MeshStandardMaterial,
  Quaternion, SRGBColorSpace, Vector3,
} from "three";
import { between } from "./environment.js";

/** Returns the geometry of a shape; with a colour for each face, or flat ones, no two faces share a point. */
export function geometryOf(shape) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(shape.vertices, 3));
  geometry.setIndex(new BufferAttribute(shape.faces, 1));
  if (shape.normals) geometry.setAttribute("normal", new BufferAttribute(shape.normals, 3));
  if (shape.normals && !shape.colors) return geometry;
  const flat = geometry.toNonIndexed();
  if (!shape.normals) flat.computeVertexNormals();
  if (shape.colors) flat.setAttribute("color", new BufferAttribute(colorsOfCorners(shape.colors), 3));
  return flat;
}

function colorsOfCorners(ofFaces) {
  const found = new Float32Array(3 * ofFaces.length);
  const color = new Color();
  for (let face = 0; face < ofFaces.length / 3; face++) {
    color.setRGB(ofFaces[3 * face], ofFaces[3 * face + 1], ofFaces[3 * face + 2], SRGBColorSpace);
    for (let corner = 0; corner < 3; corner++) color.toArray(found, 9 * face + 3 * corner);
  }
  return found;
}

/** Copies of one shape in one environment. */
export class Figure {
  constructor(about, geometry, { positions, turns, scales }) {
    this.name = about.name;
    this.moves = about.moves;
    this.positions = positions;
    this.turns = turns;
    this.scales = scales.data;
    this.count = positions.shape[1];
    const colored = geometry.hasAttribute("color");
    const material = new MeshStandardMaterial({
      color: colored ? 0xffffff : new Color().setRGB(...about.color, SRGBColorSpace),
      vertexColors: colored,
      roughness: 0.72,
      metalness: 0,
      side: about.kind === "surface" ? DoubleSide : FrontSide,
    });
    this.mesh = new InstancedMesh(geometry, material, this.count);
    this.mesh.frustumCulled = false;
    this.mesh.castShadow = about.moves;
    this.mesh.receiveShadow = true;
    this.place({ record: 0, part: 0 });
  }

  /** Moves the copies to where they are at a moment. */
  place(moment) {
    const p = between(this.positions, moment);
    const q = between(this.turns, moment);
    const data = this.positions.data;
    for (let i = 0; i < this.count; i++) {
      const at = 3 * i;
      POSITION.set(
        data[p.first + at] + p.part * (data[p.second + at] - data[p.first + at]),
        data[p.first + at + 1] + p.part * (data[p.second + at + 1] - data[p.first + at + 1]),
        data[p.first + at + 2] + p.part * (data[p.second + at + 2] - data[p.first + at + 2]),
      );
      Quaternion.slerpFlat(TURN, 0, this.turns.data, q.first + 4 * i, this.turns.data, q.second + 4 * i, q.part);
      QUATERNION.fromArray(TURN).normalize();
      SCALE.fromArray(this.scales, at);
      this.mesh.setMatrixAt(i, MATRIX.compose(POSITION, QUATERNION, SCALE));
    }
    this.mesh.instanceMatrix.needsUpdate = true;
  }

  /** Where the first copies are drawn: what a test reads. */
  places(most) {
    const found = [];
    for (let i = 0; i < Math.min(most, this.count); i++) {
      this.mesh.getMatrixAt(i, MATRIX);
      found.push(POSITION.setFromMatrixPosition(MATRIX).toArray());
    }
    return found;
  }

  dispose() {
    this.mesh.material.dispose();
    this.mesh.dispose();
  }
}

const POSITION = new Vector3();
const QUATERNION = new Quaternion();
const SCALE = new Vector3();
const MATRIX = new Matrix4();
const TURN = [0, 0, 0, 1];
