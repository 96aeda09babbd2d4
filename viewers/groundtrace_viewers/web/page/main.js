/* The page: the viewer, the clock that moves its cursor, the lists, and the marks. */

import { answer_of, bytes_of, bytes_or_address, document_of } from "./assets.js";
import { Decision, Tuning } from "./decision.js";
import { both_clocks, complain, el, say } from "./dom.js";
import { Jumps } from "./jumps.js";
import { Keys } from "./keys.js";
import { Link } from "./link.js";
import { Marks, SPANS } from "./marks.js";
import { Player } from "./player.js";
import { exported, save } from "./exchange.js";
import { BrowserStore, ServerStore } from "./stores.js";
import { Strip } from "./strip.js";
import { compiled, painted, Viewer } from "./viewer.js";

const byId = (id) => document.getElementById(id);
/** A sample of a recording whose rate the page was not told [s]. */
const UNKNOWN_SAMPLE_S = 0.001;
/** While a replay is running the page asks for what is new after this, and for causes that are looked for [ms]. */
const RENEW_MS = 500;
const CAUSES_MS = 2000;
/** The drawing of the opening moment has so long before the viewer is started [ms]. */
const DRAWING_MS = 2000;
/** The viewer draws so many pictures in layouts of its own before the one it was given. */
const LAYOUT_PAINTS = 3;
/** While data come in, and no person has touched the viewer, its cursor is put back at most so often. */
const MOST_RETURNS = 100;

/** Return a short period as text. */
function period_text(seconds) {
  const ms = seconds * 1e3;
  return ms < 0.5 ? `${+(ms * 1e3).toPrecision(3)} µs` : `${+ms.toPrecision(3)} ms`;
}

class Page {
  constructor(config, moments) {
    this.moments = moments;
    this.marking = config.annotations !== "off";
    const kept = config.annotations === "server";
    this.hint = kept ? "" : "Kept in this browser only: download them for groundtrace annotate --merge.";
    this.viewer = new Viewer(moments.timeline, (seconds) => this.moved(seconds));
    this.player = new Player(moments.duration_s, (seconds) => this.viewer.seek(seconds), () => this.changed());
    this.jumps = new Jumps(moments, (seconds) => this.go(seconds));
    this.decision = new Decision(moments.misses);
    this.tuning = new Tuning(moments);
    this.link = new Link(() => this.moments.misses, (seconds) => this.go(seconds), (at) => this.decision.number(at));
    this.strip = new Strip(byId("strip"), moments.duration_s, (seconds) => this.go(seconds));
    this.marks = new Marks(kept ? new ServerStore() : new BrowserStore(moments, config.marks ?? []), this);
    this.sample_s = moments.sample_s ?? UNKNOWN_SAMPLE_S;
    this.drawing = false;
    this.led = false;
    this.touched = false;
    this.returns = MOST_RETURNS;
    this.keys = new Keys(this.table());
    this.furnish();
  }

  at() {
    return this.player.at;
  }

  /** Go where a person wants to. */
  go(seconds) {
    if (seconds === null) return;
    this.led = true;
    this.player.go(seconds);
  }

  /** Take over where a person put the viewer's cursor; data that still come in move it too: back, then. */
  moved(seconds) {
    if (this.touched || this.moments.live) this.player.follow(seconds);
    else if (this.returns-- > 0) this.viewer.seek(this.player.at);
  }

  by(seconds) {
    this.player.play(false);
    this.go(this.player.at + seconds);
  }

  jump(find, forward) {
    this.player.play(false);
    const at = find.call(this.jumps, this.player.at, forward);
    this.go(at);
    const what = at === null ? null : this.jumps.all.find((m) => m.t_s === at);
    if (what) say(`${what.kind} at ${both_clocks(at)}: ${what.text}`);
  }

  faster(by) {
    this.player.set_speed(this.player.speed * 2 ** by);
  }

  loop() {
    this.player.toggle_loop(this.jumps.nearest(this.player.at));
  }

  async layer() {
    await this.viewer.opened;
    const bytes = await this.marks.store.layer(this.marks.revision);
    if (bytes) this.viewer.push(bytes, "annotations");
  }

  table() {
    const { jumps, player, marks, sample_s, moments } = this;
    const frame = `one frame, ${period_text(moments.frame_s)}`;
    const sample = `one sample, ${period_text(sample_s)}`;
    const groups = [
      ["Move", [
        [["ArrowRight"], `forward ${frame}`, () => this.by(moments.frame_s)],
        [["ArrowLeft"], `back ${frame}`, () => this.by(-moments.frame_s)],
        [["Shift+ArrowRight", "."], `forward ${sample}`, () => this.by(sample_s)],
        [["Shift+ArrowLeft", ","], `back ${sample}`, () => this.by(-sample_s)],
        [["Home"], "to the start", () => this.go(0)],
        [["End"], "to the end", () => this.go(moments.duration_s)],
      ]],
      ["Jump", [
        [["ArrowDown"], "next event of the list", () => this.jump(jumps.event, true)],
        [["ArrowUp"], "previous event of the list", () => this.jump(jumps.event, false)],
        [["Shift+ArrowDown", "x"], "next wrong decision", () => this.jump(jumps.miss, true)],
        [["Shift+ArrowUp", "w"], "previous wrong decision", () => this.jump(jumps.miss, false)],
        [["PageDown"], "next step", () => this.jump(jumps.step, true)],
        [["PageUp"], "previous step", () => this.jump(jumps.step, false)],
        [["/"], "filter the list", () => byId("filter").focus()],
        [["g"], "type a time to go to", () => byId("time").focus()],
      ]],
      ["Play", [
        [["Space"], "play or pause", () => player.play()],
        [["+", "="], "twice as fast", () => this.faster(1)],
        [["-"], "half as fast", () => this.faster(-1)],
        [["1"], "speed 1x", () => player.set_speed(1)],
        [["o"], "loop ±0.5 s around the event, or stop", () => this.loop()],
      ]],
      ["Page", [
        [["v"], "the viewer's own menu", () => this.viewer.toggle_menu()],
        [["?"], "these keys", () => this.help()],
      ]],
    ];
    if (this.marking) groups.splice(3, 0, ["Mark at the cursor", this.marking_table(marks)]);
    return groups;
  }

  marking_table(marks) {
    return [
      [["m"], "a step that was missed", () => marks.add("missed")],
      [["f"], "a detection that is false", () => marks.add("false")],
      [["s"], "a step", () => marks.add("step")],
      [["l"], "a step, left foot", () => marks.add("step", "left")],
      [["r"], "a step, right foot", () => marks.add("step", "right")],
      [["p"], "an arrival at the chosen channel", () => marks.add("pick")],
      [["n"], "a note: type it, then Enter", () => byId("note").focus()],
      [["b"], "begin a span, again: end it", () => marks.span(byId("span-kind").value)],
      [["e"], "edit the chosen mark", () => marks.edit()],
      [["Delete", "Backspace"], "delete the chosen mark", () => marks.remove()],
      [["u", "Ctrl+z"], "undo the last change", () => marks.undo()],
      [["Escape"], "forget the beginning of a span", () => marks.give_up()],
    ];
  }

  help() {
    const dialog = byId("help");
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }

  /** Make the buttons and tie everything to what it does. */
  furnish() {
    const button = (text, key, title, action, attributes = {}) => {
      const made = el("button", { title, ...attributes }, text);
      if (key) made.append(el("kbd", {}, key));
      made.onclick = action;
      return made;
    };
    const { moments, jumps, player, marks } = this;
    const [frame, sample] = [period_text(moments.frame_s), period_text(this.sample_s)];
    this.play_button = button("▶", "", "Play or pause (Space)", () => player.play());
    byId("steppers").append(
      button("−frame", "", `Back one frame of ${frame} (←)`, () => this.by(-moments.frame_s)),
      button("−sample", "", `Back one sample of ${sample} (Shift ← or ,)`, () => this.by(-this.sample_s)),
      this.play_button,
      button("+sample", "", `Forward one sample of ${sample} (Shift → or .)`, () => this.by(this.sample_s)),
      button("+frame", "", `Forward one frame of ${frame} (→)`, () => this.by(moments.frame_s)));
    byId("jumpers").append(
      button("◀ event", "", "Previous event of the list (↑)", () => this.jump(jumps.event, false)),
      button("event ▶", "", "Next event of the list (↓)", () => this.jump(jumps.event, true)),
      button("◀ wrong", "", "Previous wrong decision (Shift ↑)", () => this.jump(jumps.miss, false)),
      button("wrong ▶", "", "Next wrong decision (Shift ↓)", () => this.jump(jumps.miss, true)));
    this.loop_button = button("loop", "O", "Loop ±0.5 s around the event", () => this.loop());
    byId("speed-row").prepend(this.loop_button);
    byId("recording").textContent = byId("recording").title = moments.recording;
    this.tell_duration();
    document.title = `${moments.recording} — groundtrace`;
    for (const kind of ["pointerdown", "keydown", "wheel"]) {
      byId("viewer").addEventListener(kind, () => { this.touched = true; }, { capture: true, passive: true });
    }
    byId("help-button").onclick = () => this.help();
    byId("speed").oninput = (event) => player.set_speed(10 ** Number(event.target.value));
    byId("filter").oninput = (event) => { jumps.filter(event.target.value); this.changed(); };
    byId("filter").onkeydown = (event) => { if (event.key === "Enter") event.target.blur(); };
    byId("time").onchange = (event) => this.typed_time(event.target.value);
    byId("time").onkeydown = (event) => { if (event.key === "Enter") event.target.blur(); };
    this.keys.explain(byId("keys"));
    if (this.marking) this.furnish_marks(button, marks);
    else byId("marking").hidden = true;
    new ResizeObserver(() => this.changed()).observe(byId("strip"));
  }

  furnish_marks(button, marks) {
    const kinds = el("select", { id: "span-kind", "aria-label": "Kind of spans", title: "Kind of spans" });
    kinds.append(...SPANS.map((kind) => el("option", { value: kind }, kind)));
    const mark = (text, key, title, kind, action) => button(text, key, title, action, { "data-kind": kind });
    byId("mark-buttons").append(
      mark("missed", "M", "A step that was missed, at the cursor", "missed", () => marks.add("missed")),
      mark("false", "F", "A detection that is false", "false", () => marks.add("false")),
      mark("step", "S", "A step (L left, R right foot)", "step", () => marks.add("step")),
      mark("pick", "P", "An arrival at the chosen channel", "pick", () => marks.add("pick")));
    byId("mark-buttons").after(el("div", { class: "row", id: "span-row" },
      mark("note", "N", "A note: type it, then Enter", "note", () => byId("note").focus()),
      mark("span", "B", "Begin a span at the cursor; again: end it", "span", () => marks.span(kinds.value)), kinds));
    const channels = byId("channel");
    channels.append(...this.moments.channels.map((name) => el("option", { value: name }, name)));
    channels.hidden = !this.moments.channels.length;
    this.undo_button = button("undo", "U", "Take the last change back", () => marks.undo());
    byId("mark-tools").append(
      button("edit", "E", "Edit the chosen mark (or double-click it)", () => marks.edit()),
      button("delete", "Del", "Delete the chosen mark", () => marks.remove()), this.undo_button);
    if (marks.store.keeps === "browser") {
      byId("mark-tools").append(button("download", "", "Save the marks as a file for groundtrace annotate --merge", () => this.download()));
    }
    marks.guide();
  }

  /** Save the marks as a file. */
  download() {
    const name = this.moments.recording.replace(/\.[^.]*$/, "");
    save(exported(this.moments, this.marks.all), `${name}.annotations.json`, "application/json");
  }

  typed_time(text) {
    const seconds = Number(text.trim().replace(",", "."));
    if (text.trim() && Number.isFinite(seconds)) this.go(seconds);
    this.changed();
  }

  /** Draw once, however much changed since the last picture. */
  changed() {
    if (this.drawing || !this.strip) return;
    this.drawing = true;
    requestAnimationFrame(() => {
      this.drawing = false;
      this.draw();
    });
  }

  draw() {
    const { player, marks } = this;
    const time = byId("time");
    if (document.activeElement !== time) time.value = player.at.toFixed(6);
    time.classList.toggle("long", time.value.length > 10);
    byId("speed").value = Math.log10(player.speed);
    byId("speed-text").textContent = `${+player.speed.toPrecision(2)}x`;
    this.play_button.textContent = player.playing ? "❚❚" : "▶";
    this.loop_button.setAttribute("aria-pressed", player.loop !== null);
    if (this.undo_button) this.undo_button.disabled = !marks.can_undo;
    this.tell_duration();
    this.jumps.follow(player.at);
    this.decision.follow(player.at);
    if (this.opened && !player.playing && !this.moments.live) this.link.follow(player.at);
    this.strip.draw(this.jumps.all, marks.all, player, marks.span_start);
  }

  /** Start the viewer where the panel is by then, and show the marks. */
  async start(layout, recording) {
    const started = this.viewer.start(byId("viewer"), layout, recording);
    if (this.marking) await this.marks.load();
    await started;
    await painted(LAYOUT_PAINTS);
    byId("before").hidden = true;
    if (this.moments.live) this.renew();
    if (this.moments.pending) setTimeout(() => this.renew().catch(complain), CAUSES_MS);
    this.opened = true;
    if (this.marking) await this.layer();
    document.documentElement.dataset.state = "ready";
    setInterval(() => this.watch(), 2000);
  }

  /** Return where the page opens [s]: where its address says, else where the moments do. */
  opening() {
    return this.link.asked() ?? this.moments.opens_s;
  }

  tell_duration() {
    const { duration_s, live } = this.moments;
    const { at } = this.player;
    const clock = at >= 60 ? `= ${both_clocks(at).split("= ")[1]} ` : "";
    byId("duration").textContent = `${clock}of ${duration_s.toFixed(1)} s${live ? ", live" : ""}`;
  }

  /** Take what is new of a replay that is running, until it has ended and all causes are known. */
  async renew() {
    const moments = await document_of("moments.json");
    if (moments.pending) setTimeout(() => this.renew().catch(complain), CAUSES_MS);
    if (moments.pending && moments.pending === this.moments.pending) return;
    const ended = this.moments.live && !moments.live;
    Object.assign(this.moments, moments);
    this.player.duration = moments.duration_s;
    this.strip.duration = Math.max(moments.duration_s, 1e-9);
    this.jumps.renew(moments);
    if (!moments.live) {
      this.decision.renew(moments.misses);
      this.tuning.renew(moments);
      if (ended && !this.led) this.player.go(this.opening());
    }
    this.tell_duration();
    this.changed();
    if (moments.live) setTimeout(() => this.renew().catch(complain), RENEW_MS);
  }

  watch() {
    const crash = this.viewer.crash();
    if (!crash) return;
    byId("opening")?.remove();
    byId("before").hidden = false;
    byId("status").textContent = `The viewer crashed: ${crash}. Reload the page.`;
  }
}

/** Wait until the drawing of the opening moment is shown, or cannot be: it goes then. */
async function drawn() {
  const drawing = byId("opening");
  if (!drawing) return;
  const late = new Promise((over) => { setTimeout(over, DRAWING_MS); });
  const shown = drawing.decode().catch(() => drawing.remove());
  await Promise.race([shown, late]);
}

async function main() {
  try {
    const documents = Promise.all([document_of("page.json"), document_of("moments.json")]);
    // it takes longest, and all cores: only words and the drawing come before it
    const program = drawn().then(() => compiled(answer_of("re_viewer_bg.wasm")));
    const viewer = Promise.all([bytes_of("layout.rrd"), bytes_or_address("replay.rrd"), program]);
    viewer.catch(() => {}); // told below, when it is waited for
    const [config, moments] = await documents;
    const page = new Page(config, moments); // its panel answers while the viewer is compiled
    if (!moments.live) page.player.go(page.opening());
    if (page.opening() !== moments.opens_s) byId("opening")?.remove(); // it shows another moment
    performance.mark("panel-shown");
    const [layout, recording] = await viewer;
    await page.start(layout, recording);
  } catch (error) {
    byId("before").hidden = true;
    complain(error.message ?? String(error));
    document.documentElement.dataset.state = "failed";
  }
}

main();
