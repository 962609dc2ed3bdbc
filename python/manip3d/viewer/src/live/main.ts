// The page of `manip3d phantom live`: a person with a phantom limb, a game, and what is going on.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { Frame, GameStatus, Status } from "./frame";
import { Pedals, Piano } from "./instruments";
import { Link } from "./link";
import { Bones, Bubbles, Colliders, room } from "./overlay";
import { Person } from "./person";
import { Sound } from "./sound";

interface Content {
  limb: string;
  source: string;
  intended_use: string;
  parents: number[];
  asks: boolean; // whether there is a diary that wants to know how strong the pain is
  games: Record<string, { title: string; how: string; rules: string; most_misses: number }>;
}

const content = JSON.parse(document.getElementById("manip3d-live")!.textContent!) as Content;
const VIEW_ANGLE = 40; // degrees, vertical
const SHOWN_M = { width: 1.9, height: 2.2 }; // around the person, at any shape of the window
const WORDS_MS = 500; // between two readings of latency, lest the numbers flicker

const STATES: Record<string, string> = {
  tracking: "Following",
  degraded: "Not reliable",
  holding: "Held",
  fading: "Fading",
  lost: "Not visible",
};

function element<K extends keyof HTMLElementTagNameMap>(
  name: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// --- what stands on the page -----------------------------------------------------------------------

const canvas = element("canvas", { "aria-label": `Person with a phantom ${content.limb}` });
const stateWord = element("strong", { id: "state" }, "Connecting");
const stateText = element("span", { id: "message" }, "Waiting for the first picture.");
const numbers = element("dl", { id: "numbers" });
const gameChoice = element("select", { id: "game" });
for (const [name, { title }] of Object.entries(content.games)) {
  gameChoice.append(element("option", { value: name }, title));
}
const difficulty = element("select", { id: "difficulty" });
["easy", "medium", "hard"].forEach((word, which) =>
  difficulty.append(element("option", { value: String(which + 1) }, word)),
);
const start = element("button", { id: "start", class: "main" }, "Start when ready");
const score = element("div", { id: "score", hidden: "" });
const card = element("section", { id: "card", "aria-live": "polite" });

const toggles = {
  mirror: toggle("Mirror", "m", true),
  skeleton: toggle("Skeleton", "s", false),
  colliders: toggle("Colliders", "c", false),
  tint: toggle("Mark phantom", "p", false),
  large: toggle("Large text", "l", false),
  sound: toggle("Sound", "o", true),
};

function toggle(label: string, key: string, on: boolean): HTMLButtonElement {
  const made = element("button", { "aria-pressed": String(on), title: `Key ${key.toUpperCase()}` });
  made.append(label, element("kbd", {}, key.toUpperCase()));
  made.addEventListener("click", () => {
    made.setAttribute("aria-pressed", String(!isOn(made)));
    settle();
  });
  return made;
}

function isOn(button: HTMLButtonElement): boolean {
  return button.getAttribute("aria-pressed") === "true";
}

const pain = element("select", { id: "pain" });
pain.append(element("option", { value: "" }, "choose"));
for (let value = 0; value <= 10; value++) {
  const word = { 0: "0 (none)", 10: "10 (worst)" }[value] ?? String(value);
  pain.append(element("option", { value: String(value) }, word));
}
const painTold = element("span", { id: "pain-told", role: "status" });
const unwell = element("button", { id: "unwell" }, "I feel sick");
const asking = element(
  "div",
  { class: "row", id: "asking" },
  element("label", {}, "Phantom pain now, 0 to 10 ", pain),
  unwell,
  painTold,
);
asking.hidden = !content.asks;

document.body.append(
  element(
    "header",
    {},
    element("h1", {}, `Phantom ${content.limb}`),
    element("p", { id: "status", role: "status" }, stateWord, " ", stateText),
  ),
  element("main", {}, canvas, score, card),
  element(
    "footer",
    {},
    element(
      "div",
      { class: "row" },
      element("label", {}, "Game ", gameChoice),
      element("label", {}, "Difficulty ", difficulty),
      start,
    ),
    asking,
    element("div", { class: "row", role: "group", "aria-label": "View" }, ...Object.values(toggles)),
    numbers,
    element("p", { id: "use" }, content.intended_use),
  ),
);

// --- the scene -------------------------------------------------------------------------------------

const stillness = matchMedia("(prefers-reduced-motion: reduce)");
const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
const scene = new THREE.Scene();
scene.background = new THREE.Color("#171b22");
scene.add(new THREE.HemisphereLight("#ffffff", "#8090a0", 2.5));
const sun = new THREE.DirectionalLight("#ffffff", 1.5);
sun.position.set(1, 2, 2);
scene.add(sun);
const camera = new THREE.PerspectiveCamera(VIEW_ANGLE, 1, 0.1, 30);
const controls = new OrbitControls(camera, canvas);
const world = new THREE.Group(); // in the camera's frame: x right, y down, z ahead
const person = new Person();
const bones = new Bones(content.parents);
const colliders = new Colliders(content.parents.length);
const bubbles = new Bubbles(() => stillness.matches);
const piano = new Piano();
const pedals = new Pedals();
const sound = new Sound();
const floor = room();
world.add(person.root, bones.root, colliders.root, bubbles.root, piano.root, pedals.root, floor);
scene.add(world);

let placed = false;
let newest: Status | null = null;

/** Puts the person in the middle, once, from in front. */
function place(status: Status): void {
  const middle = status.joints?.[1];
  if (placed || !middle || !status.joint_states?.[1]) return;
  placed = true;
  const ankles = [14, 18].filter((joint) => status.joint_states?.[joint]);
  const lowest = Math.max(...ankles.map((joint) => status.joints![joint][1]), middle[1] + 0.9);
  floor.position.set(middle[0], lowest + 0.08, middle[2]);
  controls.target.set(0, -middle[1] - 0.2, -middle[2]);
  fit();
}

function fit(): void {
  const { clientWidth: width, clientHeight: height } = canvas.parentElement as HTMLElement;
  renderer.setSize(width, height, false);
  camera.aspect = width / Math.max(height, 1);
  camera.updateProjectionMatrix();
  const tangent = Math.tan(THREE.MathUtils.degToRad(VIEW_ANGLE / 2));
  const needed = Math.max(SHOWN_M.height, SHOWN_M.width / camera.aspect) / 2 / tangent;
  const way = camera.position.clone().sub(controls.target);
  if (way.lengthSq() < 1e-6 || !placed) way.set(0, 0.12, 1);
  camera.position.copy(controls.target).addScaledVector(way.normalize(), needed);
  controls.update();
}

/** What the buttons say. */
function settle(): void {
  world.scale.set(isOn(toggles.mirror) ? -1 : 1, -1, -1);
  bones.root.visible = isOn(toggles.skeleton);
  colliders.root.visible = isOn(toggles.colliders);
  person.tint = isOn(toggles.tint);
  sound.on = isOn(toggles.sound);
  document.documentElement.classList.toggle("large", isOn(toggles.large));
  fit();
}

// --- frames ----------------------------------------------------------------------------------------

async function decode(frame: Frame): Promise<void> {
  await person.show(frame);
  newest = frame.status;
  bones.show(frame.status);
  colliders.show(frame.status);
  const game = frame.status.game;
  bubbles.show(content.games[game.name].rules === "piano" ? { ...game, targets: [] } : game);
  piano.show(game);
  pedals.show(game);
  for (const [kind, , , , , , key] of game.events ?? []) sound.event(String(kind), Number(key));
  place(frame.status);
  tell(frame.status);
}

function tell({ state, message, game }: Status): void {
  if (document.body.dataset.state !== state) document.body.dataset.state = state;
  write(stateWord, STATES[state] ?? state);
  write(stateText, message);
  tellGame(game, message);
}

function write(where: HTMLElement, text: string): void {
  if (where.textContent !== text) where.textContent = text; // else screen readers repeat it
}

let phase = "";

function tellGame(game: GameStatus, message: string): void {
  const { title, how, most_misses: most } = content.games[game.name];
  const idle = game.phase === "waiting" || game.phase === "over";
  start.disabled = Boolean(game.halt);
  write(painTold, game.pain === null ? "" : `Noted: ${game.pain}.`);
  if (document.activeElement !== gameChoice) gameChoice.value = game.name;
  if (document.activeElement !== difficulty) difficulty.value = String(game.difficulty);
  const word = idle ? (game.phase === "over" ? "Play again" : "Start when ready") : "Stop";
  if (start.textContent !== word) start.replaceChildren(word);
  score.hidden = game.score === undefined || game.phase === "over";
  if (game.score !== undefined) {
    const left = Math.ceil(game.left_s ?? 0);
    const missed = most ? `Missed ${game.misses} of ${most}` : `Missed ${game.misses}`;
    const balls = (game.strokes ?? []).map((strokes) => Math.floor(strokes)).join(" and ");
    const told = game.needed ? `Strokes ${balls} of ${game.needed}` : missed;
    write(score, `Score ${game.score}   ${told}   ${left} s`);
  }
  const pause = game.phase === "paused" ? `: ${message}` : "";
  const now = `${game.name} ${game.phase} ${pause} ${game.halt}`;
  if (phase === now) return;
  phase = now;
  card.hidden = game.phase === "playing";
  const lines: string[] = [];
  let heading = title;
  if (game.phase === "waiting") lines.push(how, "Press Start, or the space bar, when you are ready.");
  if (game.phase === "starting") lines.push("Stand so that the whole body is seen, facing the camera.");
  if (game.phase === "paused") {
    heading = "Paused";
    lines.push(message, "Nothing is missed while the phantom limb is not followed.");
  }
  if (game.phase === "over") {
    heading = { time: "Time over!", misses: "Game over", done: "Well done!", stopped: "Stopped" }[
      game.ending ?? "time"
    ];
    const missed = content.games[game.name].rules === "pedal" ? "" : `Missed ${game.misses}. `;
    lines.push(
      `Score ${game.score}, of these ${game.by_phantom} with the phantom limb.`,
      `${missed}Paused for ${Math.round(game.paused_s ?? 0)} s.`,
    );
    if (content.asks && !game.halt) lines.push("How strong is the phantom pain now? Say so below.");
  }
  if (game.halt) {
    heading = "Stop for today";
    lines.unshift(game.halt);
  }
  card.replaceChildren(element("h2", {}, heading), ...lines.map((line) => element("p", {}, line)));
}

const link = new Link(decode, (connected) => {
  document.body.dataset.connected = String(connected);
  if (connected) return;
  write(stateWord, "No connection");
  write(stateText, "The program has ended or is starting again; this page will come back by itself.");
});

setInterval(() => {
  const { latencyMs, perSecond, lost, bad, frames } = link.stats();
  const latency = latencyMs
    ? `${latencyMs.p50.toFixed(0)} ms (95 %: ${latencyMs.p95.toFixed(0)} ms)`
    : "-";
  const spent = Object.values(newest?.stage_ms ?? {}).reduce((sum, ms) => sum + ms, 0);
  const told: [string, string][] = [
    ["Latency", latency],
    ["Pictures", `${perSecond.toFixed(0)} per second`],
    ["Left out", `${lost} of ${frames + lost}${bad ? `, ${bad} unreadable` : ""}`],
    ["Computing", `${spent.toFixed(1)} ms a picture`],
  ];
  numbers.replaceChildren(
    ...told.map(([name, value]) =>
      element("div", {}, element("dt", {}, name), element("dd", {}, value)),
    ),
  );
}, WORDS_MS);

// --- what people do --------------------------------------------------------------------------------

function press(): void {
  const current = newest?.game.phase;
  const idle = current === "waiting" || current === "over";
  link.send({ type: idle ? "ready" : "stop" });
}

function choose(): void {
  link.send({ type: "choose", game: gameChoice.value, difficulty: Number(difficulty.value) });
}

pain.addEventListener("change", () => {
  if (pain.value !== "") link.send({ type: "pain", value: Number(pain.value) });
  pain.value = "";
  pain.blur();
});
unwell.addEventListener("click", () => {
  link.send({ type: "unwell" });
  unwell.blur();
});
for (const kind of ["pointerdown", "keydown"]) {
  document.addEventListener(kind, () => sound.wake());
}
start.addEventListener("click", () => {
  press();
  start.blur(); // else the space bar would press it a second time
});
for (const list of [gameChoice, difficulty]) {
  list.addEventListener("change", () => {
    choose();
    list.blur();
  });
}
const keys: Record<string, () => void> = {
  " ": press,
  m: () => toggles.mirror.click(),
  s: () => toggles.skeleton.click(),
  c: () => toggles.colliders.click(),
  p: () => toggles.tint.click(),
  l: () => toggles.large.click(),
  o: () => toggles.sound.click(),
};
document.addEventListener("keydown", (event) => {
  const target = event.target as HTMLElement;
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  if (target instanceof HTMLSelectElement) return;
  if (target instanceof HTMLButtonElement && event.key === " ") return; // presses that button
  const action = keys[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  action();
});

new ResizeObserver(fit).observe(canvas.parentElement as HTMLElement);
settle();
renderer.setAnimationLoop((now) => {
  bubbles.animate(now);
  renderer.render(scene, camera);
});

// For tests and for whoever looks with the browser's own tools.
Object.assign(globalThis, {
  manip3dLive: { stats: () => link.stats(), status: () => newest, sounds: () => sound.played },
});
