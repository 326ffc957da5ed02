// An episode of solids, drawn in three dimensions.

import { element } from "./dom.js";

// Distance from its place in the first frame beyond which a part counts as moving, meters.
const MOVES = 1e-3;

/** Draws solids in their poses. */
export class SolidStage {
  constructor() {
    this.place = element("div", { class: "solids", role: "img", "aria-label": "The episode in three dimensions" });
  }

  /** Returns whether this browser supports WebGL. */
  static isPossible() {
    SolidStage.hasWebGl ??= probe();
    return SolidStage.hasWebGl;
  }

  async take(_, { parts, frames }) {
    this.three ??= await import("./three.js");
    if (this.isClosed) return;
    if (!this.renderer) this.begin();
    this.frames = frames;
    this.clear();
    this.meshes = parts.map((part) => this.mesh(part));
    this.group.add(...this.meshes);
    this.look(parts, frames);
    this.show(0);
  }

  begin() {
    const { AmbientLight, DirectionalLight, Group, OrbitControls, PerspectiveCamera, Scene, WebGLRenderer } = this.three;
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.place.replaceChildren(this.renderer.domElement);
    this.scene = new Scene();
    this.group = new Group();
    const sun = new DirectionalLight(0xffffff, 1.9);
    sun.position.set(2, -3, 5);
    this.scene.add(this.group, new AmbientLight(0xffffff, 1), sun);
    this.camera = new PerspectiveCamera(40, 4 / 3, 0.01, 200);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => this.render());
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(this.place);
    this.resize();
  }

  mesh({ shape, size, color }) {
    const { BoxGeometry, Color, CylinderGeometry, Mesh, MeshStandardMaterial, SphereGeometry } = this.three;
    const [x, y, z] = size;
    const [red, green, blue, alpha] = color;
    const made = {
      cube: () => new BoxGeometry(x, y, z),
      sphere: () => new SphereGeometry(x / 2, 24, 16),
      // The axis of a cylinder is y in three.js and z here.
      cylinder: () => new CylinderGeometry(x / 2, x / 2, z, 24).rotateX(Math.PI / 2),
    };
    const material = new MeshStandardMaterial({
      color: new Color(red, green, blue), opacity: alpha, transparent: alpha < 1, roughness: 0.75,
    });
    return new Mesh(made[shape](), material);
  }

  /** Points the camera at all parts that move and at transparent ones, which mark goals. */
  look(parts, frames) {
    const { Vector3 } = this.three;
    const [low, high] = [new Vector3(Infinity, Infinity, Infinity), new Vector3(-Infinity, -Infinity, -Infinity)];
    parts.forEach(({ color, size }, index) => {
      const places = frames.map((frame) => new Vector3(...frame.slice(7 * index, 7 * index + 3)));
      if (color[3] === 1 && places.every((place) => place.distanceTo(places[0]) < MOVES)) return;
      for (const place of places) {
        const half = Math.max(...size) / 2;
        low.min(place.clone().subScalar(half));
        high.max(place.clone().addScalar(half));
      }
    });
    if (low.x > high.x) [low.x, low.y, low.z, high.x, high.y, high.z] = [-1, -1, 0, 1, 1, 1];
    const center = low.clone().add(high).multiplyScalar(0.5);
    const far = 1.5 * Math.max(high.distanceTo(low), 0.3);
    this.controls.target.copy(center);
    this.camera.position.set(center.x + 0.45 * far, center.y - 0.75 * far, center.z + 0.5 * far);
    this.controls.update();
  }

  /** Shows a frame. */
  show(step) {
    if (this.isClosed) return;
    const frame = this.frames[Math.min(step, this.frames.length - 1)];
    this.meshes.forEach((mesh, index) => {
      const [x, y, z, ...turned] = frame.slice(7 * index, 7 * index + 7);
      mesh.position.set(x, y, z);
      mesh.quaternion.set(...turned);
    });
    this.render();
  }

  render() {
    this.renderer.render(this.scene, this.camera);
  }

  resize() {
    const width = this.place.clientWidth || 480;
    this.renderer.setSize(width, width * 0.75);
    this.camera.updateProjectionMatrix();
    this.render();
  }

  /** Removes what is shown and frees its memory. */
  clear() {
    for (const { geometry, material } of this.group.children) {
      geometry.dispose();
      material.dispose();
    }
    this.group.clear();
  }

  close() {
    this.isClosed = true;
    this.sizes?.disconnect();
    this.controls?.dispose();
    this.renderer?.dispose();
    this.renderer?.forceContextLoss();
  }
}

/** Tries to get a WebGL context, and gives it back: a browser has few of them. */
function probe() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}
