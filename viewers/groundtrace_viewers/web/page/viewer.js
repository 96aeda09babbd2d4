/* The viewer: starts it, moves its cursor, hears where it is, and adds layers to the recording. */

const PAUSED = 1;
/** So many times that were set are remembered, to know the viewer's echo from a person's hand. */
const ECHOES = 64;
/** A viewer that cannot move its cursor yet is asked again after this [ms]. */
const RETRY_MS = 50;
/** A viewer that has opened a recording and says no more has it after this [ms]. */
const SILENT_MS = 5000;

/** Messages of a recording: the data of a store, and that a layout is shown from now on; a store that is a layout. */
const DATA = 2, SHOWN = 3, LAYOUT = 2;
/** Bytes of a file's head and of what is before each message: its kind and length, 8 bytes each. */
const HEAD = 12, MESSAGE = 16;
/** A recording is given to the viewer in pieces of so many bytes. */
const PIECE = 1 << 18;

/** Return a number as the bytes of a protobuf varint. */
function varint(value) {
  const bytes = [];
  let rest = BigInt(value);
  do {
    const low = Number(rest & 127n);
    rest >>= 7n;
    bytes.push(rest ? low | 128 : low);
  } while (rest);
  return bytes;
}

/** Return a protobuf field that holds bytes. */
function field(number, bytes) {
  return [...varint((number << 3) | 2), ...varint(bytes.length), ...bytes];
}

/** Return the viewer's control message that puts the cursor at a time and pauses. */
export function cursor_message(timeline, ns) {
  const name = field(2, field(1, [...new TextEncoder().encode(timeline)]));
  const time = field(3, [8, ...varint(ns)]);
  return new Uint8Array(field(6, [...name, ...time, ...varint(5 << 3), PAUSED]));
}

/** Yield the kind of each message of a recording, where it begins and where it ends. */
function* messages(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  for (let at = HEAD, next; at + MESSAGE <= bytes.length; at = next) {
    next = at + MESSAGE + Number(view.getBigUint64(at + 8, true));
    if (next > bytes.length) return;
    yield [Number(view.getBigUint64(at, true)), at, next];
  }
}

/** Return a recording's bytes in pieces that are recordings themselves: the file's head, and some messages. */
export function pieces(bytes) {
  const head = bytes.subarray(0, HEAD), found = [];
  let start = HEAD, end = HEAD;
  for (const [, , next] of messages(bytes)) {
    end = next;
    if (end - start < PIECE) continue;
    found.push(joined([head, bytes.subarray(start, end)]));
    start = end;
  }
  found.push(joined([head, bytes.subarray(start, end)])); // behind the last message a file only says where others are
  return found;
}

/**
 * Return a recording's bytes without its layout, which the viewer has already.
 *
 * A layout that comes in several pictures, while another is shown, the viewer forgets in part: a busy one then
 * showed one view of many for good.
 */
export function without_layout(bytes) {
  const kept = [bytes.subarray(0, HEAD)];
  for (const [kind, at, next] of messages(bytes)) {
    if (!of_layout(kind, bytes.subarray(at + MESSAGE, next))) kept.push(bytes.subarray(at, next));
  }
  return joined(kept);
}

/** Return whether a message shows a layout, or holds data of one: a protobuf whose first field is the store. */
function of_layout(kind, content) {
  if (kind === SHOWN) return true;
  return kind === DATA && content[0] === 10 && content[2] === 8 && content[3] === LAYOUT;
}

/** Return bytes one behind the other. */
function joined(parts) {
  const whole = new Uint8Array(parts.reduce((size, part) => size + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

/** Wait until so many pictures have been drawn. */
export async function painted(count) {
  for (let i = 0; i < count; i += 1) await new Promise((later) => { requestAnimationFrame(later); });
}

/** Compile the viewer, while its program is still read. */
export async function compiled(answer) {
  await wasm_bindgen({ module_or_path: answer });
  performance.mark("viewer-compiled");
}

export class Viewer {
  /**
   * @param {string} timeline its name
   * @param {(seconds: number) => void} moved hears where a person put the viewer's cursor
   */
  constructor(timeline, moved) {
    this.timeline = timeline;
    this.moved = moved;
    this.sent = [];
    this.busy = false;
    this.next_ns = null;
    this.chrome = false;
    this.opened = new Promise((resolve) => { this.resolve = resolve; });
  }

  /**
   * Start the compiled viewer in a canvas and open a recording: its bytes or its address.
   *
   * The layout goes first: without one the viewer makes its own, and then keeps that. A time that was wished
   * for before is where it opens.
   */
  async start(canvas, layout, recording) {
    this.handle = new wasm_bindgen.WebHandle({
      url: [],
      hide_welcome_screen: true,
      check_for_updates_on_startup: false,
      enable_history: false,
      notebook: false,
      persist: false,
      theme: "dark", // in its light theme names on dark pictures are hard to read
      render_backend: new URLSearchParams(location.search).get("renderer"),
      panel_state_overrides: { top: "Hidden" },
      on_viewer_event: (text) => this.heard(JSON.parse(text)),
    });
    await this.handle.start(canvas);
    performance.mark("viewer-started");
    for (const field of document.querySelectorAll("#stage input")) {
      field.setAttribute("aria-label", "Typing in the viewer");
      field.tabIndex = -1;
    }
    if (layout.length) this.push(layout, "layout");
    if (typeof recording === "string") this.handle.add_receiver(recording);
    else await this.pour(recording);
    if (this.next_ns !== null) await this.seek(this.next_ns / 1e9);
    await this.opened;
    performance.mark("recording-opened");
  }

  heard(event) {
    // The layout opens the recording; that it has a time, or stands still, says that there are data.
    // Data that are there before the first picture change no time: then it only stands still, or says
    // nothing more at all.
    if (event.type === "recording_open") setTimeout(this.resolve, SILENT_MS);
    const timed = event.type === "time_update" || event.type === "timeline_change";
    if (timed || event.type === "pause" || event.type === "play") this.resolve();
    if (!timed) return;
    const ns = Math.round(event.time);
    if (this.busy || this.sent.includes(ns)) return;
    this.moved(ns / 1e9);
  }

  /** Put the cursor at a time [s]; while the viewer is busy only the last wish is kept. */
  async seek(seconds) {
    this.next_ns = Math.max(0, Math.round(seconds * 1e9));
    if (this.busy || !this.handle) return;
    this.busy = true;
    while (this.next_ns !== null) {
      const ns = this.next_ns;
      this.next_ns = null;
      this.sent = [ns, ...this.sent].slice(0, ECHOES);
      try {
        await this.handle.viewer_control(cursor_message(this.timeline, ns));
      } catch {
        // It is painting, or has not read the first data yet: the same wish again, if no newer one.
        await new Promise((later) => { setTimeout(later, RETRY_MS); });
        if (!this.crash()) this.next_ns ??= ns;
      }
    }
    this.busy = false;
  }

  /** Add a layer: the bytes of a recording with the same ids. */
  push(bytes, name) {
    const id = `${name}-${performance.now()}`;
    this.handle.open_channel(id, name);
    this.handle.send_rrd_to_channel(id, bytes);
    this.handle.close_channel(id);
  }

  /** Add a recording piece by piece: of a large one at once the viewer made a layout of its own, and stood still. */
  async pour(bytes) {
    this.handle.open_channel("replay", "replay");
    for (const piece of pieces(without_layout(bytes))) {
      this.handle.send_rrd_to_channel("replay", piece);
      await painted(1);
    }
    this.handle.close_channel("replay");
  }

  /** Show or hide the viewer's own menu bar. */
  toggle_menu() {
    this.chrome = !this.chrome;
    this.handle.override_panel_state("top", this.chrome ? null : "hidden");
  }

  /** Return what the viewer said when it crashed, or null. */
  crash() {
    return this.handle && this.handle.has_panicked() ? this.handle.panic_message() : null;
  }
}
