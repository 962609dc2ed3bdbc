// Parts of the page.

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

/** Changes a text where it is another one; else screen readers repeat it. */
export function write(where: HTMLElement, text: string): void {
  if (where.textContent !== text) where.textContent = text;
}

export type Message = Record<string, string | number>;

/** Says something now, or never where there is no connection. */
export type Send = (message: Message) => void;

/** Says something until it was heard; the promise fails where it cannot be said. */
export type Keep = (message: Message) => Promise<void>;

/** A free text as the program takes it: on one line, without signs that are no text. */
export function plain(text: string): string {
  return text.replace(/[\p{Cc}\p{Cs}]+/gu, " ").trim();
}
