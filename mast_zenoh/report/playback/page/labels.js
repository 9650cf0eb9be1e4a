// Writes labels beside what they mark, where no other label is.

/** @typedef {(wide: number, high: number) => [number, number][]} Places upper left corners for a label of a size, px */

/** px: height of a line. */
const LINE = 14;

/**
 * Write lines at the first free place.
 * @param {{context: CanvasRenderingContext2D, width: number, height: number, palette: import("./palette.js").Palette}} canvas
 * @param {string[]} lines
 * @param {Places} places to try, the best first
 * @param {string} colour
 * @param {number[][]} taken left, top, right and bottom of all labels so far; the new one is added
 * @param {{font?: string, needed?: boolean}} [style] needed: written at the first place even if that is taken
 * @returns {number[] | null} where it is; null: nowhere
 */
export function writeLabel(canvas, lines, places, colour, taken, { font = "600 12px system-ui, sans-serif", needed = false } = {}) {
  const { context, width, height, palette } = canvas;
  context.font = font;
  const wide = Math.max(...lines.map((text) => context.measureText(text).width));
  const high = LINE * lines.length;
  const tried = places(wide, high);
  const free = tried.find(([left, top]) => {
    const inside = left >= 2 && top >= 2 && left + wide <= width - 2 && top + high <= height - 2;
    return inside && !taken.some((box) => left < box[2] && box[0] < left + wide && top < box[3] && box[1] < top + high);
  });
  if (!free && !needed) return null;
  const [left, top] = free ?? tried[0];
  const place = [left, top, left + wide, top + high];
  taken.push(place);
  context.textAlign = "left";
  context.textBaseline = "top";
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeStyle = palette.ground;
  context.fillStyle = colour;
  lines.forEach((text, index) => {
    context.strokeText(text, left, top + LINE * index);
    context.fillText(text, left, top + LINE * index);
  });
  return place;
}

/**
 * Places above, below and beside a rectangle.
 * @param {number[]} box left, top, right and bottom
 * @returns {Places}
 */
export function around([left, top, right, bottom]) {
  return (wide, high) => {
    const [middle, level] = [(left + right - wide) / 2, (top + bottom - high) / 2];
    return [[middle, top - high - 2], [middle, bottom + 3], [right + 4, level], [left - wide - 4, level], [right + 2, top - high - 2]];
  };
}

/** @param {number[][]} places @returns {number[]} left, top, right, bottom */
export function boundsOf(places) {
  const [across, down] = [places.map((each) => each[0]), places.map((each) => each[1])];
  return [Math.min(...across), Math.min(...down), Math.max(...across), Math.max(...down)];
}
