// The page of `manip3d phantom live`: a person with a phantom limb, a game, controls and state.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { lead, letGo, takesKey, takesText } from "./focus";
import type { Frame, GameStatus, Status } from "./frame";
import { Pedals, Piano } from "./instruments";
import { Link } from "./link";
import { Bones, Bubbles, Colliders, Cues, room } from "./overlay";
import { Person } from "./person";
import { Haptics } from "./haptics";
import { Panel } from "./panel";
import { element, plain, write, type Message } from "./parts";
import { Setup, type SetupContent } from "./setup";
import { TouchPanel, type TouchContent } from "./touch";
import { Sound } from "./sound";
import { hasHeadset, Views, WAYS, type Way } from "./views";

interface Content extends SetupContent, TouchContent {
  limb: string;
  source: string;
  parents: number[];
  games: Record<string, { title: string; how: string; rules: string; most_misses: number }>;
}

const content = JSON.parse(document.getElementById("manip3d-live")!.textContent!) as Content;
const VIEW_ANGLE = 40; // vertical field of view, degrees
const OWN_ANGLE = 75; // the same in the view from the patient's own eyes
const SHOWN_M = { width: 1.9, height: 2.2 }; // region around the person that any window shows
const ARM_M = 0.8; // distance of the screen plane of a 3D television from the patient's own eyes
const TURN = 0.004; // radians of rotation per dragged pixel
const SILENT_S = 3; // without a picture for this long, the page says so
const CODE_MS = 120_000; // validity of a code for another screen
const WORDS_MS = 500; // between two updates of the latency, so that the numbers can be read

const HOLD = "To end this session, hold the grip of a controller for a second.";
const BLIND =
  "This browser draws no 3D pictures (WebGL). Switch on hardware acceleration in its settings, or " +
  "open the page in another browser: choose Add a screen below.";
const LOST = "The graphics card has stopped drawing; the picture comes back by itself.";
const HATCHED = "What the camera cannot see is hatched.";
const STATES: Record<string, string> = {
  tracking: "Following",
  degraded: "Not reliable",
  holding: "Held",
  fading: "Fading",
  lost: "Not visible",
};

// --- elements of the page --------------------------------------------------------------------------

const canvas = element("canvas", { role: "img", "aria-label": `Person with a phantom ${content.limb}` });
const blind = element("p", { id: "blind", role: "alert" });
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
const gain = element("select", { id: "gain" });
for (const value of ["1", "1.25", "1.5", "2"]) {
  gain.append(element("option", { value }, value === "1" ? "as it is" : `${value} times`));
}
gain.addEventListener("change", () => {
  link.send({ type: "gain", value: Number(gain.value) });
  letGo(gain);
});
const start = element("button", { id: "start", class: "main", disabled: "" }, "Start when ready");
const score = element("div", { id: "score", hidden: "" });
const card = element("section", { id: "card", "aria-live": "polite" });

const way = element("select", { id: "way" });
for (const [value, word] of [["screen", "Screen"], ["side-by-side", "3D television, side by side"]]) {
  way.append(element("option", { value }, word));
}
const headset = element("button", { id: "headset", hidden: "" }, "Enter headset");
const headsetTold = element("span", { id: "headset-told", role: "status" });

const addScreen = element("button", { id: "add-screen" }, "Add a screen");
const screenTold = element("span", { id: "screen-told", role: "status" });

const toggles = {
  own: toggle("Own eyes", "e", false),
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

const pain = element("select", { id: "pain", required: "" });
pain.append(element("option", { value: "" }, "choose"));
for (let value = 0; value <= 10; value++) {
  const word = { 0: "0 (none)", 10: "10 (worst)" }[value] ?? String(value);
  pain.append(element("option", { value: String(value) }, word));
}
const painTold = element("span", { id: "pain-told", role: "status" });
// A rating is sent by a button, since arrow keys change the selected value of the list.
const rating = element(
  "form",
  { id: "rating", class: "row" },
  element("label", {}, "Phantom pain now, 0 to 10 ", pain),
  element("button", { id: "say-pain" }, "Say it"),
);
// Lets the therapist end the session of a patient who gives no last rating.
const unanswered = element(
  "button",
  { id: "unanswered", type: "button", hidden: "" },
  "Close without a rating",
);
rating.append(unanswered);
const enough = element("button", { id: "enough" }, "End this session", element("kbd", {}, "Q"));
const enoughTold = element("span", { id: "enough-told", role: "status" });
const unwell = element("button", { id: "unwell" }, "I feel sick");
const sure = element("span", { id: "sure", hidden: "", role: "group", "aria-label": "Are you sure?" });
const isSick = element("button", { id: "sick" }, "Yes, no more today");
const isWell = element("button", { id: "well" }, "No");
sure.append("Stop for the whole day? ", isSick, " ", isWell);
const event = element("input", { id: "event", maxlength: "500", placeholder: "what, in words" });
const note = element("button", { id: "note" }, "Note it");
const noting = element(
  "form",
  { id: "noting", class: "row" },
  element("label", {}, "Something bad happened ", event),
  note,
);
const eventTold = element("span", { id: "event-told", role: "status" });
const asking = element(
  "div",
  { class: "row", id: "asking" },
  rating,
  painTold,
  unwell,
  sure,
  noting,
  eventTold,
);
asking.hidden = !content.asks;

const setup = new Setup(
  content,
  (message) => link.send(message),
  (message) => link.keep(message),
  tellPanels,
);
const touching = new TouchPanel(
  content,
  (message) => link.send(message),
  (message) => link.keep(message),
  tellPanels,
);
const openSetup = element("button", { id: "open-setup" }, "Set up", element("kbd", {}, "U"));
const openTouch = element("button", { id: "open-touch" }, "Touch", element("kbd", {}, "T"));
openSetup.addEventListener("click", () => {
  touching.root.hidden = true;
  if (setup.isOpen) setup.close();
  else setup.open();
  tellPanels();
});
openTouch.addEventListener("click", () => {
  if (setup.isOpen) setup.close();
  touching.root.hidden = !touching.root.hidden;
  tellPanels();
});

/** Hides the card about the game while a panel is open. */
function tellPanels(): void {
  document.body.dataset.panel = String(setup.isOpen || !touching.root.hidden);
  openSetup.setAttribute("aria-pressed", String(setup.isOpen));
  openTouch.setAttribute("aria-pressed", String(!touching.root.hidden));
}

const title = element("h1", {}, `Phantom ${content.limb}`);
document.body.append(
  element(
    "header",
    {},
    title,
    element("p", { id: "status", role: "status" }, stateWord, " ", stateText),
  ),
  element("main", {}, canvas, blind, score, card, setup.root, touching.root),
  element(
    "footer",
    {},
    element(
      "div",
      { class: "row" },
      element("label", {}, "Game ", gameChoice),
      element("label", {}, "Difficulty ", difficulty),
      element("label", {}, "Movement ", gain),
      start,
      openSetup,
      openTouch,
      enough,
      enoughTold,
    ),
    asking,
    element(
      "div",
      { class: "row", role: "group", "aria-label": "View" },
      element("label", {}, "View ", way),
      headset,
      headsetTold,
      ...Object.values(toggles),
      addScreen,
      screenTold,
    ),
    numbers,
    element(
      "p",
      { id: "use" },
      `${content.intended_use} `,
      element("a", { href: "/hazards", target: "_blank" }, "Hazards"),
    ),
  ),
);

// --- the scene -------------------------------------------------------------------------------------

const stillness = matchMedia("(prefers-reduced-motion: reduce)");
const renderer = drawing();
renderer?.setPixelRatio(Math.min(devicePixelRatio, 2));
canvas.addEventListener("webglcontextlost", () => write(blind, LOST));
canvas.addEventListener("webglcontextrestored", () => write(blind, ""));
const scene = new THREE.Scene();
scene.background = new THREE.Color("#171b22");
scene.add(new THREE.HemisphereLight("#ffffff", "#8090a0", 2.5));
const sun = new THREE.DirectionalLight("#ffffff", 1.5);
sun.position.set(1, 2, 2);
scene.add(sun);
const camera = new THREE.PerspectiveCamera(VIEW_ANGLE, 1, 0.1, 30);
const controls = new OrbitControls(camera, canvas);
const world = new THREE.Group(); // in level axes: x right, y down along the vertical, z ahead
const person = new Person();
const bones = new Bones(content.parents);
const colliders = new Colliders(content.parents.length);
const bubbles = new Bubbles(() => stillness.matches);
const piano = new Piano();
const pedals = new Pedals();
const sound = new Sound();
const haptics = new Haptics();
const panel = new Panel();
const floor = room();
const cues = new Cues();
world.add(person.root, bones.root, colliders.root, bubbles.root, piano.root, pedals.root, floor);
world.add(cues.root);
if (renderer) renderer.xr.enabled = true;
const views = new Views(renderer, camera, world);
scene.add(world, views.rig, panel.root);
/** The renderer; null if the browser has no WebGL. The rest of the page works without it. */
function drawing(): THREE.WebGLRenderer | null {
  try {
    return new THREE.WebGLRenderer({ canvas, antialias: true });
  } catch {
    write(blind, BLIND);
    return null;
  }
}

let session: XRSession | null = null;
const outside = new THREE.Vector3(); // camera position before the view from the patient's own eyes

let placed = ""; // the vertical for which the camera was placed
let newest: Status | null = null;

/** Places the camera in front of the person: once, and again if another vertical is measured. */
function place(status: Status): void {
  const middle = status.joints?.[1];
  const vertical = String(status.down);
  if (placed === vertical || !middle || !status.joint_states?.[1]) return;
  placed = vertical;
  const ankles = [14, 18].filter((joint) => status.joint_states?.[joint]);
  const lowest = Math.max(...ankles.map((joint) => status.joints![joint][1]), middle[1] + 0.9);
  floor.position.set(middle[0], lowest + 0.08, middle[2]);
  const before = controls.target.clone();
  controls.target.set(0, -middle[1] - 0.2, -middle[2]);
  // The direction of the view stays.
  for (const eye of [camera.position, outside]) eye.add(controls.target).sub(before);
  fit();
}

function fit(): void {
  const { clientWidth: width, clientHeight: height } = canvas.parentElement as HTMLElement;
  renderer?.setSize(width, height, false);
  camera.aspect = width / Math.max(height, 1);
  camera.fov = views.own ? OWN_ANGLE : VIEW_ANGLE;
  camera.updateProjectionMatrix();
  const tangent = Math.tan(THREE.MathUtils.degToRad(VIEW_ANGLE / 2));
  const needed = Math.max(SHOWN_M.height, SHOWN_M.width / camera.aspect) / 2 / tangent;
  const way = camera.position.clone().sub(controls.target);
  if (way.lengthSq() < 1e-6 || !placed) way.set(0, 0.12, 1);
  camera.position.copy(controls.target).addScaledVector(way.normalize(), needed);
  controls.update();
}

/** Apply the state of the buttons. */
function settle(): void {
  if (isOn(toggles.own) && !views.own) outside.copy(camera.position);
  if (!isOn(toggles.own) && views.own) camera.position.copy(outside);
  views.own = isOn(toggles.own);
  views.way = way.value as Way;
  document.body.dataset.way = views.way;
  document.body.dataset.own = String(views.own);
  // The view from the patient's own eyes is not mirrored.
  world.scale.set(isOn(toggles.mirror) && !views.own ? -1 : 1, -1, -1);
  controls.enabled = !views.own;
  bones.root.visible = isOn(toggles.skeleton);
  colliders.root.visible = isOn(toggles.colliders);
  person.tint = isOn(toggles.tint);
  sound.on = isOn(toggles.sound);
  document.documentElement.classList.toggle("large", isOn(toggles.large));
  if (newest) tell(newest);
  fit();
}

// --- frames ----------------------------------------------------------------------------------------

let played: number | null = null; // number of the last event of the game
let ticked: number | null = null;

/** Events of the game that are new in this frame. Events before the first frame are ignored. */
function unplayed({ events = [] }: GameStatus): (string | number)[][] {
  const before = played ?? Infinity;
  played = Math.max(played ?? 0, ...events.map((event) => Number(event[7])));
  return events.filter((event) => Number(event[7]) > before);
}

async function decode(frame: Frame): Promise<void> {
  await person.show(frame);
  newest = frame.status;
  bones.show(frame.status);
  colliders.show(frame.status);
  const game = { ...frame.status.game, events: unplayed(frame.status.game) };
  bubbles.show(content.games[game.name].rules === "piano" ? { ...game, targets: [] } : game);
  piano.show(game);
  pedals.show(game);
  for (const [kind, , bone, , , , key] of game.events) {
    sound.event(String(kind), Number(key));
    if (kind !== "missed") haptics.hit(Number(bone), session);
  }
  cues.show(frame.status);
  const ticks = frame.status.touch?.ticks ?? ticked ?? 0;
  const isTick = ticked !== null && ticks > ticked;
  ticked = ticks;
  if (isTick) {
    sound.event("touch", 0);
    haptics.hit(frame.status.affected?.startsWith("left") ? 7 : 11, session);
  }
  place(frame.status);
  tell(frame.status);
}

function tell(status: Status): void {
  const { state, message, game } = status;
  if (status.affected) {
    write(title, `Phantom ${status.affected.replace("_", " ")}`);
    document.body.dataset.leg = String(status.affected.endsWith("leg"));
  }
  if (document.activeElement !== gain) gain.value = String(status.gain ?? 1);
  setup.tell(status);
  touching.tell(status);
  if (document.body.dataset.state !== state) document.body.dataset.state = state;
  // Without a connection the status is old, and the page says so.
  if (document.body.dataset.connected !== "false") {
    write(stateWord, STATES[state] ?? state);
    write(stateText, views.own ? `${message} ${HATCHED}` : message);
  }
  tellGame(status, message);
  panel.root.visible = views.wantsPanel;
  if (!views.wantsPanel) return;
  const lines = [...card.children].map((line) => line.textContent ?? "");
  const heading = card.hidden ? (score.textContent ?? "").replace(/ {3}/g, ", ") : lines[0];
  const wayOut = views.inHeadset && game.sitting === "open" ? [HOLD] : [];
  panel.say([heading, ...(card.hidden ? [message] : lines.slice(1)), ...wayOut]);
}

let phase = "";
let rated = ""; // state of the rating that was just sent, in words

/** Whether a ball touches the limb now. */
function isTouching(status: Status | null): boolean {
  return (status?.touch?.left_s ?? 0) > 0;
}

/** Updates the card that is shown after the end of a session. */
function closing(game: GameStatus): string[] {
  const place = views.inHeadset ? "You may take the headset off." : "Say so below.";
  if (game.sitting === "ending") return [`How strong is the phantom pain now? ${place}`];
  if (views.inHeadset) return [`This session is over. ${place}`];
  const how = game.halt ? "" : " Another session begins with the button below.";
  return [`This session is over.${how}`];
}

function tellGame(status: Status, message: string): void {
  const { game } = status;
  const { title, how, most_misses: most } = content.games[game.name];
  const idle = game.phase === "waiting" || game.phase === "over";
  start.disabled = Boolean(game.halt) || game.sitting === "ending"; // waits for the last rating
  const goesOn = isTouching(status);
  const isOver = game.sitting !== "open";
  enough.disabled = isOver;
  unanswered.hidden = game.sitting !== "ending";
  write(painTold, rated || (game.pain === null ? "" : `Noted: ${game.pain}.`));
  if (document.activeElement !== gameChoice) gameChoice.value = game.name;
  if (document.activeElement !== difficulty) difficulty.value = String(game.difficulty);
  const ready = game.phase === "over" ? "Play again" : "Start when ready";
  const word = idle && !goesOn ? (isOver ? "Begin another session" : ready) : "Stop";
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
  const now = `${game.name} ${game.phase} ${pause} ${game.halt} ${game.ask} ${game.sitting} ${views.inHeadset}`;
  if (phase === now) return;
  phase = now;
  card.hidden = game.phase === "playing";
  const lines: string[] = [];
  let heading = title;
  // Narrow pages are phones, which have no keyboard; the style sheet hides keys there, too.
  const isNarrow = matchMedia("(max-width: 640px)").matches;
  const atPage = isNarrow ? "Start below" : "Start below, or the space bar,";
  const button = views.inHeadset ? "the trigger of a controller" : atPage;
  if (game.phase === "waiting" && !game.halt) {
    lines.push(how, `Press ${button} when you are ready.`);
  }
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
    if (content.asks && !game.halt && !isOver) lines.push("How strong is the phantom pain now? Say so below.");
  }
  if (game.ask) lines.unshift(game.ask);
  if (isOver) {
    heading = "Session over";
    lines.splice(0, lines.length, ...closing(game));
  }
  if (game.halt) {
    heading = "Stop for today";
    lines.unshift(game.halt);
  }
  card.replaceChildren(element("h2", {}, heading), ...lines.map((line) => element("p", {}, line)));
}

function tellConnected(connected: boolean): void {
  document.body.dataset.connected = String(connected);
  if (connected) return;
  write(stateWord, "No connection");
  const again = "If the program was started anew, open the address that it prints.";
  write(stateText, `This page comes back by itself while the program runs. ${again}${tellUnnoted()}`);
}

/**
 * Says which entries a page at another address lacks. They are not sent to a program that was
 * started anew, whose session may be another participant's.
 */
function tellUnnoted(): string {
  const count = link.unnoted;
  if (count === 0) return "";
  const [entries, them] = count === 1 ? ["entry is", "it"] : ["entries are", "them"];
  return ` ${count} ${entries} not noted yet: write ${them} down, and enter ${them} again there.`;
}

/** Whether only browsers of this computer reach the page. */
function isHere(): boolean {
  return /^(localhost|127(\.\d+){3}|\[::1\])$/.test(location.hostname);
}

let codeGone = 0; // timer that removes an expired code

/** Shows the code for another screen, in two groups of four digits. */
function tellCode(code: string): void {
  const digits = `${code.slice(0, 4)} ${code.slice(4)}`;
  const where = isHere()
    ? "Only another browser of this computer; for other devices start with --host."
    : location.protocol === "https:"
      ? "The browser there will warn of the certificate."
      : "";
  write(screenTold, `There open ${location.origin}/join and type ${digits} within 2 minutes. ${where}`);
  clearTimeout(codeGone);
  codeGone = window.setTimeout(() => write(screenTold, ""), CODE_MS);
}

const link = new Link(decode, tellConnected, tellCode);

// Entries that are not noted are lost with the page: the browser asks whether to leave it.
addEventListener("beforeunload", (event) => {
  if (link.unnoted > 0) event.preventDefault();
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
  if (document.body.dataset.connected === "true" && link.silentS > SILENT_S) {
    document.body.dataset.state = "lost";
    write(stateWord, "No picture");
    write(stateText, `For ${Math.floor(link.silentS)} s no picture could be shown.`);
  }
  numbers.replaceChildren(
    ...told.map(([name, value]) =>
      element("div", {}, element("dt", {}, name), element("dd", {}, value)),
    ),
  );
}, WORDS_MS);

// --- user input ------------------------------------------------------------------------------------

function isIdle(): boolean {
  const current = newest?.game.phase;
  return (current === "waiting" || current === "over") && !isTouching(newest);
}

/** Whether a game or a touch runs: the space bar stops it wherever the focus is. */
function isRunning(): boolean {
  return newest !== null && !isIdle();
}

function press(): void {
  if (!newest) return; // there is no game yet that could begin or end
  link.send({ type: isIdle() ? "ready" : "stop" });
}

/** Ends the session. Only a button begins a new one, so that no key or trigger does by mistake. */
function endSession(): void {
  write(enoughTold, "");
  link
    .keep({ type: "enough" })
    .catch((error: Error) => write(enoughTold, `Not said: ${error.message}.`));
}

function choose(): void {
  link.send({ type: "choose", game: gameChoice.value, difficulty: Number(difficulty.value) });
}

function keepOfPatient(message: Message): void {
  const tellRated = (words: string): void => {
    rated = words;
    if (newest) tell(newest);
  };
  tellRated(message.value === undefined ? "Being noted." : `Being noted: ${message.value}.`);
  link
    .keep(message)
    .then(() => tellRated(""))
    .catch((error: Error) => tellRated(`Not noted: ${error.message}.`));
}

rating.addEventListener("submit", (event) => {
  event.preventDefault();
  keepOfPatient({ type: "pain", value: Number(pain.value) });
  pain.value = "";
});
unanswered.addEventListener("click", () => keepOfPatient({ type: "unanswered" }));
/** Stops the game of a patient who feels sick, and asks whether to end play for today. */
function askWhetherSick(isAsked: boolean): void {
  sure.hidden = !isAsked;
  unwell.disabled = isAsked;
  lead(isAsked ? isSick : unwell);
}
unwell.addEventListener("click", () => {
  if (!isIdle()) link.send({ type: "stop" });
  askWhetherSick(true);
});
isWell.addEventListener("click", () => askWhetherSick(false));
isSick.addEventListener("click", () => {
  keepOfPatient({ type: "unwell" });
  askWhetherSick(false);
});
addScreen.addEventListener("click", () => link.send({ type: "screen" }));
enough.addEventListener("click", endSession);
noting.addEventListener("submit", (submitted) => {
  submitted.preventDefault();
  const text = plain(event.value);
  if (text === "") return;
  note.disabled = true;
  write(eventTold, "Being noted.");
  const done = (words: string): void => {
    note.disabled = false;
    write(eventTold, words);
  };
  link
    .keep({ type: "event", text })
    .then(() => {
      if (plain(event.value) === text) event.value = "";
      done("Noted.");
    })
    .catch((error: Error) => done(`Not noted: ${error.message}.`));
});
for (const kind of ["pointerdown", "keydown"]) {
  document.addEventListener(kind, () => sound.wake());
}
start.addEventListener("click", () => {
  if (newest && newest.game.sitting !== "open") link.send({ type: "again" });
  else press();
});
for (const list of [gameChoice, difficulty]) {
  list.addEventListener("change", () => {
    choose();
    letGo(list);
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
  e: () => toggles.own.click(),
  u: () => openSetup.click(),
  t: () => openTouch.click(),
  q: () => enough.click(),
  d: () => {
    way.value = WAYS[(WAYS.indexOf(way.value as Way) + 1) % WAYS.length];
    settle();
  },
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  if (takesText(event.target)) return;
  const stops = event.key === " " && isRunning();
  if (!stops && takesKey(event.target, event.key)) return;
  const action = keys[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  // The release of the key, or its repetition, would otherwise press the button that has the focus.
  if (stops) (document.activeElement as HTMLElement | null)?.blur();
  action();
});

way.addEventListener("change", () => {
  settle();
  letGo(way);
});
canvas.addEventListener("pointermove", (event) => {
  if (!views.own || event.buttons !== 1) return;
  views.turn(event.movementX * TURN, event.movementY * TURN);
});
void hasHeadset().then((found) => {
  headset.hidden = !found || !renderer;
});
headset.addEventListener("click", () => {
  write(headsetTold, "");
  if (session) {
    void session.end();
    return;
  }
  const left = (): void => {
    session = null;
    headset.replaceChildren("Enter headset");
    settle();
  };
  views
    .enterHeadset(left, press, endSession)
    .then((entered) => {
      session = entered;
      headset.replaceChildren("Leave headset");
      if (newest) tell(newest);
    })
    .catch((error: Error) => write(headsetTold, `The headset did not start: ${error.message}`));
});

new ResizeObserver(fit).observe(canvas.parentElement as HTMLElement);
settle();
let drawnAt = performance.now();
renderer?.setAnimationLoop(() => {
  const now = performance.now();
  bubbles.animate(now);
  if (newest) views.look(newest, now);
  const level = -floor.position.y; // y of the floor in the scene
  const isPlaced = views.place(controls.target, level, (now - drawnAt) / 1000);
  drawnAt = now;
  person.ownEyes(views.hidden);
  if (!isPlaced) controls.update();
  placePanel(level);
  views.render(scene, views.own ? ARM_M : camera.position.distanceTo(controls.target));
});

/** Places the board beside the person, as seen by the viewer, so that it never covers them. */
function placePanel(level: number): void {
  if (!panel.root.visible) return;
  const { x, y, z } = controls.target;
  if (views.own) {
    const eye = camera.getWorldPosition(new THREE.Vector3());
    const ahead = camera.getWorldDirection(new THREE.Vector3());
    if (views.inHeadset) ahead.setY(0).normalize(); // does not follow the head up and down
    panel.root.position.copy(eye).addScaledVector(ahead, 2.2);
    panel.root.position.y += views.inHeadset ? 0.5 : 0.55;
    panel.root.lookAt(eye);
    return;
  }
  panel.root.rotation.set(0, 0, 0);
  if (views.inHeadset) panel.root.position.set(x, level + 2.25, z - 0.4);
  else panel.root.position.set(x, card.hidden ? y + 0.95 : y - 0.88, z + 0.1);
}

// For tests, and for the browser's developer tools.
Object.assign(globalThis, {
  manip3dLive: {
    stats: () => link.stats(),
    status: () => newest,
    sounds: () => sound.played,
    pulses: () => haptics.pulses,
    eye: () => camera.getWorldPosition(new THREE.Vector3()).toArray(),
    panel: () => (panel.root.visible ? panel.said : null),
  },
});
