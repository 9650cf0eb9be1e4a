// The window onto the world: where it is, and how metres become pixels. Shared by all panels.

const SMALLEST_M = 4;
const LARGEST_M = 3000;
/** m: agents and objects farther than this from the followed agent do not widen the first window. */
const MATTERS_M = 105;
/** Share of the objects at either side that may lie outside the first window. */
const OUTLIERS = 0.04;

export class Viewport {
  constructor() {
    this.x = 0;
    this.y = 0;
    /** m, half of the shorter side */
    this.half = 40;
  }

  /** @param {number} width px @param {number} height px @returns {number} px per m */
  scale(width, height) {
    return Math.min(width, height) / (2 * this.half);
  }

  /** @returns {[number, number]} px of a place in m */
  toScreen(x, y, width, height) {
    const scale = this.scale(width, height);
    return [width / 2 + (x - this.x) * scale, height / 2 - (y - this.y) * scale];
  }

  /** @returns {[number, number]} m of a pixel */
  toWorld(px, py, width, height) {
    const scale = this.scale(width, height);
    return [this.x + (px - width / 2) / scale, this.y - (py - height / 2) / scale];
  }

  /** Zoom so that the place under a pixel stays there. @param {number} factor above 1: closer */
  zoomAt(factor, px, py, width, height) {
    const [x, y] = this.toWorld(px, py, width, height);
    this.half = Math.min(Math.max(this.half / factor, SMALLEST_M), LARGEST_M);
    const [newX, newY] = this.toWorld(px, py, width, height);
    this.x += x - newX;
    this.y += y - newY;
  }

  /** @param {number} dx px @param {number} dy px */
  pan(dx, dy, width, height) {
    const scale = this.scale(width, height);
    this.x -= dx / scale;
    this.y += dy / scale;
  }

  /**
   * Show what matters: the places around a centre, without the outermost few.
   * @param {[number, number][]} agents m: all of them
   * @param {[number, number][]} places m, of objects
   * @param {[number, number] | null} centre m
   * @param {number} aspect width by height of the panel
   */
  fit(agents, places, centre, aspect) {
    const matters = ([x, y]) => !centre || Math.hypot(x - centre[0], y - centre[1]) <= MATTERS_M;
    const [always, mostly] = [agents.filter(matters), places.filter(matters)];
    if (!always.length && !mostly.length) return;
    const [left, right] = limits(always.map((place) => place[0]), mostly.map((place) => place[0]));
    const [bottom, top] = limits(always.map((place) => place[1]), mostly.map((place) => place[1]));
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    const [across, up] = [(right - left) / 2 + 8, (top - bottom) / 2 + 8];
    this.half = Math.max(20, aspect >= 1 ? Math.max(across / aspect, up) : Math.max(across, up * aspect));
  }
}

/** @param {number[]} always @param {number[]} mostly @returns {[number, number]} between which all but few of them are */
function limits(always, mostly) {
  const sorted = [...mostly].sort((a, b) => a - b);
  const cut = Math.floor(sorted.length * OUTLIERS);
  const inner = sorted.slice(cut, sorted.length - cut);
  return [Math.min(...always, ...inner), Math.max(...always, ...inner)];
}
