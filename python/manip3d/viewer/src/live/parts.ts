// Helpers that make elements of the page.

/** An element with attributes and children. */
export function element<K extends keyof HTMLElementTagNameMap>(
  name: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Sets a text if it differs: screen readers would repeat an unchanged one. */
export function write(where: HTMLElement, text: string): void {
  if (where.textContent !== text) where.textContent = text;
}

export type Message = Record<string, string | number>;

/** Sends a message if there is a connection now. */
export type Send = (message: Message) => void;

/** Sends a message until it is confirmed; the promise is rejected if it cannot be sent. */
export type Keep = (message: Message) => Promise<void>;

/** A free text in the form that the program accepts: one line, without control characters. */
export function plain(text: string): string {
  return text.replace(/[\p{Cc}\p{Cs}]+/gu, " ").trim();
}
