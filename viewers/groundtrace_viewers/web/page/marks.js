/* Marks: what a person says happened, made at the cursor, listed, edited and taken back. */

import { complain, el, reveal, say, time_text } from "./dom.js";

export const MOMENTS = ["missed", "false", "step", "pick", "note"];
export const SPANS = ["span", "walking", "ignore", "disturbed", "pass"];

/** Return a time [s] as whole nanoseconds have it. */
function to_ns(seconds) {
  return Math.round(seconds * 1e9) / 1e9;
}

export class Marks {
  /**
   * @param {object} store keeps the marks
   * @param {object} page its `at()` is the cursor [s], `go()` moves it, `changed()` and `layer()`
   *   hear of changes
   */
  constructor(store, page) {
    this.store = store;
    this.page = page;
    this.all = [];
    this.chosen = null;
    this.span_start = null;
    this.queue = Promise.resolve();
    this.list = document.getElementById("marks");
    this.author = document.getElementById("author");
    this.note = document.getElementById("note");
    this.channel = document.getElementById("channel");
    this.hint = document.getElementById("mark-hint");
    this.note.addEventListener("keydown", (event) => {
      if (event.key === "Enter") this.add("note");
    });
  }

  /** Read what was kept. */
  async load() {
    const kept = await this.store.load();
    this.author.value = kept.author;
    this.take(kept);
  }

  /** Take over what the store says there is now. */
  take(kept) {
    this.all = kept.marks;
    this.can_undo = kept.undo;
    this.revision = kept.revision;
    if (kept.id !== undefined) this.chosen = kept.id;
    this.fill();
    this.page.changed();
  }

  /** Change something: one change after the other, and the layer after each. */
  change(act) {
    this.queue = this.queue.then(async () => {
      try {
        complain("");
        this.take(await act(this.author.value.trim()));
        await this.page.layer();
      } catch (error) {
        complain(error.message);
      }
    });
    return this.queue;
  }

  /** Mark the cursor. */
  add(kind, label = "") {
    const channel = kind === "pick" ? this.channel.value : "";
    return this.keep_new(kind, { time_s: to_ns(this.page.at()), end_s: null, label, channel });
  }

  /** Begin a span at the cursor, or end it there. */
  span(kind) {
    if (this.span_start === null) {
      this.span_start = this.page.at();
      this.guide();
      this.page.changed();
      return;
    }
    const ends = [this.span_start, this.page.at()].sort((a, b) => a - b).map(to_ns);
    this.give_up();
    this.keep_new(kind, { time_s: ends[0], end_s: ends[1], label: "", channel: "" });
  }

  /** Keep a new mark with the note that was typed for it. */
  keep_new(kind, said) {
    const mark = { kind, ...said, note: this.note.value.trim() };
    this.note.value = "";
    this.note.blur();
    say(`${kind} marked at ${time_text(mark.time_s)} s`);
    return this.change((author) => this.store.add(mark, author));
  }

  /** Forget the beginning of a span. */
  give_up() {
    this.span_start = null;
    this.guide();
    this.page.changed();
  }

  guide() {
    const open = this.span_start !== null;
    this.hint.classList.toggle("busy", open);
    this.hint.textContent = open
      ? `span from ${time_text(this.span_start)} s: go to its end and press B again (Esc: forget it)`
      : this.page.hint;
  }

  remove(id = this.chosen) {
    if (id) this.change((author) => this.store.remove(id, author));
  }

  undo() {
    if (this.can_undo) this.change((author) => this.store.undo(author));
  }

  /** Draw the list. */
  fill() {
    const rows = this.all.map((mark) => this.row(mark));
    const none = el("li", { class: "none" }, "nothing marked yet: go to a moment and press a key");
    this.list.replaceChildren(...(rows.length ? rows : [none]));
    document.getElementById("mark-count").textContent = this.all.length || "";
    reveal(this.list, this.list.querySelector(".here"));
  }

  row(mark) {
    const length = mark.end_s === null ? "" : `${(mark.end_s - mark.time_s).toFixed(2)} s`;
    const said = [mark.label, mark.channel, length, mark.note].filter(Boolean).join(" · ");
    const own = this.author.value.trim() || "annotator";
    const by = mark.author === own ? [] : [el("span", { class: "by" }, mark.author)];
    const what = el("span", { class: "what" }, said, ...by);
    what.title = `${said} (${mark.author})`;
    const row = el("li", { "data-kind": mark.kind, "data-id": mark.id },
      el("span", { class: "t" }, time_text(mark.time_s)), el("span", { class: "kind" }, mark.kind), what);
    row.classList.toggle("here", mark.id === this.chosen);
    row.onclick = () => this.choose(mark);
    row.ondblclick = () => this.edit(mark);
    return row;
  }

  choose(mark) {
    this.chosen = mark.id;
    for (const row of this.list.children) row.classList.toggle("here", row.dataset.id === mark.id);
    this.page.go(mark.time_s);
  }

  /** Turn a mark's row into fields; Enter keeps them, Esc does not. */
  edit(mark = this.all.find((kept) => kept.id === this.chosen)) {
    const row = [...this.list.children].find((child) => mark && child.dataset.id === mark.id);
    if (!row) return;
    const kind = el("select", { "aria-label": "Kind" });
    const kinds = mark.end_s === null ? MOMENTS : SPANS;
    kind.append(...kinds.map((name) => el("option", { value: name }, name)));
    kind.value = mark.kind;
    const field = (name, text) => {
      const input = el("input", { class: name, placeholder: name, "aria-label": name });
      input.value = text;
      return input;
    };
    const time = field("time", mark.time_s.toFixed(6));
    const end = mark.end_s === null ? null : field("time", mark.end_s.toFixed(6));
    const label = field("label", mark.label);
    const channel = field("channel", mark.channel);
    const note = field("note", mark.note);
    note.placeholder = "note (Enter keeps it all, Esc nothing)";
    row.className = "editing";
    row.onclick = row.ondblclick = null;
    row.replaceChildren(...[time, end, kind, label, channel, note].filter(Boolean));
    note.focus();
    row.onkeydown = (event) => {
      if (event.key === "Escape") this.fill();
      if (event.key !== "Enter") return;
      this.keep(mark, { kind: kind.value, label: label.value, channel: channel.value, note: note.value }, time, end);
    };
  }

  keep(mark, words, time, end) {
    const seconds = (input, old) => {
      const typed = input.value.trim();
      return typed === old.toFixed(6) ? old : Number(typed.replace(",", "."));
    };
    const time_s = seconds(time, mark.time_s);
    const end_s = end && seconds(end, mark.end_s);
    if ([time_s, end_s].some(Number.isNaN)) {
      complain(`time: expected seconds, found "${Number.isNaN(time_s) ? time.value : end.value}"`);
      return;
    }
    // Exact times are kept where they did not change.
    const time_ns = time_s === mark.time_s ? mark.time_ns : "";
    const end_ns = end_s === mark.end_s ? mark.end_ns : null;
    const changed = { ...words, time_s, end_s, time_ns, end_ns };
    this.change((author) => this.store.edit(mark.id, changed, author));
  }
}
