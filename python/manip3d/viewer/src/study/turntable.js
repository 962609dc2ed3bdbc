// Meshes side by side that turn round together, once; then they stand still.

import { Model } from "../model.js";
import { Stage } from "../stage.js";

const NO_LINES = new Float32Array();
const PAPER = "#f4f5f7";
const VIEW_ANGLE = 30; // degrees
const RADIUS = 0.5; // of a model, placed at the origin with a bounding box of diagonal 1
const ELEVATION = 15; // degrees
const LATE_MS = 100; // after a turn, until it ends without the browser's next picture

/** @param {number} degrees */
function radians(degrees) {
  return (degrees * Math.PI) / 180;
}

/** One for the whole study: a graphics context takes long to make. */
export class Turntable {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.angle = 0; // radians
    /** @type {Stage | null} */
    this.stage = null;
    this.shown = 0; // counts what is shown
    addEventListener("resize", () => this.canvas.isConnected && this.stage?.resize());
  }

  /**
   * @param {HTMLElement} row  holds the panes @param {HTMLElement[]} panes
   * @param {string[]} addresses  of GLB files @param {number} seconds  for one turn
   * @returns {Promise<void>} resolved when they have turned round
   */
  async show(row, panes, addresses, seconds) {
    const shown = ++this.shown;
    this.angle = 0;
    const models = await Promise.all(
      addresses.map(async (address) => {
        const answer = await fetch(address);
        if (!answer.ok) throw new Error(`${answer.status}`);
        return Model.load(await answer.arrayBuffer(), NO_LINES);
      }),
    );
    if (shown !== this.shown) return;
    const looks = { texture: true, flat: false, wireframe: false, boundary: false };
    for (const model of models) {
      model.show({ ...looks, backfaces: true, axes: false, lines: false, size: 1 });
    }
    row.prepend(this.canvas);
    this.#place(panes, models);
    const began = performance.now();
    await new Promise((done) => {
      const turn = () => {
        if (shown !== this.shown) return;
        const share = seconds > 0 ? Math.min(1, (performance.now() - began) / (1000 * seconds)) : 1;
        this.angle = 2 * Math.PI * share;
        for (const model of models) model.root.rotation.y = this.angle;
        this.stage?.draw();
        if (share < 1) requestAnimationFrame(turn);
        else done(undefined);
      };
      turn();
      // A window that others cover draws nothing, and would never end the turn.
      setTimeout(turn, 1000 * seconds + LATE_MS);
    });
  }

  /** Nothing is shown any more. */
  stop() {
    this.shown += 1;
  }

  /** @param {HTMLElement[]} panes @param {Model[]} models */
  #place(panes, models) {
    if (this.stage) {
      for (const model of this.stage.models) {
        this.stage.scene.remove(model.root);
        release(model.root);
      }
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

/** Frees what the graphics card holds of a model. @param {import("three").Object3D} root */
function release(root) {
  root.traverse((node) => {
    const { geometry, material, userData } = /** @type {any} */ (node);
    geometry?.dispose();
    for (const each of [material, ...(userData.materials ?? [])]) {
      each?.map?.dispose();
      each?.dispose?.();
    }
  });
}
