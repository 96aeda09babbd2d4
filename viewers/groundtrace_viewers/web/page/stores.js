/* Where marks are kept: by the server of `groundtrace annotate`, or in this browser. */

/** Marks kept by the server: safe on its disk before it answers. */
export class ServerStore {
  constructor() {
    this.keeps = "server";
    this.drawn = 0;
  }

  async ask(method, path, body) {
    const answer = await fetch(`api/${path}`, {
      method,
      headers: { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
    if (answer.ok) return answer;
    const found = await answer.json().catch(() => ({ error: `status ${answer.status}` }));
    throw new Error(found.error);
  }

  async load() {
    return await (await this.ask("GET", "annotations")).json();
  }

  async add(mark, author) {
    return await (await this.ask("POST", "annotations", { author, mark })).json();
  }

  async edit(id, mark, author) {
    return await (await this.ask("PUT", `annotations/${encodeURIComponent(id)}`, { author, mark })).json();
  }

  async remove(id, author) {
    return await (await this.ask("DELETE", `annotations/${encodeURIComponent(id)}`, { author })).json();
  }

  async undo(author) {
    return await (await this.ask("POST", "undo", { author })).json();
  }

  /** Return the bytes of the layer that shows the marks of a revision, or null where it is drawn. */
  async layer(revision) {
    if (revision === this.drawn) return null;
    const answer = await this.ask("GET", `layer.rrd?drawn=${this.drawn}`);
    this.drawn = revision;
    return new Uint8Array(await answer.arrayBuffer());
  }
}

/** Marks kept in this browser, for pages that nobody serves; a download takes them elsewhere. */
export class BrowserStore {
  /** @param {object[]} given marks that came with the page */
  constructor(moments, given) {
    this.moments = moments;
    this.given = given;
    this.name = `groundtrace:${moments.sha256 || moments.recording}`;
    this.keeps = "browser";
  }

  /** Return what is kept here; what came with the page joins it once, so that deleting it lasts. */
  read() {
    const kept = localStorage.getItem(this.name);
    const state = { author: "", marks: [], past: [], seen: [], ...(kept ? JSON.parse(kept) : {}) };
    const known = new Set([...state.seen, ...state.marks.map((mark) => mark.id)]);
    const joining = this.given.filter((mark) => !known.has(mark.id));
    const marks = [...state.marks, ...joining].sort((a, b) => a.time_s - b.time_s);
    return { ...state, marks, seen: [...state.seen, ...joining.map((mark) => mark.id)] };
  }

  write(state) {
    localStorage.setItem(this.name, JSON.stringify(state));
    return { ...state, undo: state.past.length > 0 };
  }

  async load() {
    const state = this.read();
    return { ...state, undo: state.past.length > 0 };
  }

  change(author, id, marks_of) {
    const state = this.read();
    const past = [...state.past, state.marks].slice(-50);
    const marks = marks_of(state.marks).sort((a, b) => a.time_s - b.time_s);
    return { ...this.write({ ...state, author, marks, past }), id };
  }

  async add(mark, author) {
    const id = Array.from(crypto.getRandomValues(new Uint8Array(6)), (b) => b.toString(16).padStart(2, "0")).join("");
    const now = Date.now() * 1e6;
    const kept = { ...mark, id, author: author || "annotator", created_ns: now, edited_ns: now };
    return this.change(author, id, (marks) => [...marks, kept]);
  }

  async edit(id, mark, author) {
    const edited_ns = Date.now() * 1e6;
    return this.change(author, id, (marks) =>
      marks.map((kept) => (kept.id === id ? { ...kept, ...mark, edited_ns } : kept)));
  }

  async remove(id, author) {
    return this.change(author, null, (marks) => marks.filter((kept) => kept.id !== id));
  }

  async undo(author) {
    const state = this.read();
    const marks = state.past.at(-1) ?? state.marks;
    return { ...this.write({ ...state, author, marks, past: state.past.slice(0, -1) }), id: null };
  }

  async layer() {
    return null;
  }
}
