// Draws the boxes of an estimate, their motion and uncertainty, and what adversaries did to them.

import { cross, drawDiamond } from "./agents.js";
import { around, boundsOf, writeLabel } from "./labels.js";
import { trailOf } from "./marks.js";
import { faded, OUTCOMES } from "./palette.js";
import { line } from "./scene.js";

/** m: smaller boxes are drawn this large, so that pedestrians are visible. */
const DRAWN_M = 1.4;
/** s, of motion that a velocity arrow stands for. */
const AHEAD_S = 1;
/** px: labels may cover boxes larger than this. */
const LARGE = 90;
/** Frames that a trail goes back. */
export const TRAIL_FRAMES = 25;

/** @param {import("./marks.js").BoxMark} box @returns {string} its key in the palette */
export function outcomeOf(box) {
  if (box.outcome === "scene") return "truth matched";
  return box.outcome === "unevaluated" ? box.outcome : `${box.kind} ${box.outcome}`;
}

/**
 * Draw all boxes of a view, errors on top.
 * @param {import("./scene.js").Canvas} canvas
 * @param {import("./marks.js").Marks} marks
 * @param {import("./marks.js").BoxMark | null} chosen the box under the pointer
 * @param {number[][]} taken by what labels must not cover; the boxes are added
 */
export function drawBoxes(canvas, marks, chosen, taken) {
  const { layers, palette } = canvas;
  const ordered = [...marks.boxes].sort((a, b) => OUTCOMES.indexOf(outcomeOf(a)) - OUTCOMES.indexOf(outcomeOf(b)));
  if (layers.trails) for (const box of ordered) drawTrail(canvas, box);
  if (layers.ellipses) for (const box of ordered) drawEllipse(canvas, box);
  for (const box of marks.withheld) drawWithheld(canvas, box);
  for (const box of ordered) drawBox(canvas, box, box.row === chosen?.row);
  if (layers.velocity) for (const box of ordered) drawVelocity(canvas, box);
  for (const box of ordered) {
    const bounds = screenBoundsOf(canvas, box);
    if (bounds[2] - bounds[0] < LARGE && bounds[3] - bounds[1] < LARGE) taken.push(bounds);
  }
  if (layers.manipulations) for (const effect of marks.effects) drawEffect(canvas, effect, palette.adversary);
}

/**
 * Write the ids of boxes, errors first, where there is room.
 * @param {import("./scene.js").Canvas} canvas
 * @param {import("./marks.js").Marks} marks
 * @param {number[][]} taken by boxes, signs and labels
 */
export function drawIds(canvas, marks, taken) {
  const rank = (box) => -OUTCOMES.indexOf(outcomeOf(box));
  for (const box of [...marks.boxes].sort((a, b) => rank(a) - rank(b))) drawId(canvas, box, taken);
}

/** @param {{x: number, y: number, l: number, w: number, yaw: number}} box @returns {number[][]} its corners, m */
export function cornersOf(box) {
  const [l, w] = [Math.max(box.l, DRAWN_M) / 2, Math.max(box.w, DRAWN_M) / 2];
  const [cos, sin] = [Math.cos(box.yaw), Math.sin(box.yaw)];
  return [[l, w], [l, -w], [-l, -w], [-l, w]].map(([a, b]) => [box.x + a * cos - b * sin, box.y + a * sin + b * cos]);
}

/** @returns {number[]} px: left, top, right, bottom */
function screenBoundsOf({ viewport, width, height }, box) {
  return boundsOf(cornersOf(box).map(([x, y]) => viewport.toScreen(x, y, width, height)));
}

function drawBox(canvas, box, chosen) {
  const { context, palette } = canvas;
  const outcome = outcomeOf(box);
  const colour = palette.outcomes[outcome];
  const corners = cornersOf(box);
  context.strokeStyle = colour;
  context.lineWidth = chosen ? 3 : outcome === "track matched" ? 1.4 : 1.7;
  context.setLineDash(outcome === "unevaluated" ? [4, 3] : []);
  context.beginPath();
  line(canvas, corners);
  context.closePath();
  if (outcome === "truth missed" || outcome === "track false") {
    context.fillStyle = faded(colour, 0.35);
    context.fill();
  }
  context.stroke();
  context.setLineDash([]);
  context.lineWidth = 1.2;
  context.beginPath();
  const ahead = Math.max(box.l, DRAWN_M) / 2 + 1.2;
  line(canvas, [[box.x, box.y], [box.x + ahead * Math.cos(box.yaw), box.y + ahead * Math.sin(box.yaw)]]);
  if (outcome === "track false") {
    line(canvas, [corners[0], corners[2]]);
    line(canvas, [corners[1], corners[3]]);
  }
  context.stroke();
}

function drawTrail(canvas, box) {
  const places = trailOf(canvas.run, box.row, TRAIL_FRAMES);
  if (places.length < 2) return;
  canvas.context.strokeStyle = faded(canvas.palette.outcomes[outcomeOf(box)], 0.45);
  canvas.context.lineWidth = 1.2;
  canvas.context.beginPath();
  line(canvas, places);
  canvas.context.stroke();
}

/**
 * The region that holds the position with 95 %, as the estimate claims.
 * @param {import("./marks.js").BoxMark} box
 * @returns {number[][]} m; empty: exact, or not known
 */
export function ellipseOf(box) {
  if (!box.sx || !box.sy) return [];
  const both = box.rho * box.sx * box.sy;
  const [mean, half] = [(box.sx ** 2 + box.sy ** 2) / 2, Math.hypot((box.sx ** 2 - box.sy ** 2) / 2, both)];
  const turn = Math.atan2(2 * both, box.sx ** 2 - box.sy ** 2) / 2;
  const [long, short] = [mean + half, Math.max(mean - half, 0)].map((value) => 2.448 * Math.sqrt(value));
  return Array.from({ length: 25 }, (_, i) => {
    const [a, b] = [long * Math.cos((i * Math.PI) / 12), short * Math.sin((i * Math.PI) / 12)];
    return [box.x + a * Math.cos(turn) - b * Math.sin(turn), box.y + a * Math.sin(turn) + b * Math.cos(turn)];
  });
}

/** @param {import("./marks.js").BoxMark} box @returns {number[][]} m, from where to where it moves; empty: it stands */
export function velocityOf(box) {
  if (!box.known || Math.hypot(box.vx, box.vy) < 0.3) return [];
  return [[box.x, box.y], [box.x + box.vx * AHEAD_S, box.y + box.vy * AHEAD_S]];
}

function drawEllipse(canvas, box) {
  const places = ellipseOf(box);
  if (!places.length) return;
  const { context, palette } = canvas;
  context.strokeStyle = faded(palette.outcomes[outcomeOf(box)], 0.8);
  context.lineWidth = 1;
  context.beginPath();
  line(canvas, places);
  context.stroke();
}

function drawVelocity(canvas, box) {
  const [from, to] = velocityOf(box);
  if (from) arrow(canvas, from, to, faded(canvas.palette.outcomes[outcomeOf(box)], 0.9), 1.3);
}

function arrow(canvas, from, to, colour, width) {
  const { context, viewport } = canvas;
  const [x, y] = viewport.toScreen(to[0], to[1], canvas.width, canvas.height);
  const bearing = Math.atan2(to[1] - from[1], to[0] - from[0]);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.beginPath();
  line(canvas, [from, to]);
  for (const side of [2.6, -2.6]) {
    context.moveTo(x, y);
    context.lineTo(x + 6 * Math.cos(bearing + side), y - 6 * Math.sin(bearing + side));
  }
  context.stroke();
}

function drawWithheld(canvas, box) {
  const { context, palette } = canvas;
  context.strokeStyle = palette.withheld;
  context.lineWidth = 1.4;
  context.setLineDash([3, 2]);
  context.beginPath();
  line(canvas, cornersOf(box));
  context.closePath();
  context.stroke();
  context.setLineDash([]);
}

/** Beside the box, so that it does not hide it. */
function drawId(canvas, box, taken) {
  const { width, height, palette } = canvas;
  if (box.kind === "truth" && box.outcome === "matched") return; // the track that matches it has its own
  const bounds = screenBoundsOf(canvas, box);
  if (bounds[2] < 0 || bounds[3] < 0 || bounds[0] > width || bounds[1] > height) return;
  writeLabel(canvas, [String(box.id)], around(bounds), palette.outcomes[outcomeOf(box)], taken, { font: "11px system-ui, sans-serif" });
}

/** Rings and crosses stand beside or around the box, so that they do not hide it. */
function drawEffect(canvas, { effect, from, to }, colour) {
  const { context, viewport, width, height } = canvas;
  const [x, y] = viewport.toScreen((to ?? from)[0], (to ?? from)[1], width, height);
  context.strokeStyle = colour;
  context.lineWidth = 1.8;
  if (effect === "inserted") {
    const size = Math.max(11, 2.6 * viewport.scale(width, height));
    drawDiamond(context, x, y, size, colour);
  } else if (effect === "removed") {
    cross(context, x, y, 15, colour);
  } else {
    arrow(canvas, from, to, colour, 1.8);
  }
}
