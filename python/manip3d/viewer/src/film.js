// Player of a sequence of frames: it repeats them at the rate of their camera.

export class Film {
  #request = 0; // of the next animation frame

  /**
   * @param {number} length  frames
   * @param {number} rate  frames a second
   * @param {(frame: number, isPlaying: boolean) => void} onFrame
   */
  constructor(length, rate, onFrame) {
    this.length = length;
    this.rate = rate;
    this.onFrame = onFrame;
    this.frame = 0;
    this.isPlaying = false;
    this.show(0);
  }

  /** Stops at a frame. @param {number} frame */
  show(frame) {
    this.isPlaying = false;
    // Without this, stopping and playing within one animation frame would leave two loops.
    cancelAnimationFrame(this.#request);
    this.#go(frame);
  }

  /** Plays from here on, or stops here. */
  toggle() {
    if (this.isPlaying) return this.show(this.frame);
    this.isPlaying = true;
    const begin = performance.now() - (this.frame / this.rate) * 1000;
    const step = (/** @type {number} */ now) => {
      // Frames are left out where drawing takes longer than they last.
      const frame = Math.floor((Math.max(now - begin, 0) / 1000) * this.rate + 1e-6) % this.length;
      if (frame !== this.frame) this.#go(frame);
      if (this.isPlaying) this.#request = requestAnimationFrame(step);
    };
    this.#request = requestAnimationFrame(step);
    return this.#go(this.frame);
  }

  /** @param {number} frame */
  #go(frame) {
    this.frame = frame;
    this.onFrame(frame, this.isPlaying);
  }
}
