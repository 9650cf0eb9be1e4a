// Draws what stands and what sees: ground, buildings, driven paths, sensor ranges, swept space, agents.

import { faded } from "./palette.js";

/**
 * @typedef {{context: CanvasRenderingContext2D, width: number, height: number,
 *            viewport: import("./viewport.js").Viewport, palette: import("./palette.js").Palette,
 *            layers: Record<string, boolean>, run: import("./run.js").Run}} Canvas
 */

/** @param {Canvas} canvas */
export function drawGround(canvas) {
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

/** The paths that objects take during the whole run: where the roads are. @param {Canvas} canvas */
function drawPaths(canvas) {
  const { context, palette, run, viewport, width, height } = canvas;
  const scale = viewport.scale(width, height);
  context.save();
  context.strokeStyle = palette.path;
  context.lineCap = context.lineJoin = "round";
  for (const path of run.paths()) {
    context.lineWidth = Math.max(1, (path.width + 0.8) * scale);
    context.beginPath();
    line(canvas, path.places);
    context.stroke();
  }
  context.restore();
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

/** Make the path of a sensor's field of view. @param {number[]} distances m, of equal sectors */
function sector(canvas, mark, [from, to], distances) {
  const places = [];
  const full = to - from > 6.28;
  if (!full) places.push([mark.x, mark.y]);
  distances.forEach((distance, index) => {
    for (const edge of [index, index + 1]) {
      const bearing = mark.heading + from + ((to - from) * edge) / distances.length;
      places.push([mark.x + distance * Math.cos(bearing), mark.y + distance * Math.sin(bearing)]);
    }
  });
  canvas.context.beginPath();
  line(canvas, places);
  canvas.context.closePath();
}

/** @param {import("./marks.js").AgentMark} mark @param {import("./palette.js").Palette} palette */
export function colourOfAgent(mark, palette) {
  if (mark.down) return palette.faint;
  if (mark.state) return palette.states[mark.state];
  return mark.adversaries.length ? palette.adversary : palette.agent;
}

/** @param {import("./marks.js").AgentMark} mark @returns {string} what is wrong with it; empty: nothing */
export function troubleOf(mark) {
  if (mark.down) return "down";
  const troubles = mark.state === "faulty" || mark.state === "suspended" ? [mark.state] : [];
  if (mark.cutOff) troubles.push("cut off");
  return troubles.join(", ");
}

/** @param {Canvas} canvas @param {import("./marks.js").AgentMark[]} agents */
export function drawAgents(canvas, agents) {
  const { context, viewport, width, height, palette } = canvas;
  /** @type {number[][]} */ const taken = [];
  for (const mark of agents) {
    const [x, y] = viewport.toScreen(mark.x, mark.y, width, height);
    if (x < -20 || y < -20 || x > width + 20 || y > height + 20) continue;
    const colour = colourOfAgent(mark, palette);
    context.strokeStyle = colour;
    context.fillStyle = colour;
    context.lineWidth = 2;
    context.beginPath();
    if (mark.kind === "static") {
      context.moveTo(x, y - 7);
      context.lineTo(x + 6, y + 5);
      context.lineTo(x - 6, y + 5);
      context.closePath();
      context.fill();
    } else {
      context.arc(x, y, 6.5, 0, 7);
      context.stroke();
    }
    if (mark.down) cross(context, x, y, 10, palette.ink);
    if (mark.adversaries.length) {
      context.strokeStyle = palette.adversary;
      context.lineWidth = mark.lying ? 2.5 : 1.2;
      context.setLineDash(mark.lying ? [] : [3, 3]);
      context.beginPath();
      context.arc(x, y, 12, 0, 7);
      context.stroke();
      context.setLineDash([]);
    }
    const trouble = troubleOf(mark);
    const lines = trouble ? [mark.name, trouble] : [mark.name];
    label(canvas, lines, x, y, mark.adversaries.length ? palette.adversary : colour, taken, mark.heading);
  }
}

/** @param {CanvasRenderingContext2D} context */
export function cross(context, x, y, size, colour) {
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(x - size / 2, y - size / 2);
  context.lineTo(x + size / 2, y + size / 2);
  context.moveTo(x - size / 2, y + size / 2);
  context.lineTo(x + size / 2, y - size / 2);
  context.stroke();
}

/** Write lines beside a place, where no earlier label is. @param {number[][]} taken left, top, right, bottom */
function label({ context, width, height, palette }, lines, x, y, colour, taken, heading) {
  context.font = "600 12px system-ui, sans-serif";
  context.textBaseline = "top";
  const wide = Math.max(...lines.map((text) => context.measureText(text).width));
  const high = 14 * lines.length;
  const behind = [Math.cos(heading) > 0 ? -wide - 15 : 15, Math.sin(heading) > 0 ? 8 : -high - 8];
  const places = [behind, [15, -high - 4], [15, 6], [-wide - 15, -high - 4], [-wide - 15, 6], [-wide / 2, 16]];
  const free = places.find(([dx, dy]) => {
    const [left, top] = [x + dx, y + dy];
    const inside = left >= 2 && top >= 2 && left + wide <= width - 2 && top + high <= height - 2;
    return inside && !taken.some((box) => left < box[2] && box[0] < left + wide && top < box[3] && box[1] < top + high);
  });
  const [dx, dy] = free ?? places[1];
  taken.push([x + dx, y + dy, x + dx + wide, y + dy + high]);
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeStyle = palette.ground;
  context.fillStyle = colour;
  lines.forEach((text, index) => {
    context.strokeText(text, x + dx, y + dy + 14 * index);
    context.fillText(text, x + dx, y + dy + 14 * index);
  });
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
