// Draws what an agent's camera shows: ground, buildings, boxes as wire frames, agents and manipulations.

import { TRAIL_FRAMES, drivenPaths, ellipseOf, outcomeOf, sectorOf, velocityOf } from "./above.js";
import { trailOf } from "./marks.js";
import { OUTCOMES, faded, mixed } from "./palette.js";
import { around, colourOfAgent, cross, drawAgentSign, drawDiamond, troubleOf, writeLabel } from "./signs.js";
import { addPath, screenBounds, tracePath } from "./windows.js";

/** m, of the grid around the camera. */
const GRID_M = 10;
const GRID_REACH_M = 120;

/**
 * @param {CameraCanvas} canvas
 * @param {import("./marks.js").Marks} marks
 * @param {import("./perspective.js").CameraMarks} view
 */
export function drawOnGround(canvas, marks, view) {
  const { context, palette, layers, run } = canvas;
  if (layers.paths) drawPathStrips(canvas, view);
  drawGroundGrid(canvas, view);
  for (const mark of marks.agents) drawGroundRange(canvas, view, mark, marks.frame);
  for (const box of marks.boxes) {
    const colour = palette.outcomes[outcomeOf(box)];
    const level = box.z - box.h / 2;
    if (view.own.includes(box.row)) continue;
    if (layers.trails) drawGroundLine(canvas, view, trailOf(run, box.row, TRAIL_FRAMES), level, faded(colour, 0.5), 1.2);
    if (layers.ellipses) drawGroundLine(canvas, view, ellipseOf(box), level, faded(colour, 0.8), 1);
    if (layers.velocity) drawGroundLine(canvas, view, velocityOf(box), level, faded(colour, 0.9), 1.6);
  }
  context.setLineDash([]);
}

/** The points that the agent's lidar returned. */
function drawPointsAhead(canvas, view, frame) {
  const { context, palette, run, width, height } = canvas;
  const { "points.x": x, "points.y": y, "points.z": z } = run.columns;
  const [from, to] = run.pointsAt(frame);
  context.fillStyle = faded(palette.faint, 0.8);
  for (let row = from; row < to; row++) {
    const pixel = view.lens.point([x[row], y[row], z[row]]);
    if (!pixel) continue;
    const [px, py] = canvas.window.toScreen(pixel[0], pixel[1], width, height);
    context.fillRect(px - 0.8, py - 0.8, 1.6, 1.6);
  }
}

/** A line through places on the ground, without what is behind the camera. @param {number[][]} places m */
function drawGroundLine(canvas, view, places, level, colour, width) {
  const { context } = canvas;
  if (places.length < 2) return;
  context.strokeStyle = colour;
  context.lineWidth = width;
  for (let i = 1; i < places.length; i++) {
    const line = view.lens.segment([...places[i - 1], level], [...places[i], level]);
    if (!line) continue;
    tracePath(canvas, line, false);
    context.stroke();
  }
}

function drawGroundGrid(canvas, view) {
  const { context, palette } = canvas;
  const [x, y] = view.lens.eye;
  const [midX, midY] = [Math.round(x / GRID_M) * GRID_M, Math.round(y / GRID_M) * GRID_M];
  const level = view.ground_m;
  context.strokeStyle = palette.grid;
  context.lineWidth = 1;
  for (let step = -GRID_REACH_M; step <= GRID_REACH_M; step += GRID_M) {
    const ends = [
      [[midX + step, midY - GRID_REACH_M, level], [midX + step, midY + GRID_REACH_M, level]],
      [[midX - GRID_REACH_M, midY + step, level], [midX + GRID_REACH_M, midY + step, level]],
    ];
    for (const [from, to] of ends) {
      const line = view.lens.segment(from, to);
      if (!line) continue;
      tracePath(canvas, line, false);
      context.stroke();
    }
  }
}

/** The paths that objects take in the whole run, as strips of their width. */
function drawPathStrips(canvas, view) {
  const { context, palette, run } = canvas;
  const [x, y] = view.lens.eye;
  context.fillStyle = palette.path;
  context.beginPath();
  for (const { pieces } of drivenPaths(run)) {
    for (const piece of pieces) {
      if (Math.hypot(piece[0][0] - x, piece[0][1] - y) > GRID_REACH_M) continue;
      const polygon = view.lens.polygon(piece.map((each) => [each[0], each[1], view.ground_m]));
      if (polygon.length > 2) addPath(canvas, polygon, true);
    }
  }
  context.fill(); // at once: pieces that overlap turn the same way
}

/** The range of a sensor and the space that it found free, on the ground. */
function drawGroundRange(canvas, view, mark, frame) {
  const { context, palette, layers, run } = canvas;
  const agent = run.agents[mark.index];
  const colour = colourOfAgent(mark, palette);
  const emphasis = mark.name === view.agent ? 2 : 1;
  if (layers.space && !mark.down && mark.name === view.agent) { // of others it would cover the whole ground
    const swept = run.swept(mark.index, frame);
    const places = sectorOf(mark, agent.sector, swept).map((place) => [...place, view.ground_m]);
    const polygon = swept.length ? view.lens.polygon(places) : [];
    if (polygon.length > 2) {
      tracePath(canvas, polygon, true);
      context.fillStyle = faded(colour, 0.09);
      context.fill();
    }
  }
  if (layers.ranges) {
    context.setLineDash(mark.down ? [2, 5] : []);
    const places = sectorOf(mark, agent.sector, Array(48).fill(agent.range_m));
    drawGroundLine(canvas, view, [...places, places[0]], view.ground_m, faded(colour, 0.3 * emphasis), 1);
    context.setLineDash([]);
  }
}

/**
 * @typedef {{context: CanvasRenderingContext2D, width: number, height: number, palette: import("./palette.js").Palette,
 *            layers: Record<string, boolean>, run: import("./run.js").Run,
 *            window: import("./windows.js").CameraWindow}} CameraCanvas
 */

/** m: buildings farther away are as pale as the sky. */
const HAZE_M = 220;
/** Of the lines of a box behind a building. */
const PALE = 0.4;

/**
 * Draw a camera's view.
 * @param {CameraCanvas} canvas
 * @param {import("./marks.js").Marks} marks
 * @param {import("./perspective.js").CameraMarks} view
 * @param {import("./marks.js").BoxMark | null} chosen the box under the pointer
 */
export function drawCamera(canvas, marks, view, chosen) {
  const { context, palette, layers } = canvas;
  /** @type {number[][]} */ const taken = [];
  context.lineJoin = "round";
  drawBackground(canvas, view);
  drawOnGround(canvas, marks, view);
  drawWalls(canvas, view);
  if (layers.points && view.agent === canvas.run.scanned) drawPointsAhead(canvas, view, marks.frame);
  const rank = (solid) => OUTCOMES.indexOf(outcomeOf(solid.box)) - 10 * Math.round(solid.distance); // a track and its truth: one place
  const solids = [...view.boxes].sort((a, b) => rank(a) - rank(b));
  for (const faces of view.withheld) drawWithheldBox(canvas, faces);
  for (const solid of solids) drawSolid(canvas, view.lens, solid, solid.row === chosen?.row);
  if (layers.manipulations) for (const effect of view.effects) drawEffectSign(canvas, effect);
  drawImageBorder(canvas, view, palette);
  drawSigns(canvas, view, taken);
  if (layers.ids) for (const solid of [...solids].reverse()) drawSolidId(canvas, solid, taken);
}

/** Sky and ground up to the horizon, also of a camera that is tilted. */
function drawBackground(canvas, view) {
  const { context, width, height, palette } = canvas;
  context.fillStyle = palette.sky;
  context.fillRect(0, 0, width, height);
  /** @type {[number, number][]} */
  const panel = [[0, 0], [width, 0], [width, height], [0, height]].map(([x, y]) => canvas.window.toImage(x, y, width, height));
  const ground = view.lens.belowHorizon(panel);
  if (!ground.length) return;
  tracePath(canvas, ground, true);
  context.fillStyle = palette.ground;
  context.fill();
  context.strokeStyle = palette.building_edge;
  context.lineWidth = 1;
  context.stroke();
}

function drawWalls(canvas, view) {
  const { context, palette } = canvas;
  for (const { distance, polygon } of view.walls) {
    const share = Math.min(distance / HAZE_M, 0.85);
    tracePath(canvas, polygon, true);
    context.fillStyle = mixed(palette.building, palette.sky, share);
    context.fill();
    context.strokeStyle = mixed(palette.building_edge, palette.sky, share);
    context.lineWidth = 1;
    context.stroke();
  }
}

/** A box: the faces behind are pale, those in front hide what is behind them, the front is filled, false ones are crossed. */
function drawSolid(canvas, lens, solid, chosen) {
  const { context, palette } = canvas;
  const outcome = outcomeOf(solid.box);
  const strong = solid.behind && !chosen ? PALE : 1;
  const colour = faded(palette.outcomes[outcome], strong);
  const inside = !solid.faces.some((face) => face.towards);
  context.setLineDash(outcome === "unevaluated" ? [4, 3] : []);
  for (const face of solid.faces) {
    if (face.towards) continue;
    tracePath(canvas, face.polygon, true);
    context.strokeStyle = inside ? colour : faded(palette.outcomes[outcome], 0.3 * strong);
    context.lineWidth = inside ? 1.4 : 1;
    context.stroke();
  }
  const error = outcome === "truth missed" || outcome === "track false";
  for (const face of solid.faces) {
    if (!face.towards) continue;
    tracePath(canvas, face.polygon, true);
    if (!solid.behind) {
      context.fillStyle = faded(palette.ground, 0.4);
      context.fill();
    }
    if (error || face.side === "front") {
      context.fillStyle = faded(palette.outcomes[outcome], (face.side === "front" ? 0.45 : 0.25) * strong);
      context.fill();
    }
    context.strokeStyle = colour;
    context.lineWidth = chosen ? 3 : outcome === "track matched" ? 1.4 : 1.7;
    context.stroke();
  }
  context.setLineDash([]);
  context.strokeStyle = colour;
  context.lineWidth = 1.2;
  for (const line of linesOf(lens, solid.box, outcome === "track false" ? solid.faces : [])) {
    tracePath(canvas, line, false);
    context.stroke();
  }
}

/** The line ahead of a box, on the ground, and the crosses of false ones. @returns {[number, number][][]} px */
function linesOf(lens, box, crossed) {
  const place = (along, across, up) => [
    box.x + along * Math.cos(box.yaw) - across * Math.sin(box.yaw),
    box.y + along * Math.sin(box.yaw) + across * Math.cos(box.yaw),
    box.z + up,
  ];
  const [l, w, h] = [box.l / 2, box.w / 2, box.h / 2];
  const corners = {
    front: [[l, w], [l, -w]], back: [[-l, w], [-l, -w]], left: [[l, w], [-l, w]], right: [[l, -w], [-l, -w]],
  };
  const lines = [lens.segment(place(l, 0, -h), place(l + 1.2, 0, -h))];
  for (const { side, towards } of crossed) {
    const [a, b] = corners[side] ?? [];
    if (a && towards) lines.push(lens.segment(place(...a, -h), place(...b, h)), lens.segment(place(...a, h), place(...b, -h)));
  }
  return lines.filter((line) => line !== null);
}

function drawWithheldBox(canvas, faces) {
  const { context, palette } = canvas;
  context.strokeStyle = palette.withheld;
  context.lineWidth = 1.2;
  context.setLineDash([3, 2]);
  for (const face of faces) {
    if (!face.towards) continue;
    tracePath(canvas, face.polygon, true);
    context.stroke();
  }
  context.setLineDash([]);
}

function drawEffectSign(canvas, { effect, from, to, line, size }) {
  const { context, palette, width, height, window } = canvas;
  const at = to ?? from;
  if (effect === "moved" && line) {
    context.strokeStyle = palette.adversary;
    context.lineWidth = 1.8;
    tracePath(canvas, line, false);
    const [[fromX, fromY], [x, y]] = line.map((each) => window.toScreen(each[0], each[1], width, height));
    const bearing = Math.atan2(y - fromY, x - fromX);
    for (const side of [2.6, -2.6]) {
      context.moveTo(x, y);
      context.lineTo(x + 7 * Math.cos(bearing + side), y + 7 * Math.sin(bearing + side));
    }
    context.stroke();
  }
  if (!at || effect === "moved") return;
  const [x, y] = window.toScreen(at[0], at[1], width, height);
  const half = Math.min(Math.max(9, size * window.scale(width, height)), 160);
  if (effect === "inserted") drawDiamond(context, x, y, half, palette.adversary);
  else cross(context, x, y, 15, palette.adversary);
}

/** Other agents: a sign over the vehicle, or on top of the pole, and a label beside it. */
function drawSigns(canvas, view, taken) {
  const { context, width, height, window, palette } = canvas;
  for (const { mark, at, foot } of view.agents) {
    const [x, y] = window.toScreen(at[0], at[1], width, height);
    if (x < -20 || y < -20 || x > width + 20 || y > height + 20) continue;
    if (foot) {
      context.strokeStyle = palette.faint;
      context.lineWidth = 1;
      tracePath(canvas, foot, false);
      context.stroke();
    }
    const colour = drawAgentSign(canvas, mark, x, y);
    const trouble = troubleOf(mark);
    writeLabel(canvas, trouble ? [mark.name, trouble] : [mark.name], around([x - 13, y - 13, x + 13, y + 13]), colour, taken, { needed: true });
  }
}

function drawSolidId(canvas, solid, taken) {
  const { width, height, window, palette } = canvas;
  if (solid.kind === "truth" && solid.outcome === "matched") return; // the track that matches it has its own
  const [left, top, right, bottom] = screenBounds(window, solid.bounds, width, height);
  if (right < 0 || bottom < 0 || left > width || top > height) return;
  const shown = [Math.max(left, 0), Math.max(top, 18), Math.min(right, width), Math.min(bottom, height - 18)];
  writeLabel(canvas, [String(solid.id)], around(shown), palette.outcomes[outcomeOf(solid.box)], taken, { font: "11px system-ui, sans-serif" });
}

/** What lies outside the image is dimmed: the camera does not see it. */
function drawImageBorder({ context, width, height, window }, view, palette) {
  const [left, top, right, bottom] = screenBounds(window, [0, 0, view.width, view.height], width, height);
  context.fillStyle = faded(palette.ground, 0.6);
  context.beginPath();
  context.rect(0, 0, width, height);
  context.rect(left, bottom, right - left, top - bottom); // the other way round: a hole
  context.fill();
  context.strokeStyle = palette.faint;
  context.lineWidth = 1;
  context.strokeRect(left, top, right - left, bottom - top);
}

/**
 * The box at a pixel of the panel: the nearest, errors before matches, tracks before the truth that they match.
 * @param {import("./perspective.js").CameraMarks} view
 * @param {import("./windows.js").CameraWindow} window
 * @returns {import("./perspective.js").Solid | null}
 */
export function hitSolid(view, window, px, py, width, height) {
  const [u, v] = window.toImage(px, py, width, height);
  const near = 7 / window.scale(width, height);
  let best = null;
  let least = Infinity;
  for (const solid of view.boxes) {
    const [left, top, right, bottom] = solid.bounds;
    const small = right - left < 2 * near && bottom - top < 2 * near;
    const close = Math.hypot((left + right) / 2 - u, (top + bottom) / 2 - v) <= near;
    if (!(small && close) && !solid.faces.some((face) => isInside(face.polygon, u, v))) continue;
    const rank = solid.distance - (solid.outcome === "matched" ? 0 : 2) - (solid.kind === "track" ? 1 : 0);
    if (rank < least) [best, least] = [solid, rank];
  }
  return best;
}

/** Whether a convex polygon holds a point: no part of it is left of any edge, or none right. */
function isInside(polygon, u, v) {
  const sides = polygon.map(([x, y], i) => {
    const [toX, toY] = polygon[(i + 1) % polygon.length];
    return (toX - x) * (v - y) - (toY - y) * (u - x);
  });
  return sides.every((each) => each >= 0) || sides.every((each) => each <= 0);
}
