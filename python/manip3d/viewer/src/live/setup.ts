// The set-up before a session, in steps: hazards, camera, patient, limb, measures, pain, consent.

import { letGo } from "./focus";
import type { Status } from "./frame";
import { element, write, type Keep, type Send } from "./parts";

export interface SetupContent {
  limbs: string[];
  asks: boolean; // whether a diary needs ratings of the pain
  intended_use: string;
}

/** A panel over the picture, which stays visible beside it. */
export class Setup {
  readonly root = element("section", { id: "setup", hidden: "", "aria-label": "Set up" });
  private step = 0;
  private steps: { title: string; body: HTMLElement; isDone: () => boolean }[];
  private heading = element("h2", { tabindex: "-1" });
  private holder = element("div");
  private back = element("button", {}, "Back");
  private next = element("button", { class: "main", id: "setup-next" }, "Next");
  private read = element("input", { type: "checkbox", id: "setup-read" });
  private checks = element("ul", { class: "checks" });
  private people = element("div", { class: "row" });
  private limb = element("select", { id: "setup-limb" });
  private still = element("button", { id: "setup-still" }, "Measure while the patient is still");
  private measured = element("p", { role: "status" });
  private clips = element("input", { type: "checkbox", id: "setup-clips" });
  private newest: Status | null = null;

  constructor(
    content: SetupContent,
    private send: Send,
    keep: Keep,
    private onEnd: () => void,
  ) {
    for (const limb of content.limbs) {
      this.limb.append(element("option", { value: limb }, limb.replace("_", " ")));
    }
    this.limb.addEventListener("change", () => {
      send({ type: "limb", limb: this.limb.value });
      letGo(this.limb);
    });
    this.still.addEventListener("click", () => send({ type: "calibrate" }));
    this.clips.addEventListener("change", () => {
      // The box shows the program's state, and so whether this change was accepted.
      keep({ type: "consent", clips: Number(this.clips.checked) }).catch(console.error);
    });
    this.read.addEventListener("change", () => this.show());
    const hazards = element("a", { href: "/hazards", target: "_blank" }, "intended use and hazards");
    this.steps = [
      {
        title: "Intended use",
        body: element(
          "div",
          {},
          element("p", {}, content.intended_use),
          element("label", {}, this.read, " I have read ", hazards, "."),
        ),
        isDone: () => this.read.checked,
      },
      {
        title: "Camera",
        body: element("div", {}, this.checks),
        isDone: () => this.newest?.checks?.every(([, isMet]) => isMet) ?? false,
      },
      {
        title: "Patient and limb",
        body: element(
          "div",
          {},
          this.people,
          element("label", {}, "Limb that is missing ", this.limb),
        ),
        isDone: () => true,
      },
      {
        title: "Measures",
        body: element(
          "div",
          {},
          element("p", {}, "Stand, or sit for games of legs, as in the games; hold still for 2 s."),
          this.still,
          this.measured,
        ),
        isDone: () => this.newest?.calibrated === 1,
      },
    ];
    if (content.asks) {
      this.steps.push({
        title: "Consent and pain",
        body: element(
          "div",
          {},
          element(
            "label",
            {},
            this.clips,
            " The patient consents to short films where a game goes badly: the person before a " +
              "grey ground, nothing of the room. Without consent earlier ones are deleted.",
          ),
          element("p", {}, "Ask how strong the phantom pain is now; enter it below the picture."),
        ),
        isDone: () => this.newest?.game.pain !== null,
      });
    }
    this.back.addEventListener("click", () => this.go(this.step - 1));
    this.next.addEventListener("click", () => this.go(this.step + 1));
    const close = element("button", {}, "Close");
    close.addEventListener("click", () => this.close());
    this.root.append(
      this.heading,
      this.holder,
      element("div", { class: "row" }, this.back, this.next, close),
    );
    this.show();
  }

  get isOpen(): boolean {
    return !this.root.hidden;
  }

  open(): void {
    this.root.hidden = false;
    this.go(0);
  }

  close(): void {
    this.root.hidden = true;
    this.onEnd();
  }

  tell(status: Status): void {
    this.newest = status;
    if (this.isOpen) this.show();
  }

  private go(step: number): void {
    if (step >= this.steps.length) {
      this.close();
      return;
    }
    this.step = Math.max(0, step);
    this.show();
    this.heading.focus();
  }

  private show(): void {
    const { title, body, isDone } = this.steps[this.step];
    write(this.heading, `${this.step + 1} of ${this.steps.length}: ${title}`);
    if (this.holder.firstChild !== body) this.holder.replaceChildren(body);
    this.back.disabled = this.step === 0;
    const isLast = this.step === this.steps.length - 1;
    const word = isDone() ? (isLast ? "Done" : "Next") : "Skip";
    write(this.next, this.step === 0 ? "Next" : word);
    this.next.disabled = this.step === 0 && !isDone(); // the hazards cannot be skipped
    this.next.classList.toggle("main", isDone());
    if (this.newest) this.fill(this.newest);
  }

  private fill({ checks = [], people = [], affected, calibrated, clips }: Status): void {
    const told = checks.map(([name, isMet, advice]) =>
      `${isMet ? "\u2713" : "\u2717"} ${name}. ${advice}`.trim(),
    );
    if ([...this.checks.children].map((line) => line.textContent).join() !== told.join()) {
      this.checks.replaceChildren(
        ...told.map((line, which) =>
          element("li", { "data-met": String(checks[which][1]) }, line),
        ),
      );
    }
    const key = people.join(" ");
    if (this.people.dataset.people !== key) {
      this.people.dataset.people = key;
      this.people.replaceChildren(
        ...people.map(([which, isPatient], place) => {
          const words = isPatient ? "This is the patient" : `Person ${place + 1} is the patient`;
          const made = element("button", { "aria-pressed": String(isPatient) }, words);
          made.addEventListener("click", () => this.send({ type: "patient", which }));
          return made;
        }),
      );
    }
    if (affected && document.activeElement !== this.limb) this.limb.value = affected;
    const share = calibrated ?? -1;
    const words = share < 0 ? "Not measured yet." : `Hold still: ${Math.round(100 * share)} %`;
    write(this.measured, share === 1 ? "Measured; games are laid out for this patient." : words);
    if (clips !== null && clips !== undefined && document.activeElement !== this.clips) {
      this.clips.checked = clips;
    }
  }
}
