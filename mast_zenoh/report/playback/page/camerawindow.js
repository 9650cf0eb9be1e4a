// The part of a camera's image that a panel shows. All panels zoom and pan together.

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
