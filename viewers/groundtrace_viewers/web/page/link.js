/* A link to a moment: #t=94.52&miss=47, read at load and when it changes, kept up while moving. */

/** The address is written when the cursor has rested for so long [ms]. */
const REST_MS = 400;

/** Return the moment of an address: its time [s], or that of a wrong decision; null of none. */
export function moment_of(hash, misses) {
  const said = new URLSearchParams(hash.replace(/^#/, ""));
  const t = said.has("t") ? Number(said.get("t")) : NaN;
  if (Number.isFinite(t)) return t;
  return misses[Number(said.get("miss")) - 1]?.t_s ?? null;
}

export class Link {
  /**
   * @param {() => object[]} misses tells the wrong decisions there are
   * @param {(seconds: number) => void} go moves the cursor
   * @param {(seconds: number) => number} number says which wrong decision is at a time, from 1, or 0
   */
  constructor(misses, go, number) {
    this.number = number;
    this.timer = null;
    this.misses = misses;
    window.addEventListener("hashchange", () => {
      const at = this.asked();
      if (at !== null) go(at);
    });
  }

  /** Return the moment that the address asks for, or null. */
  asked() {
    return moment_of(location.hash, this.misses());
  }

  /** Write the cursor into the address, soon. */
  follow(at) {
    if (this.written === at) return;
    this.written = at;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      const miss = this.number(at);
      const hash = `#t=${+at.toFixed(6)}${miss ? `&miss=${miss}` : ""}`;
      if (hash !== location.hash) history.replaceState(null, "", hash);
    }, REST_MS);
  }
}
