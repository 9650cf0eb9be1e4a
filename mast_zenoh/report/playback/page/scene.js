// Draws what stands and what is seen, from above: ground, buildings, driven paths, sensor ranges, swept space.

import { colourOfAgent } from "./agents.js";
import { faded } from "./palette.js";

/**
 * @typedef {{context: CanvasRenderingContext2D, width: number, height: number,
 *            viewport: import("./viewport.js").Viewport, palette: import("./palette.js").Palette,
 *            layers: Record<string, boolean>, run: import("./run.js").Run}} Canvas
 */

/** @type {WeakMap<import("./run.js").Run, {key: string, image: HTMLCanvasElement}>} */
const groundsByRun = new WeakMap();

/** What does not change from frame to frame; drawn once for each window. @param {Canvas} canvas */
export function drawGround(canvas) {
  const { context, width, height, viewport, palette, layers, run } = canvas;
  const ratio = context.getTransform().a;
  const key = [width, height, ratio, viewport.x, viewport.y, viewport.half, palette.name, layers.paths, run.rows, run.header.buildings.length].join();
  let ground = groundsByRun.get(run);
  if (!ground || ground.key !== key) {
    const image = ground?.image ?? document.createElement("canvas");
    image.width = context.canvas.width;
    image.height = context.canvas.height;
    const own = /** @type {CanvasRenderingContext2D} */ (image.getContext("2d", { willReadFrequently: true }));
    own.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawStanding({ ...canvas, context: own });
    ground = { key, image };
    groundsByRun.set(run, ground);
  }
  context.drawImage(ground.image, 0, 0, width, height);
}

/** Ground, driven paths, grid and buildings. @param {Canvas} canvas */
function drawStanding(canvas) {
  const { context, width, height, viewport, palette, layers, run } = canvas;
  context.fillStyle = palette.ground;
  context.fillRect(0, 0, width, height);
  if (layers.paths) drawPaths(canvas);
  const step = gridStep(viewport.scale(width, height));
  const [left, bottom] = viewport.toWorld(0, height, width, height);
  const [right, top] = viewport.toWorld(width, 0, width, height);
  context.strokeStyle = palette.grid;
  context.lineWidth = 1;
  context.beginPath();
  for (let x = Math.ceil(left / step) * step; x <= right; x += step) {
    line(canvas, [[x, bottom], [x, top]]);
  }
  for (let y = Math.ceil(bottom / step) * step; y <= top; y += step) {
    line(canvas, [[left, y], [right, y]]);
  }
  context.stroke();
  context.fillStyle = palette.building;
  context.strokeStyle = palette.buildingEdge;
  for (const outline of run.header.buildings) {
    context.beginPath();
    line(canvas, outline);
    context.closePath();
    context.fill();
    context.stroke();
  }
}

/** @param {number} scale px per m @returns {number} m between grid lines */
export function gridStep(scale) {
  return [1, 2, 5, 10, 20, 50, 100, 200, 500].find((step) => step * scale >= 45) ?? 1000;
}

/** Add a line through places in m to the current path. @param {Canvas} canvas @param {number[][]} places */
export function line({ context, viewport, width, height }, places) {
  places.forEach(([x, y], index) => {
    const [px, py] = viewport.toScreen(x, y, width, height);
    if (index) context.lineTo(px, py);
    else context.moveTo(px, py);
  });
}

/** @param {Canvas} canvas */
function drawPaths(canvas) {
  const { context, palette, run, viewport, width, height } = canvas;
  const scale = viewport.scale(width, height);
  context.save();
  context.strokeStyle = palette.path;
  context.lineCap = context.lineJoin = "round";
  for (const path of drivenPaths(run)) {
    context.lineWidth = Math.max(1, path.width * scale);
    context.beginPath();
    line(canvas, path.places);
    context.stroke();
  }
  context.restore();
}

/** @typedef {{places: number[][], width: number, pieces: number[][][]}} DrivenPath m; pieces: corners of its parts */

/** @type {WeakMap<import("./run.js").Run, {rows: number, paths: DrivenPath[]}>} */
const pathsByRun = new WeakMap();

/**
 * The paths that objects take during the whole run: where the roads are.
 * @param {import("./run.js").Run} run
 * @returns {DrivenPath[]}
 */
export function drivenPaths(run) {
  const known = pathsByRun.get(run);
  if (known && known.rows === run.rows) return known.paths;
  const { "box.id": id, "box.truth": truth, "box.x": x, "box.y": y, "box.w": w } = run.columns;
  const paths = [];
  for (let start = 0; start < run.rows && truth[start]; ) {
    let end = start + 1;
    while (end < run.rows && truth[end] && id[end] === id[start]) end++;
    const places = [];
    for (let row = start; row < end; row++) {
      const last = places[places.length - 1];
      if (!last || row === end - 1 || Math.hypot(x[row] - last[0], y[row] - last[1]) > 2) places.push([x[row], y[row]]);
    }
    const width = w[start] + 0.8;
    paths.push({ places, width, pieces: piecesOf(places, width / 2) });
    start = end;
  }
  pathsByRun.set(run, { rows: run.rows, paths });
  return paths;
}

/** Rectangles along a line, all of them counter-clockwise. @param {number[][]} places @param {number} half m, of their width */
function piecesOf(places, half) {
  return places.slice(1).map(([bx, by], index) => {
    const [ax, ay] = places[index];
    const share = half / (Math.hypot(bx - ax, by - ay) || 1);
    const [dx, dy] = [(by - ay) * share, (ax - bx) * share];
    return [[ax + dx, ay + dy], [bx + dx, by + dy], [bx - dx, by - dy], [ax - dx, ay - dy]];
  });
}

/**
 * Draw the range of every sensor, and the space that it found free.
 * @param {Canvas} canvas
 * @param {import("./marks.js").AgentMark[]} agents
 * @param {number} frame
 * @param {string} chosen name of the agent whose estimate is shown
 */
export function drawSensors(canvas, agents, frame, chosen) {
  const { context, palette, layers, run } = canvas;
  for (const mark of agents) {
    const agent = run.agents[mark.index];
    const colour = colourOfAgent(mark, palette);
    const emphasis = mark.name === chosen ? 2 : 1;
    if (layers.space && !mark.down) {
      const swept = run.swept(mark.index, frame);
      if (swept.length) {
        context.fillStyle = faded(colour, 0.045 * emphasis);
        sector(canvas, mark, agent.sector, swept);
        context.fill();
      }
    }
    if (layers.ranges) {
      context.strokeStyle = faded(colour, 0.3 * emphasis);
      context.lineWidth = 1;
      context.setLineDash(mark.down ? [2, 5] : []);
      sector(canvas, mark, agent.sector, Array(48).fill(agent.range_m));
      context.stroke();
      context.setLineDash([]);
    }
  }
}

/** Make the path of a sensor's field of view. */
function sector(canvas, mark, limits, distances) {
  canvas.context.beginPath();
  line(canvas, sectorOf(mark, limits, distances));
  canvas.context.closePath();
}

/**
 * The outline of a sensor's field of view.
 * @param {import("./marks.js").AgentMark} mark
 * @param {[number, number]} limits rad, from the heading
 * @param {number[]} distances m, of equal sectors
 * @returns {number[][]} m
 */
export function sectorOf(mark, [from, to], distances) {
  const places = to - from > 6.28 ? [] : [[mark.x, mark.y]];
  distances.forEach((distance, index) => {
    for (const edge of [index, index + 1]) {
      const bearing = mark.heading + from + ((to - from) * edge) / distances.length;
      places.push([mark.x + distance * Math.cos(bearing), mark.y + distance * Math.sin(bearing)]);
    }
  });
  return places;
}

/** The length of a grid cell, at the lower right. @param {Canvas} canvas */
export function drawScale({ context, viewport, width, height, palette }) {
  const scale = viewport.scale(width, height);
  const step = gridStep(scale);
  const [right, y] = [width - 14, height - 12];
  context.strokeStyle = context.fillStyle = palette.faint;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(right - step * scale, y - 4);
  context.lineTo(right - step * scale, y);
  context.lineTo(right, y);
  context.lineTo(right, y - 4);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "bottom";
  context.textAlign = "right";
  context.fillText(`${step} m`, right, y - 4);
  context.textAlign = "left";
}
