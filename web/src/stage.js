// Canvas, camera and light. It draws when something changed, and not otherwise.
import {
  AmbientLight, Color, DirectionalLight, HemisphereLight, PCFShadowMap, PerspectiveCamera, Scene, Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const MOST_PIXELS = 2; // of the screen for each of the page, along a side
const DIRECTION = new Vector3(0.75, -1, 0.55).normalize();
const SUN = new Vector3(0.5, -0.35, 1).normalize();

export class Stage {
  constructor(canvas, place) {
    this.canvas = canvas;
    this.place = place;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, powerPreference: "low-power" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.scene = new Scene();
    this.scene.background = new Color();
    this.camera = new PerspectiveCamera(35, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.moved = false; // by the reader
    this.controls.addEventListener("start", () => (this.moved = true));
    this.controls.addEventListener("change", () => this.#clip());
    this.#light();
    this.frames = 0;
    this.drawing = false;
    new ResizeObserver(() => this.#resize()).observe(place);
    this.#resize();
  }

  #light() {
    this.scene.add(new HemisphereLight(0xffffff, 0x8f8a80, 1.6), new AmbientLight(0xffffff, 0.35));
    this.sun = new DirectionalLight(0xffffff, 2.1);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.scene.add(this.sun, this.sun.target);
  }

  /** Looks at a box: {low, high}. */
  fit({ low, high }) {
    const centre = new Vector3(...low).add(new Vector3(...high)).multiplyScalar(0.5);
    const radius = Math.max(0.5 * new Vector3(...high).distanceTo(new Vector3(...low)), 1e-9);
    const distance = this.#distance(new Vector3(...high).sub(centre));
    this.controls.target.copy(centre);
    this.camera.position.copy(DIRECTION).multiplyScalar(distance).add(centre);
    this.controls.minDistance = 1e-3 * radius;
    this.controls.maxDistance = 1e3 * radius;
    this.sun.target.position.copy(centre);
    this.sun.position.copy(SUN).multiplyScalar(4 * radius).add(centre);
    const { camera } = this.sun.shadow;
    Object.assign(camera, { left: -1.4 * radius, right: 1.4 * radius, top: 1.4 * radius, bottom: -1.4 * radius });
    Object.assign(camera, { near: 0.5 * radius, far: 9 * radius });
    camera.updateProjectionMatrix();
    this.sun.shadow.normalBias = 0.004 * radius;
    this.sun.shadow.bias = -0.0008;
    this.controls.update();
    this.moved = false;
    this.#clip();
  }

  /** Returns from how far off a box with this half-diagonal is seen as a whole. */
  #distance(half) {
    const across = new Vector3().crossVectors(this.camera.up, DIRECTION).normalize();
    const upwards = new Vector3().crossVectors(DIRECTION, across);
    const tangent = Math.tan((this.camera.fov * Math.PI) / 360);
    let distance = 0;
    for (let corner = 0; corner < 8; corner++) {
      const place = new Vector3(corner & 1 ? 1 : -1, corner & 2 ? 1 : -1, corner & 4 ? 1 : -1).multiply(half);
      const wide = Math.abs(place.dot(across)) / this.camera.aspect;
      const high = Math.abs(place.dot(upwards));
      distance = Math.max(distance, place.dot(DIRECTION) + Math.max(wide, high) / tangent);
    }
    return 1.06 * distance;
  }

  background(dark) {
    this.scene.background.set(dark ? 0x171b21 : 0xeef1f5);
    this.draw();
  }

  /** Draws soon, once however often it is asked. */
  draw() {
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => {
      this.drawing = false;
      this.renderer.render(this.scene, this.camera);
      this.frames++;
    });
  }

  #clip() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.near = 0.02 * distance;
    this.camera.far = 300 * distance;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.place;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, MOST_PIXELS));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }
}
