// Meshes side by side that turn round together, once; then they stand still.

import { Model } from "../model.js";
import { Stage } from "../stage.js";

const NO_LINES = new Float32Array();
const PAPER = "#f4f5f7";
const VIEW_ANGLE = 30; // degrees
const RADIUS = 0.5; // of a model, placed at the origin with a bounding box of diagonal 1
const ELEVATION = 15; // degrees
const LATE_MS = 100; // after a turn, until it ends without the browser's next picture
const LOOKS = {
  texture: true, flat: false, wireframe: false, boundary: false, backfaces: true, axes: false,
  lines: false, size: 1,
};

/** @param {number} degrees @returns {number} radians */
function radians(degrees) {
  return (degrees * Math.PI) / 180;
}

/**
 * Meshes that turn on one canvas. A study has one turntable, because a graphics context takes long
 * to make.
 */
export class Turntable {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.angle = 0; // radians
    /** @type {Stage | null} */
    this.stage = null;
    this.generation = 0; // counts the calls of show and stop; what an older one loads is outdated
    /** Ends the wait for the current turn. @type {() => void} */
    this.endTurn = () => {};
    this.resize = () => this.stage?.resize();
  }

  /**
   * Shows models and turns them round once.
   * @param {HTMLElement} row  holds the panes
   * @param {HTMLElement[]} panes
   * @param {string[]} addresses  of GLB files
   * @param {number} seconds  for one turn
   * @returns {Promise<void>} resolved when they have turned round, or when something else is shown
   */
  async show(row, panes, addresses, seconds) {
    this.stop();
    const { generation } = this;
    this.angle = 0;
    const models = await load(addresses);
    if (generation !== this.generation) {
      release(models);
      return;
    }
    for (const model of models) model.show(LOOKS);
    row.prepend(this.canvas);
    this.#place(panes, models);
    addEventListener("resize", this.resize);
    await this.#turn(models, seconds);
  }

  /** Ends a turn; what is still being loaded will not be shown. */
  stop() {
    this.generation += 1;
    removeEventListener("resize", this.resize);
    this.endTurn();
  }

  /**
   * @param {Model[]} models
   * @param {number} seconds  for one turn
   * @returns {Promise<void>} resolved at the end of the turn, or by `stop`
   */
  #turn(models, seconds) {
    const { generation } = this;
    const began = performance.now();
    return new Promise((done) => {
      this.endTurn = done;
      const turn = () => {
        if (generation !== this.generation) return;
        const share = seconds > 0 ? Math.min(1, (performance.now() - began) / (1000 * seconds)) : 1;
        this.angle = 2 * Math.PI * share;
        for (const model of models) model.root.rotation.y = this.angle;
        this.stage?.draw();
        if (share < 1) requestAnimationFrame(turn);
        else done();
      };
      turn();
      // A window that others cover draws nothing, and would never end the turn.
      setTimeout(turn, 1000 * seconds + LATE_MS);
    });
  }

  /**
   * Puts models on the stage, in place of those before.
   * @param {HTMLElement[]} panes
   * @param {Model[]} models
   */
  #place(panes, models) {
    if (this.stage) {
      for (const model of this.stage.models) this.stage.scene.remove(model.root);
      release(this.stage.models);
      this.stage.scene.add(...models.map((model) => model.root));
      this.stage.models = models;
      this.stage.panes = panes;
      this.stage.resize();
      return;
    }
    const view = { azimuth: 0, elevation: 0, up: /** @type {const} */ ("y") };
    this.stage = new Stage(this.canvas, panes, models, view, []);
    this.stage.setBackground(PAPER);
    this.stage.controls.enabled = false; // everybody sees the same
    this.stage.held = true; // the camera stays where any side of a model fits into its pane
    const [far, up] = [RADIUS / Math.sin(radians(VIEW_ANGLE / 2)), radians(ELEVATION)];
    this.stage.setPose({
      position: [0, far * Math.sin(up), far * Math.cos(up)],
      target: [0, 0, 0],
      up: [0, 1, 0],
      view_angle: VIEW_ANGLE,
      near: far / 100,
      far: 4 * far,
    });
  }
}

/**
 * Loads models; if one cannot be loaded, the others are released.
 * @param {string[]} addresses  of GLB files
 * @returns {Promise<Model[]>}
 */
async function load(addresses) {
  const results = await Promise.allSettled(addresses.map(loadOne));
  const failed = results.find((result) => result.status === "rejected");
  const models = results.flatMap((r) => (r.status === "fulfilled" ? [r.value] : []));
  if (!failed) return models;
  release(models);
  throw failed.reason;
}

/** @param {string} address  of a GLB file @returns {Promise<Model>} */
async function loadOne(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address}: ${answer.status} ${answer.statusText}`);
  return Model.load(await answer.arrayBuffer(), NO_LINES);
}

/**
 * Frees what the graphics card holds of models: each geometry, material and texture once.
 * @param {Iterable<{root: import("three").Object3D}>} models
 */
export function release(models) {
  /** @type {Set<{dispose(): void}>} */
  const held = new Set();
  for (const { root } of models) {
    root.traverse((node) => {
      const { geometry, material, userData } = /** @type {any} */ (node);
      if (geometry) held.add(geometry);
      for (const each of [material, userData.materials].flat()) {
        if (!each) continue;
        held.add(each);
        for (const value of Object.values(each)) if (value?.isTexture) held.add(value);
      }
    });
  }
  for (const each of held) each.dispose();
}
