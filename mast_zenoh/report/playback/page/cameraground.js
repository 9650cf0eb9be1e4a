// Draws what lies on the ground of a camera's view: a grid, driven paths, ranges, swept space, trails, velocities, ellipses.

import { colourOfAgent } from "./agents.js";
import { ellipseOf, outcomeOf, TRAIL_FRAMES, velocityOf } from "./boxes.js";
import { addPath, tracePath } from "./camerawindow.js";
import { trailOf } from "./marks.js";
import { faded } from "./palette.js";
import { drivenPaths, sectorOf } from "./scene.js";

/** m, of the grid around the camera. */
const GRID_M = 10;
const GRID_REACH_M = 120;

/**
 * @param {import("./camera.js").CameraCanvas} canvas
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
