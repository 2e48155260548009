// How finely a moving picture is drawn: as finely as keeps it moving.

export const SCALES = [1, 1 / 2, 1 / 4, 1 / 8]; // of the canvas's sides
const MOST = 50; // milliseconds a frame may take while it moves
const NO_WORSE = 1.25; // times the least: where no scale is quick enough, one that costs about that little

/**
 * Milliseconds of a frame at every scale, from those that were measured. Half as fine, a frame takes between as long (it is
 * vertices that cost) and a quarter (it is pixels): every measurement bounds what the other scales may take.
 */
export class Pace {
  constructor() {
    this.times = null;
  }

  /** Takes the milliseconds that a frame took at a scale. */
  took(scale, milliseconds) {
    const at = SCALES.indexOf(scale);
    this.times = SCALES.map((_, n) => {
      const bounds = [milliseconds, milliseconds * 4 ** (at - n)].sort((a, b) => a - b);
      return Math.min(bounds[1], Math.max(bounds[0], this.times?.[n] ?? milliseconds * 4 ** (at - n)));
    });
  }

  /** The finest scale that is quick enough; before anything was measured, a coarse one. */
  get scale() {
    if (!this.times) return SCALES[2];
    const quick = this.times.findIndex((time) => time <= MOST);
    const least = Math.min(...this.times);
    return SCALES[quick >= 0 ? quick : this.times.findIndex((time) => time <= NO_WORSE * least)];
  }

  /** What a frame at the canvas's full size is thought to take. */
  get full() {
    return this.times?.[0] ?? MOST;
  }

  /** What a frame takes whose pixels cost next to nothing. */
  get least() {
    return this.times?.at(-1) ?? 0;
  }
}
