/* The strip: events, wrong decisions and marks over the whole recording, and the cursor. */

import { STEPS, WRONG } from "./jumps.js";

export class Strip {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {number} duration [s]
   * @param {(seconds: number) => void} go moves the cursor
   */
  constructor(canvas, duration, go) {
    this.canvas = canvas;
    this.duration = Math.max(duration, 1e-9);
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const seek = (event) => {
      if (event.buttons !== 1) return;
      const box = canvas.getBoundingClientRect();
      go(((event.clientX - box.left) / box.width) * this.duration);
    };
    canvas.addEventListener("pointerdown", seek);
    canvas.addEventListener("pointermove", seek);
  }

  /** Draw everything: lanes of events, wrong decisions and marks, the loop and the cursor. */
  draw(moments, marks, player, span_start) {
    const box = this.canvas.getBoundingClientRect();
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(box.width * scale), Math.round(box.height * scale)];
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
    const pen = this.canvas.getContext("2d");
    const x = (seconds) => (seconds / this.duration) * width;
    const lane = (colour, from, to, at, end = at) => {
      pen.fillStyle = this.colour(colour);
      pen.fillRect(x(at), from * height, Math.max(scale, x(end) - x(at)), (to - from) * height);
    };
    pen.clearRect(0, 0, width, height);
    pen.globalAlpha = 0.25;
    if (player.loop) lane("accent", 0, 1, ...player.loop);
    if (span_start !== null) lane("mark", 0.66, 1, Math.min(span_start, player.at), Math.max(span_start, player.at));
    pen.globalAlpha = 0.8;
    for (const m of moments) if (STEPS.has(m.kind)) lane("step", 0.06, 0.32, m.t_s);
    pen.globalAlpha = 1;
    for (const m of moments) if (WRONG.has(m.kind)) lane(m.kind === "false" ? "false" : "missed", 0.36, 0.62, m.t_s);
    for (const m of marks) lane("mark", 0.68, 0.94, m.time_s, m.end_s ?? m.time_s);
    pen.fillStyle = this.colour("strong");
    pen.fillRect(x(player.at) - scale / 2, 0, 1.5 * scale, height);
  }
}
