// One canvas and one camera for all models; each model has a pane of the canvas to itself.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { Cloud } from "./points.js";

const VIEW_ANGLE = 30; // degrees, vertical; this and the margin as in scene.py
const MARGIN = 1.06;
const SLOW = 50; // ms for a picture: the camera's movement stutters
const QUICK = 25;
const FASTER = 1.25; // times the points of the picture before
const LEAST_SHARE = 0.02; // of the points that are drawn while it moves
const WARMING = 2; // frames before those that are timed

/** @param {HTMLElement[]} panes @returns {number} how many stand side by side */
function columnsOf(panes) {
  return new Set(panes.map((pane) => pane.offsetLeft)).size;
}

/**
 * From where the models are seen.
 * @typedef {object} View
 * @property {number} azimuth  degrees; 0 looks at the front, 90 from +x
 * @property {number} elevation  degrees above the horizon
 * @property {"y" | "z" | "-y"} up
 */

/** @type {Record<View["up"], number[]>} */
const UPWARDS = { y: [0, 1, 0], z: [0, 0, 1], "-y": [0, -1, 0] };

/** @param {View} view @returns {THREE.Vector3} from the models to the camera */
function direction({ azimuth, elevation, up }) {
  const a = THREE.MathUtils.degToRad(azimuth);
  const e = THREE.MathUtils.degToRad(elevation);
  const front = Math.cos(a) * Math.cos(e);
  const side = Math.sin(a) * Math.cos(e);
  if (up === "z") return new THREE.Vector3(side, -front, Math.sin(e));
  const turned = up === "y" ? 1 : -1; // half a turn about x
  return new THREE.Vector3(side, turned * Math.sin(e), turned * front);
}

/**
 * A place to look from, of points.
 * @typedef {object} Place
 * @property {string} name
 * @property {number[]} position
 * @property {number[]} target
 * @property {number} view_angle  degrees, vertical, of a picture as wide as `aspect` says
 * @property {number} aspect
 */

/**
 * A camera of Python's.
 * @typedef {object} Pose
 * @property {number[]} position
 * @property {number[]} target
 * @property {number[]} up
 * @property {number} view_angle  degrees, vertical
 * @property {number} near
 * @property {number} far
 */

export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {HTMLElement[]} panes  where on the canvas each model is drawn; one: it shows them in turn
   * @param {(import("./model.js").Model | import("./points.js").Cloud)[]} models
   * @param {View} view
   * @param {Place[]} places  the first is where the camera stands first, if there is one
   */
  constructor(canvas, panes, models, view, places) {
    this.canvas = canvas;
    this.panes = panes;
    this.models = models;
    this.turn = 0; // the model that the first pane shows
    this.view = view;
    this.places = places;
    /** @type {Place | undefined} */
    this.place = places[0];
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setScissorTest(true);
    this.camera = new THREE.PerspectiveCamera(VIEW_ANGLE);
    this.camera.up.fromArray(UPWARDS[view.up]);
    this.scene = new THREE.Scene().add(this.camera, ...models.map((model) => model.root));
    this.scene.updateMatrixWorld(true);
    this.#light();

    const area = /** @type {HTMLElement} */ (canvas.parentElement);
    this.controls = new OrbitControls(this.camera, area);
    this.controls.addEventListener("change", () => this.requestDraw());
    this.controls.addEventListener("start", () => this.#startMoving());
    this.controls.addEventListener("end", () => this.#stopMoving());
    this.held = false; // somebody chose where to look from
    this.drawRequested = false;
    this.share = 1; // of the points, drawn while the camera moves
    this.isMoving = false;
    this.clouds = models.flatMap((model) => (model instanceof Cloud ? model : []));
    new ResizeObserver(() => this.resize()).observe(area);
    this.resize();
  }

  /** A bright room all around, and a key light that moves with the camera. */
  #light() {
    const generator = new THREE.PMREMGenerator(this.renderer);
    this.scene.environment = generator.fromScene(new RoomEnvironment(), 0.04).texture;
    this.scene.environmentIntensity = 0.34;
    if (this.view.up === "z") this.scene.environmentRotation.set(Math.PI / 2, 0, 0);
    if (this.view.up === "-y") this.scene.environmentRotation.set(Math.PI, 0, 0);
    generator.dispose();
    const key = new THREE.DirectionalLight("#ffffff", 1.1);
    key.position.set(-0.6, 0.9, 1);
    this.camera.add(key, key.target);
  }

  /** @param {string} color  CSS */
  setBackground(color) {
    this.scene.background = new THREE.Color(color);
    this.requestDraw();
  }

  resize() {
    const area = /** @type {HTMLElement} */ (this.canvas.parentElement);
    const { clientWidth, clientHeight } = area;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(clientWidth, clientHeight, false);
    // Paper shows the picture as drawn for the screen, so its layout has the same proportions.
    area.style.setProperty("--aspect", String(clientWidth / Math.max(clientHeight, 1)));
    area.style.setProperty("--columns", String(columnsOf(this.panes)));
    if (!this.held) this.fit();
    this.draw(); // at once: a resized canvas is blank
  }

  #startMoving() {
    this.held = true;
    this.isMoving = true;
    clearTimeout(this.rest);
  }

  /** Draws all points again once the camera rests. */
  #stopMoving() {
    this.rest = setTimeout(() => {
      this.isMoving = false;
      this.requestDraw();
    }, 150);
  }

  /** All points; fewer while the camera moves where all would take too long. */
  #drawInTime() {
    const share = this.isMoving ? this.share : 1;
    for (const cloud of this.clouds) cloud.thin(share);
    const begin = performance.now();
    this.draw();
    if (!this.clouds.length) return;
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for the GPU
    const took = performance.now() - begin;
    if (took > SLOW) this.share = Math.max((share * SLOW) / took, LEAST_SHARE);
    else if (took < QUICK) this.share = Math.min(share * FASTER, 1);
  }

  /** Moves the camera to the place that somebody chose; else to where every model just fits. */
  fit() {
    this.held = false;
    if (this.place) this.#goTo(this.place);
    else this.#holdAll();
    this.controls.update();
    this.requestDraw();
  }

  /** @param {Place} place */
  #goTo({ position, target, view_angle, aspect }) {
    const { width, height } = this.panes[0].getBoundingClientRect();
    const narrower = Math.max(1, (aspect * Math.max(height, 1)) / Math.max(width, 1));
    const tan = Math.tan(THREE.MathUtils.degToRad(view_angle / 2)) * narrower;
    this.camera.fov = 2 * THREE.MathUtils.radToDeg(Math.atan(tan));
    this.camera.position.fromArray(position);
    this.controls.target.fromArray(target);
    this.camera.near = 1 / 2000;
    this.camera.far = 30;
    this.controls.minDistance = 1 / 1000;
    this.controls.maxDistance = 20;
  }

  /** Moves the camera to the first view, where every model just fits into its pane. */
  #holdAll() {
    this.camera.fov = VIEW_ANGLE;
    const { width, height } = this.panes[0].getBoundingClientRect();
    const tanY = Math.tan(THREE.MathUtils.degToRad(VIEW_ANGLE / 2)) / MARGIN;
    const tanX = (tanY * Math.max(width, 1)) / Math.max(height, 1);
    const zero = new THREE.Vector3();
    const point = new THREE.Vector3();
    const axes = new THREE.Matrix4().lookAt(direction(this.view), zero, this.camera.up);
    const points = this.#vertices(axes.clone().transpose()); // as the camera sees them
    const box = new THREE.Box3().setFromPoints(points);
    const target = box.getCenter(new THREE.Vector3());
    const size = Math.max(box.getSize(new THREE.Vector3()).length(), 1e-3);
    let distance = 0;
    for (let step = 0; step < 4; step++) {
      // At distance d a point is inside when |x| <= (d - z) tanX and |y| <= (d - z) tanY.
      distance = size / 1000;
      for (const { x, y, z } of points) {
        const reach = Math.max(Math.abs(x - target.x) / tanX, Math.abs(y - target.y) / tanY);
        distance = Math.max(distance, reach + z - target.z);
      }
      // Perspective shows near parts larger: move to the middle of what is seen.
      box.makeEmpty();
      for (const { x, y, z } of points) {
        const depth = distance - (z - target.z);
        box.expandByPoint(point.set((x - target.x) / depth, (y - target.y) / depth, 0));
      }
      target.addScaledVector(box.getCenter(point), distance);
    }
    this.controls.target.copy(target).applyMatrix4(axes);
    this.camera.position.copy(target).add(new THREE.Vector3(0, 0, distance)).applyMatrix4(axes);
    this.camera.near = size / 500;
    this.camera.far = size * 30;
    this.controls.minDistance = size / 100;
    this.controls.maxDistance = size * 20;
  }

  /** @param {THREE.Matrix4} transform @returns {THREE.Vector3[]} of all models */
  #vertices(transform) {
    return this.models.flatMap((model) => model.vertices(transform));
  }

  /** @param {Pose} pose */
  setPose(pose) {
    this.camera.fov = pose.view_angle;
    this.camera.near = pose.near;
    this.camera.far = pose.far;
    this.camera.up.fromArray(pose.up);
    this.camera.position.fromArray(pose.position);
    this.camera.lookAt(new THREE.Vector3().fromArray(pose.target));
  }

  /** @param {number} width @param {number} height @returns {string} data URL of a PNG */
  picture(width, height) {
    this.models.forEach((model, index) => (model.root.visible = index === 0));
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.renderer.setScissorTest(false);
    this.renderer.setViewport(0, 0, width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
    return this.canvas.toDataURL("image/png");
  }

  /**
   * Draws all models again and again, without waiting for the screen.
   * @param {number} width @param {number} height
   * @param {number} frames  at most
   * @param {number} seconds  no further frame after these
   */
  frameTimes(width, height, frames, seconds) {
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.renderer.setScissorTest(false);
    this.renderer.setViewport(0, 0, width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    for (const model of this.models) model.root.visible = true;
    const gl = this.renderer.getContext();
    const frame = () => {
      const begin = performance.now();
      this.renderer.render(this.scene, this.camera);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for the GPU
      return performance.now() - begin;
    };
    for (let i = 0; i < WARMING; i++) frame(); // buffers and shaders are made by the first
    const milliseconds = [];
    const end = performance.now() + 1000 * seconds;
    do milliseconds.push(frame());
    while (milliseconds.length < frames && performance.now() < end);
    this.renderer.render(this.scene, this.camera);
    const picture = this.canvas.toDataURL("image/png");
    const names = gl.getExtension("WEBGL_debug_renderer_info");
    return {
      milliseconds,
      picture,
      renderer: gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER),
    };
  }

  requestDraw() {
    if (this.drawRequested) return;
    this.drawRequested = true;
    requestAnimationFrame(() => {
      this.drawRequested = false;
      this.#drawInTime();
    });
  }

  draw() {
    const area = this.canvas.getBoundingClientRect();
    this.panes.forEach((pane, index) => {
      const { left, bottom, width, height } = pane.getBoundingClientRect();
      if (width < 1 || height < 1) return;
      this.models.forEach((model, other) => (model.root.visible = other === index + this.turn));
      this.renderer.setViewport(left - area.left, area.bottom - bottom, width, height);
      this.renderer.setScissor(left - area.left, area.bottom - bottom, width, height);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.renderer.render(this.scene, this.camera);
    });
  }
}
