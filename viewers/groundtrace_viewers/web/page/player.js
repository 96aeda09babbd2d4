/* The page's clock: where the cursor is, how fast it moves, and where it turns around. */

export const SLOWEST = 0.05;
export const FASTEST = 20;
/** A loop reaches so far to both sides of an event [s]. */
export const LOOP_S = 0.5;

export class Player {
  /**
   * @param {number} duration [s]
   * @param {(seconds: number) => void} show puts the viewer's cursor
   * @param {() => void} changed hears that anything changed
   */
  constructor(duration, show, changed) {
    this.duration = duration;
    this.show = show;
    this.changed = changed;
    this.at = 0;
    this.speed = 1;
    this.playing = false;
    this.loop = null;
    this.last = null;
  }

  /** Go to a time [s]; a loop that does not hold it ends. */
  go(seconds) {
    this.at = Math.min(Math.max(seconds, 0), this.duration);
    if (this.loop && (this.at < this.loop[0] || this.at > this.loop[1])) this.loop = null;
    this.show(this.at);
    this.changed();
  }

  /** Take over where a person put the viewer's cursor. */
  follow(seconds) {
    this.at = Math.min(Math.max(seconds, 0), this.duration);
    if (this.loop && (this.at < this.loop[0] || this.at > this.loop[1])) this.loop = null;
    this.changed();
  }

  play(wanted = !this.playing) {
    if (wanted && !this.loop && this.at >= this.duration) this.at = 0;
    this.playing = wanted;
    this.last = null;
    if (wanted) requestAnimationFrame((now) => this.tick(now));
    this.changed();
  }

  set_speed(speed) {
    this.speed = Math.min(Math.max(speed, SLOWEST), FASTEST);
    this.changed();
  }

  /** Loop around a time [s], or stop looping. */
  toggle_loop(around) {
    if (this.loop) {
      this.loop = null;
      this.play(false);
      return;
    }
    this.loop = [Math.max(0, around - LOOP_S), Math.min(this.duration, around + LOOP_S)];
    this.go(this.loop[0]);
    this.play(true);
  }

  tick(now) {
    if (!this.playing) return;
    const passed = this.last === null ? 0 : (now - this.last) / 1000;
    this.last = now;
    let at = this.at + passed * this.speed;
    const [first, end] = this.loop ?? [0, this.duration];
    if (at >= end) {
      if (!this.loop) {
        this.playing = false;
        this.go(end);
        return;
      }
      at = first + ((at - first) % Math.max(end - first, 1e-3));
    }
    this.at = at;
    this.show(at);
    this.changed();
    requestAnimationFrame((later) => this.tick(later));
  }
}
