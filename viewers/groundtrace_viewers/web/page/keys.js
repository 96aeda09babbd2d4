/* Keys: one table, which is also what the help says. */

import { el } from "./dom.js";

/** Return a key press by name: modifiers, then the key. */
function named(event) {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const control = event.ctrlKey || event.metaKey ? "Ctrl+" : "";
  const shift = event.shiftKey && event.key.length > 1 ? "Shift+" : "";
  return event.altKey ? "" : control + shift + (event.key === " " ? "Space" : key);
}

/** Whether somebody is typing: in a field of the page, or of the viewer. */
function typing(target) {
  return target instanceof HTMLElement
    && (target.matches("input:not([type=range]), textarea, select") || target.isContentEditable);
}

/** Whether a key presses, or moves, what has the focus: a button, a list or a slider of the page. */
function pressing(event) {
  const key = event.key;
  if (!(event.target instanceof HTMLElement)) return false;
  if (event.target.matches("button, a, select, summary")) return key === " " || key === "Enter";
  return event.target.matches("input[type=range]") && /^(Arrow|Page|Home|End)/.test(key);
}

/** How a key is written in the help. */
const WRITTEN = {
  ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", Delete: "Del",
  PageUp: "PgUp", PageDown: "PgDn", Escape: "Esc",
};

export class Keys {
  /** @param {Array<[string, Array<[string[], string, () => void]>]>} groups heading, then keys, help and action */
  constructor(groups) {
    this.groups = groups;
    this.actions = new Map();
    for (const [, rows] of groups) {
      for (const [keys, , action] of rows) for (const key of keys) this.actions.set(key, action);
    }
    // At the window and before anybody else: the viewer's canvas has keys of its own.
    window.addEventListener("keydown", (event) => this.pressed(event), true);
  }

  pressed(event) {
    const dialog = document.querySelector("dialog[open]");
    if (event.key === "Tab" && !event.target.closest?.("#panel, dialog")) {
      event.stopImmediatePropagation(); // the viewer would keep the focus for ever
      return;
    }
    const action = this.actions.get(named(event));
    if (event.key === "Escape" && typing(event.target) && event.target.closest("#panel")) {
      event.target.blur();
      return;
    }
    if (!action || pressing(event) || typing(event.target) || (dialog && named(event) !== "?")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    action();
  }

  /** Fill the help with the table. */
  explain(place) {
    const written = (key) => el("kbd", {}, key.split(/(?<=.)\+/).map((part) =>
      WRITTEN[part] ?? (part.length === 1 ? part.toUpperCase() : part)).join(" "));
    place.replaceChildren(...this.groups.map(([heading, rows]) => el("section", {},
      el("h3", {}, heading),
      el("dl", {}, ...rows.flatMap(([keys, text]) =>
        [el("dt", {}, ...keys.map(written)), el("dd", {}, text)])))));
  }
}
