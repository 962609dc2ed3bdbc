// The page: reads what Python wrote into it, builds the panes and the toolbar.

import { Film } from "./film.js";
import { Model } from "./model.js";
import { Cloud, legend } from "./points.js";
import { Stage } from "./stage.js";
import css from "./viewer.css";

/**
 * Content of the page, which Python writes into it as JSON.
 * @typedef {object} Page
 * @property {string} title
 * @property {import("./stage.js").View} view
 * @property {import("./stage.js").Place[]} places  to look from; none: all models fit
 * @property {number[][]} ramp  r g b of numbers from low to high
 * @property {import("./model.js").Looks} looks
 * @property {Entry[]} models
 * @property {{size: number[], scale: number, pose: import("./stage.js").Pose, background: string}} [still]
 *   instead of a view, one picture: its PNG's data URL
 * @property {{size: number[], frames: number, seconds: number, pose: import("./stage.js").Pose, background: string}} [timing]
 *   instead of a view, how long frames of all models take
 * @property {{rate: number}} [film]  the models are shown one after the other, so many a second
 */

/**
 * A mesh as `glb`, and `boundary` (float32, x y z of both ends of each edge) in base64; or `points`.
 * @typedef {object} Entry
 * @property {string} label
 * @property {string} detail
 * @property {string} [glb]
 * @property {string} [boundary]
 * @property {import("./points.js").Entry} [points]
 */

const MESH_SWITCHES = /** @type {const} */ ([
  ["texture", "t", "Texture", "Materials, textures and colours"],
  ["wireframe", "w", "Wireframe", "The triangles' edges"],
  ["flat", "f", "Flat", "One shade for each triangle"],
  ["boundary", "b", "Boundary", "Edges that exactly one face uses, in red"],
  ["backfaces", "k", "Back faces", "Faces seen from behind"],
]);
const POINT_SWITCHES = /** @type {const} */ ([
  ["axes", "a", "Axes", "The coordinate axes"],
  ["lines", "l", "Lines", "Boxes and bones"],
]);
const HELP = [
  ["drag, arrow keys", "turn"],
  ["wheel, pinch, + −", "nearer, farther"],
  ["right drag, two fingers, shift + arrow keys", "move"],
  ["R", "first view"],
  ["[ ]", "smaller, larger points"],
  ["D", "dark or light"],
  ["?", "this list"],
];
const FILM_HELP = [["space", "play or stop"]];
const TURN = 0.1; // radians for each press of an arrow key
const NEARER = 0.9; // times the distance
const SHIFT = 30; // pixels
const LARGER = 1.25; // times the width of points

/**
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag @param {Record<string, string>} attributes @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

/** @param {string} base64 */
function bytes(base64) {
  const text = atob(base64);
  const array = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) array[i] = text.charCodeAt(i);
  return array.buffer;
}

function hasWebGL() {
  return document.createElement("canvas").getContext("webgl2") !== null;
}

/** @param {Page} page */
async function start(page) {
  const message = element("p", { class: "message", role: "status" }, "Loading…");
  const canvas = element("canvas", { role: "img", "aria-label": labelOf(page) });
  const panes = (page.film ? page.models.slice(0, 1) : page.models).map((entry) =>
    element("figure", {}, element("figcaption", {}, ...caption(entry))),
  );
  const area = element("main", { class: "area" }, canvas, ...panes, message);
  const bar = element("header", {}, element("h1", {}, page.title));
  const switches = switchesOf(page.models);
  const help = helpDialog(switches, page.film ? FILM_HELP : []);
  document.head.append(element("style", {}, css));
  document.body.append(bar, area, help);

  if (!hasWebGL()) {
    message.textContent =
      "This browser offers no WebGL 2, which the view needs. Switch on hardware acceleration " +
      "in its settings, or open the page in another browser.";
    return undefined;
  }
  const models = await Promise.all(page.models.map((entry) => load(entry, page.ramp)));
  const stage = new Stage(canvas, panes, models, page.view, page.places);
  if (page.still) return still(stage, page.looks, page.still);
  if (page.timing) return timing(stage, page.looks, page.timing);
  message.remove();
  /** @type {Record<string, () => void>} */
  const actions = {};
  if (page.film) actions[" "] = addFilm(page, stage, area);
  addToolbar(bar, stage, page.looks, help, switches, actions);
  addManners(area, stage);
  return undefined;
}

/**
 * The text by which a screen reader names the view.
 * @param {Page} page
 */
function labelOf({ title, models, film }) {
  const labels = models.map(({ label }) => label).filter(Boolean).join(", ");
  const shown = (!film && labels) || title;
  return shown ? `3D view of ${shown}` : "3D view";
}

/** @param {Entry} entry */
function caption({ label, detail }) {
  return [element("b", {}, label), " ", detail];
}

/**
 * The bar of a film under its picture.
 * @param {Page} page @param {Stage} stage @param {HTMLElement} area
 * @returns {() => void}  plays, or stops
 */
function addFilm({ models, film }, stage, area) {
  const text = /** @type {HTMLElement} */ (stage.panes[0].querySelector("figcaption"));
  const button = element("button", { title: "Play or stop (space)" });
  const slider = element("input", {
    type: "range",
    min: "0",
    max: String(models.length - 1),
    "aria-label": "Frame",
  });
  const place = element("output");
  const reel = new Film(models.length, film?.rate ?? 1, (frame, isPlaying) => {
    stage.turn = frame;
    slider.value = String(frame);
    place.textContent = `${frame + 1} of ${models.length}`;
    button.textContent = isPlaying ? "Stop" : "Play";
    text.replaceChildren(...caption(models[frame]));
    stage.requestDraw();
  });
  button.addEventListener("click", () => reel.toggle());
  slider.addEventListener("input", () => reel.show(slider.valueAsNumber));
  area.after(element("footer", {}, button, slider, place));
  return () => reel.toggle();
}

/** @param {Entry} entry @param {number[][]} ramp @returns {Promise<Model | Cloud>} */
async function load({ glb, boundary, points }, ramp) {
  if (points) return new Cloud(points, bytes, ramp);
  return Model.load(bytes(glb ?? ""), new Float32Array(bytes(boundary ?? "")));
}

/** Those that have something to switch. @param {Entry[]} entries */
function switchesOf(entries) {
  const clouds = entries.flatMap(({ points }) => points ?? []);
  const hasLines = clouds.some(({ lines }) => lines.length);
  return [
    ...(clouds.length < entries.length ? MESH_SWITCHES : []),
    ...(clouds.length ? POINT_SWITCHES : []).filter(([name]) => name !== "lines" || hasLines),
  ];
}

/**
 * @param {Stage} stage @param {import("./model.js").Looks} looks
 * @param {NonNullable<Page["still"]>} settings
 */
function still(stage, looks, { size, scale, pose, background }) {
  for (const model of stage.models) {
    if (model instanceof Cloud) model.ratio = scale;
    model.show(looks);
  }
  stage.setBackground(background);
  stage.setPose(pose);
  return stage.picture(size[0], size[1]);
}

/**
 * @param {Stage} stage @param {import("./model.js").Looks} looks
 * @param {NonNullable<Page["timing"]>} settings
 */
function timing(stage, looks, { size, frames, seconds, pose, background }) {
  for (const model of stage.models) model.show(looks);
  stage.setBackground(background);
  stage.setPose(pose);
  return stage.frameTimes(size[0], size[1], frames, seconds);
}

/** @typedef {ReturnType<typeof switchesOf>} Switches */

/** @param {Switches} switches @param {string[][]} more */
function helpDialog(switches, more) {
  const keys = switches.map(([, key, , what]) => [key.toUpperCase(), what]);
  const rows = [...more, ...keys, ...HELP].map(([keys, what]) =>
    element("tr", {}, element("th", {}, keys), element("td", {}, what)),
  );
  const close = element("button", {}, "Close");
  const help = element("dialog", { "aria-label": "Keys" }, element("table", {}, ...rows), close);
  close.addEventListener("click", () => help.close());
  return help;
}

/**
 * @param {HTMLElement} bar @param {Stage} stage @param {import("./model.js").Looks} looks
 * @param {HTMLDialogElement} help @param {Switches} switches
 * @param {Record<string, () => void>} actions  by key
 */
function addToolbar(bar, stage, looks, help, switches, actions) {
  const update = () => {
    for (const model of stage.models) model.show(looks);
    showLegends(stage, looks);
    stage.requestDraw();
  };
  addChoices(bar, stage, update);
  for (const [name, key, label, what] of switches) {
    const button = element("button", { title: `${what} (${key.toUpperCase()})` }, label);
    actions[key] = () => {
      looks[name] = !looks[name];
      button.setAttribute("aria-pressed", String(looks[name]));
      update();
    };
    button.setAttribute("aria-pressed", String(looks[name]));
    button.addEventListener("click", actions[key]);
    bar.append(button);
  }
  if (stage.models.some((model) => model instanceof Cloud)) {
    for (const [key, label, what, factor] of /** @type {const} */ ([
      ["[", "•−", "Smaller points ([)", 1 / LARGER],
      ["]", "•+", "Larger points (])", LARGER],
    ])) {
      const button = element("button", { title: what, "aria-label": what }, label);
      actions[key] = () => {
        looks.size = Math.min(Math.max(looks.size * factor, 0.2), 10);
        update();
      };
      button.addEventListener("click", actions[key]);
      bar.append(button);
    }
  }
  actions.r = () => stage.fit();
  actions.d = () => setTheme(stage, theme() === "dark" ? "light" : "dark");
  actions["?"] = () => (help.open ? help.close() : help.showModal());
  for (const [key, label, what] of [
    ["r", "Reset", "First view (R)"],
    ["d", "◐", "Dark or light (D)"],
    ["?", "?", "Keys (?)"],
  ]) {
    // A word names its button itself; a symbol needs a name.
    const name = /** @type {Record<string, string>} */ (/^\w/.test(label) ? {} : { "aria-label": what });
    const button = element("button", { title: what, ...name }, label);
    button.addEventListener("click", actions[key]);
    bar.append(button);
  }
  addKeys(stage, actions);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => setTheme(stage));
  setTheme(stage);
  update();
}

/** Lists of columns that colour points and of places to look from. @param {HTMLElement} bar @param {Stage} stage @param {() => void} update */
function addChoices(bar, stage, update) {
  const clouds = stage.models.flatMap((model) => (model instanceof Cloud ? model : []));
  const names = new Set(clouds.flatMap(({ columns }) => columns.map(({ name }) => name)));
  if (names.size > 1) {
    const choice = select("Show", [...names]);
    choice.addEventListener("change", () => {
      for (const cloud of clouds) cloud.colorBy(choice.value);
      update();
    });
    bar.append(choice);
  }
  if (stage.places.length > 1) {
    const choice = select("From", stage.places.map(({ name }) => name));
    choice.addEventListener("change", () => {
      stage.place = stage.places[choice.selectedIndex];
      stage.fit();
    });
    bar.append(choice);
  }
}

/** @param {string} what @param {string[]} names */
function select(what, names) {
  const options = names.map((name) => element("option", { value: name }, `${what}: ${name}`));
  return element("select", { title: what, "aria-label": what }, ...options);
}

/** @param {Stage} stage @param {import("./model.js").Looks} looks */
function showLegends(stage, looks) {
  stage.models.forEach((model, index) => {
    if (!(model instanceof Cloud)) return;
    stage.panes[index].querySelector(".legend")?.remove();
    stage.panes[index].append(legend(model, looks.axes, looks.lines, element));
  });
}

/** @param {Stage} stage @param {Record<string, () => void>} actions  by key */
function addKeys(stage, actions) {
  const { controls } = stage;
  /** @type {Record<string, [number, number]>} */
  const arrows = {
    ArrowLeft: [1, 0],
    ArrowRight: [-1, 0],
    ArrowUp: [0, 1],
    ArrowDown: [0, -1],
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return; // the browser's own
    // Lists have keys of their own; of the time bar only the arrow keys are, not space and letters.
    if (event.target instanceof HTMLSelectElement) return;
    if (event.target instanceof HTMLInputElement && event.key in arrows) return;
    if (event.key === " " && event.target instanceof HTMLButtonElement) return;
    stage.held ||= event.key in arrows || "+=-".includes(event.key);
    if (event.key in arrows) {
      const [x, y] = arrows[event.key];
      if (event.shiftKey) controls.pan(x * SHIFT, y * SHIFT);
      else if (x) controls.rotateLeft(x * TURN);
      else controls.rotateUp(y * TURN);
    } else if (event.key === "+" || event.key === "=") controls.dollyIn(NEARER);
    else if (event.key === "-") controls.dollyOut(NEARER);
    else if (event.key.toLowerCase() in actions) actions[event.key.toLowerCase()]();
    else return;
    event.preventDefault();
  });
}

/** @returns {"dark" | "light"} */
function theme() {
  const chosen = document.documentElement.dataset.theme;
  if (chosen === "dark" || chosen === "light") return chosen;
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

/** @param {Stage} stage @param {string} [chosen] */
function setTheme(stage, chosen) {
  if (chosen) document.documentElement.dataset.theme = chosen;
  stage.setBackground(getComputedStyle(document.body).backgroundColor);
}

/** @param {HTMLElement} area @param {Stage} stage */
function addManners(area, stage) {
  if (window.parent !== window) {
    // In a notebook or report the wheel scrolls the page until somebody takes hold of the model.
    stage.controls.enableZoom = false;
    area.addEventListener("pointerdown", () => (stage.controls.enableZoom = true));
    area.addEventListener("pointerleave", () => (stage.controls.enableZoom = false));
  }
  const asleep = element("p", { class: "message" }, "The browser took the view's memory for another. Reload to see it.");
  stage.canvas.addEventListener("webglcontextlost", () => area.append(asleep));
  stage.canvas.addEventListener("webglcontextrestored", () => {
    asleep.remove();
    stage.requestDraw();
  });
}

const source = /** @type {HTMLElement} */ (document.getElementById("manip3d-page"));
const page = JSON.parse(/** @type {string} */ (source.textContent));
// For whoever steers the page from outside: settled when it shows its models.
Object.assign(window, {
  manip3d: start(page).catch((error) => {
    const message = document.querySelector(".message") ?? document.body;
    message.textContent = `The model cannot be shown: ${error.message}`;
    throw error;
  }),
});
