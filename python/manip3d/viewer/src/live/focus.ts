// The focus after an input: a keyboard keeps it, a pointer does not, so that keys control the page.

let isTyped = false; // whether the last input came from the keyboard

for (const kind of ["pointerdown", "keydown"]) {
  document.addEventListener(kind, () => (isTyped = kind === "keydown"), true);
}
// A button that kept the focus would take the space bar, which starts and stops the game.
document.addEventListener("click", ({ target }) => {
  const pressed = (target as Element).closest<HTMLElement>("button, input[type=checkbox]");
  if (pressed) letGo(pressed);
});

/** After a choice by pointer, keys control the page again; after one by keyboard, the list. */
export function letGo(chosen: HTMLElement): void {
  if (!isTyped) chosen.blur();
}

/** Moves the focus on for people who use the keyboard. */
export function lead(next: HTMLElement): void {
  if (isTyped) next.focus();
}

/** Whether an element has a use of its own for a key that would control the page. */
export function takesKey(target: EventTarget | null, key: string): boolean {
  if (target instanceof HTMLButtonElement) return key === " ";
  return target instanceof HTMLSelectElement || target instanceof HTMLInputElement;
}

/** Whether keys write text into an element. */
export function takesText(target: EventTarget | null): boolean {
  return target instanceof HTMLInputElement && target.type === "text";
}
