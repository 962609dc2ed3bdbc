// The page of a study: shows one step at a time, and keeps an answer until the server has stored it.

import { Turntable } from "./turntable.js";

const AGAIN_MS = 1000;
const STORE_AGAIN_MS = 5000; // until a full disk is asked again
const REFUSED = [1007, 1008, 1009]; // the server has read what was sent, and does not take it
const CARD_RATIO = 53.98 / 85.6; // of a bank card [ISO/IEC 7810, ID-1]

/**
 * @typedef {object} Field
 * @property {string} name
 * @property {string} label
 * @property {"choice" | "scale" | "number" | "text" | "card"} type
 * @property {[string, string][]} choices
 * @property {number} low
 * @property {number} high
 * @property {[string, string]} ends
 * @property {boolean} optional
 * @property {boolean} is_side
 */

/**
 * @typedef {object} Step
 * @property {string} id
 * @property {string} title
 * @property {string[]} text
 * @property {Field[]} fields
 * @property {{address: string, type: "image" | "video" | "mesh"}[]} stimuli
 * @property {number} width_px
 * @property {number} turn_s
 * @property {number} minimum_s
 * @property {string} button
 * @property {number} progress
 * @property {string} participant
 */

const main = /** @type {HTMLElement} */ (document.getElementById("study"));
const banner = make("p", { id: "banner", hidden: true, role: "status" });
const stage = make("div", { id: "step" });
main.append(banner, stage);

/** @type {WebSocket | null} */
let socket = null;
/** @type {{step: string, message: object} | null} an answer that the server has not stored yet */
let pending = null;
/** @type {Step | null} */
let shown = null;
/** @type {Turntable | null} */
let turntable = null;
let generation = 0; // of what is shown
let isHeard = false; // whether the server has said anything on this connection
let refusal = ""; // why the last answer was not taken
let code = ""; // with which somebody has begun last
/** @type {ReturnType<typeof setTimeout> | undefined} */
let storesAgain;

/** @param {string} tag @param {object} attributes @param {(Node | string)[]} children */
function make(tag, attributes = {}, ...children) {
  const element = Object.assign(document.createElement(tag), attributes);
  element.append(...children);
  return element;
}

/** @param {object} message */
function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

/** @param {string} text */
function tell(text) {
  banner.textContent = text;
  banner.hidden = !text;
}

/** Say who is there, and before which screen: its scale was measured once. */
function greet() {
  const screen_ = { screen_px: screen.width, pixel_ratio: devicePixelRatio };
  send(code ? { type: "begin", participant: code, ...screen_ } : { type: "hello", ...screen_ });
}

function connect() {
  clearTimeout(storesAgain);
  socket = new WebSocket(`ws://${location.host}/stream`);
  isHeard = false;
  socket.addEventListener("open", () => {
    tell(refusal);
    code = sessionStorage.getItem("participant") ?? "";
    greet();
  });
  socket.addEventListener("message", ({ data }) => {
    isHeard = true;
    take(JSON.parse(data));
  });
  socket.addEventListener("close", ({ code: status, reason }) => {
    if (REFUSED.includes(status)) refuse(reason);
    else tell("No connection. Your answers are kept; the study goes on when it is back.");
    setTimeout(connect, AGAIN_MS);
  });
}

/** Drop an answer that was refused: it would be refused again. @param {string} reason */
function refuse(reason) {
  if (pending) {
    refusal = `Your answer was not taken. Please change it, then go on. (${reason || "too long"})`;
  }
  pending = null;
  if (!isHeard) sessionStorage.removeItem("participant"); // the code itself
  tell(refusal);
}

/** @param {any} message */
function take(message) {
  clearTimeout(storesAgain);
  if (message.type === "problem") {
    tell(message.text);
    storesAgain = setTimeout(() => (pending ? send(pending.message) : greet()), STORE_AGAIN_MS);
    return;
  }
  if (message.participant) sessionStorage.setItem("participant", message.participant);
  if (message.type === "who") showWho(message);
  else if (message.type === "end") showEnd(message);
  else if (message.type === "step") {
    if (pending && pending.step === message.id) {
      send(pending.message); // it was not stored when the connection broke
      return;
    }
    pending = null;
    if (shown?.id === message.id) {
      unlock(); // what is typed stays
      return;
    }
    refusal = "";
    tell("");
    showStep(message);
  }
}

/** @param {...Node} nodes */
function replace(...nodes) {
  turntable?.stop();
  generation += 1;
  stage.replaceChildren(...nodes);
  scrollTo(0, 0);
}

function showWho({ title, problem }) {
  shown = null;
  code = "";
  sessionStorage.removeItem("participant");
  const typed = make("input", { name: "participant", required: true, maxLength: 32 });
  Object.assign(typed, { pattern: "[A-Za-z0-9][A-Za-z0-9_\\-]*", autocomplete: "off" });
  const form = make(
    "form",
    {},
    make("h1", {}, title),
    make("label", {}, "Your participant code", typed),
    make("p", { className: "quiet" }, "If you were interrupted, the same code takes you back."),
    make("button", { type: "submit", id: "continue" }, "Begin"),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    code = typed.value.trim();
    greet();
  });
  replace(form);
  tell(problem ?? "");
  typed.focus();
}

function showEnd({ declined }) {
  shown = null;
  pending = null;
  code = "";
  sessionStorage.removeItem("participant"); // the next one begins with their own code
  replace(
    make("h1", { id: "end" }, declined ? "You did not agree" : "Thank you"),
    make("p", {}, declined ? "Nothing was asked, and nothing else is stored." :
      "That was all. Your answers are stored. You can close this page."),
  );
}

/** @param {Step} step */
function showStep(step) {
  shown = step;
  const form = make("form", { id: "form" });
  form.append(
    make("div", { id: "progress" }, bar(step.progress)),
    make("h1", { tabIndex: -1 }, step.title),
    ...step.text.map((text) => make("p", {}, text)),
  );
  const sides = step.fields.find((field) => field.is_side);
  const others = step.fields.filter((field) => field !== sides);
  const asked = make("div", { id: "asked" }, ...others.flatMap((field) => question(field)));
  const button = make("button", { type: "submit", id: "continue" }, step.button);
  if (sides) button.hidden = others.length === 0;
  replace(form);
  // Screen readers read the new step, and the tabulator key goes on from its beginning.
  form.querySelector("h1")?.focus();
  const media = step.stimuli.length ? show(step, sides, form) : Promise.resolve();
  form.append(asked, make("p", { id: "wait", className: "quiet", hidden: true }), button);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    answer(step, form);
  });
  lock(form, true);
  const now = generation;
  media.then(
    () => now === generation && begin(step, form),
    () => now === generation && tell("The picture could not be shown. Call the researcher."),
  );
}

/** @param {number} share */
function bar(share) {
  const done = make("div", {});
  done.style.width = `${Math.round(100 * share)}%`;
  return done;
}

/** The step is there to be seen: the clock starts. @param {Step} step @param {HTMLElement} form */
function begin(step, form) {
  form.dataset.began = String(performance.now());
  if (!(step.minimum_s > 0)) {
    openStep(form);
    return;
  }
  const wait = /** @type {HTMLElement} */ (form.querySelector("#wait"));
  wait.hidden = false;
  const end = performance.now() + 1000 * step.minimum_s + 100; // never before the server's clock
  const now = generation;
  const tick = () => {
    if (now !== generation) return;
    const left = Math.max(0, Math.ceil((end - performance.now()) / 1000));
    const minutes = Math.floor(left / 60);
    wait.textContent = `${minutes}:${String(left % 60).padStart(2, "0")} left`;
    if (performance.now() < end) setTimeout(tick, Math.min(250, end - performance.now()));
    else {
      wait.hidden = true;
      openStep(form);
    }
  };
  tick();
}

/** The step can be answered from now on. @param {HTMLElement} form */
function openStep(form) {
  form.dataset.open = "true";
  lock(form, false);
}

/** @param {HTMLElement} form @param {boolean} locked */
function lock(form, locked) {
  for (const button of form.querySelectorAll("button")) button.disabled = locked;
}

/** The step that is shown can be answered again, unless its time has not come yet. */
function unlock() {
  const form = document.getElementById("form");
  if (form?.dataset.open) lock(form, false);
  tell(refusal);
}

/** @param {Field} field @returns {Node[]} */
function question(field) {
  if (field.type === "choice" || field.type === "scale") return [options(field)];
  const label = make("label", {}, field.label + (field.optional ? " (may be left empty)" : ""));
  if (field.type === "text") {
    const area = make("textarea", { name: field.name, maxLength: 2000, required: !field.optional });
    area.addEventListener("input", () => area.setCustomValidity(""));
    label.append(area);
  } else if (field.type === "number") {
    const input = make("input", { name: field.name, type: "number", required: !field.optional });
    Object.assign(input, { min: field.low, max: field.high, step: "any", inputMode: "decimal" });
    label.append(input);
  } else {
    const input = make("input", { name: field.name, type: "range" });
    const most = Math.min(field.high, stage.clientWidth); // a card must be seen whole
    Object.assign(input, { min: field.low, max: most, step: 0.5, value: 324 });
    const card = make("div", { className: "card" }, "card");
    const draw = () => {
      card.style.width = `${input.value}px`;
      card.style.height = `${Number(input.value) * CARD_RATIO}px`;
    };
    input.addEventListener("input", draw);
    draw();
    label.append(input, card);
  }
  return [label];
}

/** Buttons of which one can be chosen. @param {Field} field */
function options(field) {
  const group = make("fieldset", { className: field.type });
  if (field.label) group.append(make("legend", {}, field.label));
  const choices =
    field.type === "choice"
      ? field.choices
      : Array.from({ length: field.high - field.low + 1 }, (_, i) => {
          const score = String(field.low + i);
          return [score, score];
        });
  const row = make("div", { className: "options" });
  for (const [value, label] of choices) {
    const input = make("input", { type: "radio", name: field.name, value });
    input.required = !field.optional;
    row.append(make("label", {}, input, make("span", {}, label)));
  }
  group.append(row);
  if (field.type === "scale") {
    const [low, high] = field.ends;
    group.append(
      make(
        "p",
        { className: "ends" },
        make("span", {}, `${field.low}: ${low}`),
        make("span", {}, `${field.high}: ${high}`),
      ),
    );
  }
  return group;
}

/**
 * The stimuli in a row, each with its button if one is to be chosen.
 * @param {Step} step @param {Field | undefined} sides @param {HTMLElement} form
 * @returns {Promise<unknown>} resolved when all are there to be seen
 */
function show(step, sides, form) {
  const row = make("div", { id: "stimuli", className: `of${step.stimuli.length}` });
  form.append(row);
  const panes = step.stimuli.map((stimulus, place) => {
    const pane = make("div", { className: `stimulus ${stimulus.type}` });
    const cell = make("div", { className: "cell" }, pane);
    if (step.width_px) pane.style.width = `min(100%, ${step.width_px}px)`;
    row.append(cell);
    if (sides) {
      const [value, label] = sides.choices[place];
      const button = make("button", { type: "button", value, name: sides.name }, label);
      button.dataset.side = value;
      button.addEventListener("click", () => answer(step, form, { [sides.name]: value }));
      cell.append(button);
    }
    return pane;
  });
  if (sides) row.before(make("p", { id: "task" }, sides.label));
  const meshes = step.stimuli.filter(({ type }) => type === "mesh");
  if (meshes.length) {
    turntable ??= new Turntable();
    return turntable.show(row, panes, meshes.map(({ address }) => address), step.turn_s);
  }
  return Promise.all(step.stimuli.map((stimulus, place) => picture(stimulus, panes[place])));
}

/** @param {{address: string, type: string}} stimulus @param {HTMLElement} pane */
function picture({ address, type }, pane) {
  return new Promise((done, failed) => {
    if (type === "video") {
      const video = make("video", { muted: true, loop: true, autoplay: true, playsInline: true });
      video.addEventListener("canplaythrough", done, { once: true });
      video.addEventListener("error", failed);
      video.src = address;
      pane.append(video);
    } else {
      const image = make("img", { alt: "" });
      image.addEventListener("load", done);
      image.addEventListener("error", failed);
      image.src = address;
      pane.append(image);
    }
  });
}

/** A text as the server takes it: without control characters and halves of characters. */
function plain(/** @type {string} */ text) {
  return text
    .replace(/\r\n?/g, "\n")
    .replace(/[\u0000-\u0009\u000b-\u001f\u007f-\u009f]/g, " ")
    .replace(/[\ud800-\udfff]/gu, "");
}

/**
 * Clean what was typed; a text that is asked for needs more than spaces.
 * @param {Step} step @param {HTMLElement} form
 */
function clean(step, form) {
  const optional = new Set(step.fields.filter((field) => field.optional).map(({ name }) => name));
  for (const area of form.querySelectorAll("textarea")) {
    area.value = plain(area.value);
    const isMissing = !optional.has(area.name) && !area.value.trim();
    area.setCustomValidity(isMissing ? "Please write something." : "");
  }
}

/** @param {Step} step @param {HTMLFormElement} form @param {Record<string, string>} chosen */
function answer(step, form, chosen = {}) {
  if (pending || !form.dataset.open) return;
  clean(step, form);
  if (!form.reportValidity()) return;
  refusal = "";
  tell("");
  const given = new FormData(form);
  /** @type {Record<string, string | number>} */
  const message = {
    type: "answer",
    step: step.id,
    elapsed_ms: Math.max(0, performance.now() - Number(form.dataset.began)),
    shown_px: document.querySelector(".stimulus")?.getBoundingClientRect().width ?? 0,
  };
  for (const field of step.fields) {
    const value = chosen[field.name] ?? String(given.get(field.name) ?? "");
    const isNumber = field.type !== "choice" && field.type !== "text" && !field.optional;
    message[`answer.${field.name}`] = isNumber ? Number(value) : value;
  }
  pending = { step: step.id, message };
  lock(form, true);
  send(message);
}

connect();

// For tests: what is shown.
Object.assign(window, {
  manip3dStudy: {
    step: () => shown,
    pending: () => pending !== null,
    turn: () => turntable?.angle,
    turntable: () => turntable,
  },
});
