// The touch cue with its questions, and the limb that the patient feels.

import type { Status } from "./frame";
import { element, write, type Keep, type Message, type Send } from "./parts";

export interface TouchContent {
  statements: string[];
  felt: Record<string, [number, number]>;
  asks: boolean;
}

const WORDS: Record<string, string> = {
  length: "Length, % of the other limb's",
  telescoping: "Drawn up into the stump, %",
  raised: "Raised to the side, degrees",
  bent: "Bent, degrees",
};
const READY_S = 0.8; // the bar fills before the tick, to which people react only 0.2 s later
const START: Record<string, number> = { length: 100, telescoping: 0, raised: 0, bent: 0 };

export class TouchPanel {
  readonly root = element("section", { id: "touch", hidden: "", "aria-label": "Touch" });
  private told = element("p", { role: "status" });
  private questions = element("form", { id: "ownership", hidden: "" });
  private kept = element("p", { role: "status" });
  private bar = element("progress", { max: "1", value: "0", "aria-label": "Until the next touch" });
  private where = element("span");
  private due = element("p", { id: "touch-due", hidden: "" }, this.bar, " ", this.where);
  private mode = "";
  private filled = ""; // the values that the sliders were set to, as JSON
  private sliders: Record<string, { range: HTMLInputElement; shown: HTMLOutputElement }> = {};

  constructor(
    private content: TouchContent,
    send: Send,
    private keep: Keep,
    onEnd: () => void,
  ) {
    const buttons = ["synchronous", "asynchronous"].map((mode) => {
      const made = element("button", { id: `touch-${mode}` }, mode[0].toUpperCase() + mode.slice(1));
      made.addEventListener("click", () => {
        write(this.kept, "");
        send({ type: "touch", mode });
      });
      return made;
    });
    const off = element("button", {}, "Stop");
    off.addEventListener("click", () => send({ type: "touch", mode: "off" }));
    const close = element("button", {}, "Close");
    close.addEventListener("click", () => {
      this.root.hidden = true;
      onEnd();
    });
    this.root.append(
      element("h2", {}, "Touch"),
      element(
        "p",
        {},
        "For a minute a ball touches the phantom limb. Touch the patient when the bar is full, at the " +
          "tick, or let the controller in their hand do it.",
      ),
      element("div", { class: "row" }, ...buttons, off),
      this.told,
      this.due,
      this.questions,
      this.kept,
      this.feltForm(),
      close,
    );
    this.makeQuestions();
  }

  private makeQuestions(): void {
    const lists = this.content.statements.map((statement, which) => {
      const list = element("select", { name: `q${which + 1}`, required: "" });
      list.append(element("option", { value: "" }, "choose"));
      for (let value = -3; value <= 3; value++) {
        const word = { [-3]: " (not at all)", 3: " (very much)" }[value] ?? "";
        list.append(element("option", { value: String(value) }, `${value}${word}`));
      }
      return element("label", {}, `${statement} `, list);
    });
    const keepAnswers = element("button", { class: "main" }, "Keep the answers");
    this.questions.append(element("h3", {}, "How was it?"), ...lists, keepAnswers);
    this.questions.addEventListener("submit", (event) => {
      event.preventDefault();
      const message: Message = { type: "ownership", mode: this.mode };
      for (const [name, value] of new FormData(this.questions)) message[name] = Number(value);
      keepAnswers.disabled = true;
      const done = (words: string): void => {
        keepAnswers.disabled = false;
        write(this.kept, words);
      };
      this.keep(message)
        .then(() => {
          this.questions.reset();
          done("Noted.");
        })
        .catch((error: Error) => done(`Not noted: ${error.message}.`));
    });
  }

  /** Sets the sliders if the stored values have changed: for another limb, or from another page. */
  private fillFelt(felt: Record<string, number>): void {
    const key = JSON.stringify(felt);
    if (key === this.filled) return;
    this.filled = key;
    for (const [name, { range, shown }] of Object.entries(this.sliders)) {
      range.value = String(felt[name]);
      write(shown, range.value);
    }
  }

  private feltForm(): HTMLElement {
    const form = element("form", { id: "felt" }, element("h3", {}, "The limb as it feels"));
    for (const [name, [low, high]] of Object.entries(this.content.felt)) {
      const range = element("input", {
        type: "range",
        name,
        min: String(low),
        max: String(high),
        value: String(START[name]),
      });
      const shown = element("output", {}, String(START[name]));
      this.sliders[name] = { range, shown };
      range.addEventListener("input", () => write(shown, range.value));
      form.append(element("label", {}, `${WORDS[name]} `, range, shown));
    }
    form.append(element("button", {}, this.content.asks ? "Show and keep" : "Show"));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const message: Message = { type: "felt" };
      for (const [name, value] of new FormData(form)) message[name] = Number(value);
      this.keep(message).catch(() => write(this.kept, "Not shown: no connection."));
    });
    return form;
  }

  tell({ touch, felt_as: felt }: Status): void {
    // Undefined: the message has no frame, and so no state of the cue.
    if (felt !== undefined) this.fillFelt(felt ?? START);
    if (this.root.hidden) return;
    if (touch) this.mode = touch.mode;
    const over = Boolean(touch && touch.left_s <= 0);
    const left = touch && !over ? `${touch.mode}: ${Math.ceil(touch.left_s)} s left` : "";
    write(this.told, over ? "Over." : left);
    this.due.hidden = over || !touch?.due;
    if (touch?.due) {
      const [seconds, joint] = touch.due;
      this.bar.value = Math.max(0, 1 - seconds / READY_S);
      write(this.where, `Next: ${joint}`);
    }
    // The questions are shown on every screen; after an answer the program ends the cue on all.
    this.questions.hidden = !(over && this.content.asks);
  }
}
