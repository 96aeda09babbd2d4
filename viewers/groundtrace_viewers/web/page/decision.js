/* The wrong decision at the cursor: what, why, gates as bars, what mends it; and thresholds tried in place. */

import { both_clocks, el, say } from "./dom.js";
import { changed_pipeline, save } from "./exchange.js";

/** A wrong decision this far from the cursor is not the one there [s]. */
const NEAR_S = 1;
/** A bar ends at this many doublings from the threshold. */
const REACH = 2;

/** Copy a text, and say so. */
async function copied(text, button) {
  try {
    await navigator.clipboard.writeText(text);
    say(`copied ${text}`);
    button.textContent = "copied";
  } catch {
    button.textContent = "copy failed";
  }
  setTimeout(() => { button.textContent = "copy"; }, 1500);
}

export class Decision {
  /** @param {object[]} misses wrong decisions in the order of time */
  constructor(misses) {
    this.copy = document.getElementById("decision-copy");
    this.copy.onclick = () => copied(`--set ${this.shown.remedy}`, this.copy);
    this.renew(misses);
  }

  /** Take other wrong decisions: those of a replay that has ended. */
  renew(misses) {
    this.misses = misses;
    this.shown = undefined;
    document.getElementById("decision").hidden = !misses.length;
  }

  /** Return the number of the wrong decision at a time, from 1, or 0. */
  number(at) {
    const near = this.misses.reduce((best, m, i) =>
      Math.abs(m.t_s - at) < Math.abs((this.misses[best]?.t_s ?? Infinity) - at) ? i : best, -1);
    return near >= 0 && Math.abs(this.misses[near].t_s - at) <= NEAR_S ? near + 1 : 0;
  }

  /** Show the wrong decision at a time. */
  follow(at) {
    if (!this.misses.length) return;
    const number = this.number(at);
    const miss = number ? this.misses[number - 1] : null;
    if (miss === this.shown) return;
    this.shown = miss;
    const text = (id, words) => { document.getElementById(id).textContent = words; };
    text("decision-number", miss ? `${number} of ${this.misses.length} wrong` : `${this.misses.length} wrong`);
    text("decision-what", miss ? `${miss.kind}, ${both_clocks(miss.t_s)}` : "none at the cursor");
    document.getElementById("decision-what").dataset.kind = miss ? miss.kind : "";
    text("decision-why", miss ? miss.text : "");
    text("decision-effect", miss ? miss.effect : "");
    text("decision-remedy", miss && miss.remedy ? `--set ${miss.remedy}` : "");
    document.getElementById("decision-mend").hidden = !(miss && miss.remedy);
    document.getElementById("decision-gates").replaceChildren(...(miss ? miss.gates : []).map(bar));
  }
}

/** Return a gate as a bar from its threshold: to the right where it passes. */
function bar(gate) {
  const part = Math.min(Math.abs(gate.doublings), REACH) / REACH;
  const value = `${gate.value} (${gate.sign} ${gate.threshold}${gate.unit ? ` ${gate.unit}` : ""})`;
  const fill = el("span", { class: "fill" });
  fill.style.width = `${50 * part}%`;
  fill.style[gate.passed ? "left" : "right"] = "50%";
  const verdict = gate.passed ? "passes" : "fails";
  const groove = el("span", { class: "groove", role: "img", "aria-label": `${gate.name} ${verdict}` }, fill);
  return el("li", { "data-kind": gate.passed ? "good" : "missed" },
    el("span", {}, gate.name), groove, el("span", { class: "value" }, value));
}

export class Tuning {
  /** @param {object} moments with what each value of each threshold would make of the recording */
  constructor(moments) {
    this.which = document.getElementById("tuning-which");
    this.slider = document.getElementById("tuning-value");
    this.which.onchange = () => this.choose();
    this.slider.oninput = () => this.show();
    const copy = document.getElementById("tuning-copy");
    copy.onclick = () => copied(this.setting(), copy);
    document.getElementById("tuning-reset").onclick = () => this.choose();
    this.save = document.getElementById("tuning-save");
    this.save.onclick = () => {
      save(this.changed(), "pipeline.toml", "application/toml");
      say(`pipeline.toml with ${this.setting().replace("--set ", "")}`);
    };
    this.renew(moments);
  }

  /** Take other curves: those of a replay that has ended. */
  renew(moments) {
    const curves = moments.curves ?? [];
    this.pipeline = moments.pipeline ?? "";
    this.curves = curves;
    document.getElementById("tuning").hidden = !curves.length;
    const names = curves.map((c, i) => el("option", { value: String(i) }, `${c.stage}.${c.parameter}`));
    this.which.replaceChildren(...names);
    if (curves.length) this.choose();
  }

  get curve() {
    return this.curves[Number(this.which.value)];
  }

  /** Begin with a threshold as it stands. */
  choose() {
    this.slider.max = String(this.curve.values.length - 1);
    this.slider.value = String(this.now());
    this.show();
  }

  now() {
    return Math.max(0, this.curve.values.indexOf(this.curve.now));
  }

  /** Return the pipeline with the chosen value, or null where it does not say that parameter. */
  changed() {
    const c = this.curve;
    return changed_pipeline(this.pipeline, c.stage, c.parameter, c.values[Number(this.slider.value)]);
  }

  setting() {
    const c = this.curve;
    return `--set ${c.stage}.${c.parameter}=${c.values[Number(this.slider.value)]}`;
  }

  /** Show what the chosen value makes of the steps. */
  show() {
    const c = this.curve;
    const [from, to] = [this.now(), Number(this.slider.value)];
    const changed = (name) => `${name} ${c[name][from]}${from === to ? "" : ` → ${c[name][to]}`}`;
    const unit = c.unit && c.unit !== "1" ? ` ${c.unit}` : "";
    const text = (id, words) => { document.getElementById(id).textContent = words; };
    text("tuning-counts", ["right", "missed", "false"].map(changed).join(", "));
    text("tuning-setting", this.setting());
    this.save.disabled = this.changed() === null;
    this.slider.setAttribute("aria-valuetext", `${c.values[to]}${unit}: ${changed("right")}`);
    const wrong = (i) => c.missed[i] + c.false[i];
    const verdict = wrong(to) < wrong(from) ? "good" : wrong(to) > wrong(from) ? "missed" : "";
    document.getElementById("tuning-counts").dataset.kind = verdict;
  }
}
