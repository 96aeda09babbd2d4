/* The list of events and wrong decisions: filtered, drawn, and where the next one is. */

import { el, reveal, time_text } from "./dom.js";

/** Wrong decisions, which the page tells from events. */
export const WRONG = new Set(["missed", "false", "late", "early"]);
/** What keys step through, and the strip shows. */
export const STEPS = new Set(["step", "impact", "pass", "crossing"]);
/** What is listed at first, if there is any of it. */
const AT_FIRST = new Set([...STEPS, ...WRONG, "gap"]);
/** More rows than this are not drawn; keys go through all of them. */
const MOST_ROWS = 3000;
/** Moments this close to the cursor are where it is, not before or after it [s]. */
const HERE_S = 1e-6;

export class Jumps {
  /**
   * @param {object} moments what the server or the folder says of the replay
   * @param {(seconds: number) => void} go moves the cursor
   */
  constructor(moments, go) {
    this.go = go;
    this.words = "";
    this.list = document.getElementById("events");
    this.chosen = false;
    this.renew(moments);
  }

  /** Take all moments anew, as those of a replay that is running; what a person chose stays. */
  renew(moments) {
    this.all = [...moments.events, ...moments.misses].sort((a, b) => a.t_s - b.t_s);
    this.kinds = [...new Set(this.all.map((moment) => moment.kind))];
    this.kinds.sort((a, b) => WRONG.has(b) - WRONG.has(a) || a.localeCompare(b));
    const first = this.kinds.filter((kind) => AT_FIRST.has(kind));
    if (!this.chosen) this.shown_kinds = new Set(first.some((k) => k !== "gap") ? first : this.kinds);
    this.chips();
    this.fill();
  }

  chips() {
    const counts = Map.groupBy(this.all, (moment) => moment.kind);
    const chips = this.kinds.map((kind) => {
      const chip = el("button", { "data-kind": kind }, `${kind} ${counts.get(kind).length}`);
      chip.setAttribute("aria-pressed", this.shown_kinds.has(kind));
      chip.onclick = () => {
        this.chosen = true;
        if (!this.shown_kinds.delete(kind)) this.shown_kinds.add(kind);
        chip.setAttribute("aria-pressed", this.shown_kinds.has(kind));
        this.fill();
      };
      return chip;
    });
    document.getElementById("kinds").replaceChildren(...chips);
  }

  filter(words) {
    this.words = words;
    this.fill();
  }

  /** Draw the rows that pass the filter. */
  fill() {
    const words = this.words.toLowerCase().split(/\s+/).filter(Boolean);
    this.shown = this.all.filter((moment) => {
      if (!words.length || !this.shown_kinds.has(moment.kind)) return this.shown_kinds.has(moment.kind);
      const text = `${moment.kind} ${moment.stage} ${moment.text}`.toLowerCase();
      return words.every((word) => text.includes(word));
    });
    this.rows = this.shown.slice(0, MOST_ROWS).map((moment) => this.row(moment));
    const rest = this.shown.length - this.rows.length;
    const end = rest > 0 ? [el("li", { class: "none" }, `and ${rest} more: filter to see them`)] : [];
    const none = this.shown.length ? [] : [el("li", { class: "none" }, "nothing passes the filter")];
    this.list.replaceChildren(...this.rows, ...end, ...none);
    this.here = null;
    document.getElementById("event-count").textContent = `${this.shown.length} of ${this.all.length}`;
  }

  row(moment) {
    const what = el("span", { class: "what" }, moment.text);
    what.title = moment.stage ? `${moment.stage}: ${moment.text}` : moment.text;
    const row = el("li", { "data-kind": moment.kind },
      el("span", { class: "t" }, time_text(moment.t_s)),
      el("span", { class: "kind" }, moment.kind), what);
    row.onclick = () => this.go(moment.t_s);
    return row;
  }

  /** Return the time of the next (or previous) shown moment that a test accepts, or null. */
  beyond(at, forward, accepts = () => true, among = this.shown) {
    if (forward) return among.find((m) => m.t_s > at + HERE_S && accepts(m))?.t_s ?? null;
    return among.findLast((m) => m.t_s < at - HERE_S && accepts(m))?.t_s ?? null;
  }

  event(at, forward) {
    return this.beyond(at, forward);
  }

  miss(at, forward) {
    return this.beyond(at, forward, (moment) => WRONG.has(moment.kind), this.all);
  }

  step(at, forward) {
    return this.beyond(at, forward, (moment) => STEPS.has(moment.kind), this.all);
  }

  /** Return the time of the shown moment nearest to a time, or that time itself. */
  nearest(at) {
    const near = this.shown.reduce((best, moment) =>
      !best || Math.abs(moment.t_s - at) < Math.abs(best.t_s - at) ? moment : best, null);
    return near ? near.t_s : at;
  }

  /** Mark the row that the cursor is on or past, and bring it into view. */
  follow(at) {
    const index = this.shown.findLastIndex((moment) => moment.t_s <= at + HERE_S);
    const row = this.rows[index] ?? null;
    if (row === this.here) return;
    this.here?.classList.remove("here");
    row?.classList.add("here");
    reveal(this.list, row);
    this.here = row;
  }
}
