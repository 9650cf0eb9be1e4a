// Windows onto the world and onto a camera's image: where they are, and how metres or pixels become pixels.

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
   * @param {number[][]} agents m: all of them
   * @param {number[][]} places m, of objects
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

const CLOSEST = 40;
const FARTHEST = 0.4;

/** What all camera views share: zoom, and the middle as shares of the image's width and height. */
export function wholeImage() {
  return { zoom: 1, x: 0.5, y: 0.5 };
}

export class CameraWindow {
  /** @param {{zoom: number, x: number, y: number}} shared @param {{width: number, height: number}} image px */
  constructor(shared, image) {
    this.shared = shared;
    this.image = image;
  }

  /** @param {number} width px of the panel @param {number} height @returns {number} px of the panel per px of the image */
  scale(width, height) {
    return this.shared.zoom * Math.min(width / this.image.width, height / this.image.height);
  }

  /** @returns {[number, number]} px of the panel */
  toScreen(u, v, width, height) {
    const scale = this.scale(width, height);
    const { x, y } = this.shared;
    return [width / 2 + (u - x * this.image.width) * scale, height / 2 + (v - y * this.image.height) * scale];
  }

  /** @returns {[number, number]} px of the image */
  toImage(px, py, width, height) {
    const scale = this.scale(width, height);
    const { x, y } = this.shared;
    return [x * this.image.width + (px - width / 2) / scale, y * this.image.height + (py - height / 2) / scale];
  }

  /** Zoom so that what is under a pixel stays there. @param {number} factor above 1: closer */
  zoomAt(factor, px, py, width, height) {
    const [u, v] = this.toImage(px, py, width, height);
    this.shared.zoom = Math.min(Math.max(this.shared.zoom * factor, FARTHEST), CLOSEST);
    const [newU, newV] = this.toImage(px, py, width, height);
    this.shared.x += (u - newU) / this.image.width;
    this.shared.y += (v - newV) / this.image.height;
  }

  /** @param {number} dx px @param {number} dy px */
  pan(dx, dy, width, height) {
    const scale = this.scale(width, height);
    this.shared.x -= dx / scale / this.image.width;
    this.shared.y -= dy / scale / this.image.height;
  }
}

/**
 * Make a path of pixels of the image.
 * @param {import("./camera.js").CameraCanvas} canvas
 * @param {number[][]} pixels
 * @param {boolean} closed
 */
export function tracePath(canvas, pixels, closed) {
  canvas.context.beginPath();
  addPath(canvas, pixels, closed);
}

/** Add pixels of the image to the current path. */
export function addPath({ context, window, width, height }, pixels, closed) {
  pixels.forEach(([u, v], index) => {
    const [x, y] = window.toScreen(u, v, width, height);
    if (index) context.lineTo(x, y);
    else context.moveTo(x, y);
  });
  if (closed) context.closePath();
}

/**
 * A rectangle of the image on the panel.
 * @param {CameraWindow} window
 * @param {number[]} bounds px of the image: left, top, right, bottom
 * @returns {number[]} px of the panel
 */
export function screenBounds(window, [left, top, right, bottom], width, height) {
  return [...window.toScreen(left, top, width, height), ...window.toScreen(right, bottom, width, height)];
}
