// Draws a frame from above: ground, buildings, sensor ranges, links, boxes with motion and uncertainty, manipulations.

import { trailOf } from "./marks.js";
import { OUTCOMES, faded } from "./palette.js";
import { around, boundsOf, colourOfAgent, cross, drawDiamond, writeLabel } from "./signs.js";

/**
 * @typedef {{context: CanvasRenderingContext2D, width: number, height: number,
 *            viewport: import("./windows.js").Viewport, palette: import("./palette.js").Palette,
 *            layers: Record<string, boolean>, run: import("./run.js").Run}} Canvas
 */

/** By the list of its buildings, which all versions of a running run share. @type {WeakMap<any, {key: string, image: HTMLCanvasElement}>} */
const grounds = new WeakMap();

/** What does not change from frame to frame; drawn once for each window. @param {Canvas} canvas */
export function drawGround(canvas) {
  const { context, width, height, viewport, palette, layers, run } = canvas;
  const ratio = context.getTransform().a;
  const key = [width, height, ratio, viewport.x, viewport.y, viewport.half, palette.name, layers.paths, run.drivenPlaces].join();
  let ground = grounds.get(run.header.buildings);
  if (!ground || ground.key !== key) {
    const image = ground?.image ?? document.createElement("canvas");
    image.width = context.canvas.width;
    image.height = context.canvas.height;
    const own = /** @type {CanvasRenderingContext2D} */ (image.getContext("2d", { willReadFrequently: true }));
    own.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawStanding({ ...canvas, context: own });
    ground = { key, image };
    grounds.set(run.header.buildings, ground);
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
  context.strokeStyle = palette.building_edge;
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

/** @type {WeakMap<import("./run.js").Run, DrivenPath[]>} */
const pathsByRun = new WeakMap();

/**
 * The paths that objects take during the whole run: where the roads are.
 * @param {import("./run.js").Run} run
 * @returns {DrivenPath[]}
 */
export function drivenPaths(run) {
  const known = pathsByRun.get(run);
  if (known) return known;
  const paths = run.paths().map(({ places, width }) => {
    /** @type {number[][][] | undefined} */ let pieces;
    return {
      places,
      width: width + 0.8,
      get pieces() {
        pieces ??= piecesOf(places, (width + 0.8) / 2);
        return pieces;
      },
    };
  });
  pathsByRun.set(run, paths);
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

/**
 * The points that the lidar of an agent returned.
 * @param {Canvas} canvas
 * @param {number} frame
 */
export function drawPoints({ context, viewport, width, height, palette, run }, frame) {
  const { "points.x": x, "points.y": y } = run.columns;
  const [from, to] = run.pointsAt(frame);
  context.fillStyle = faded(palette.faint, 0.75);
  for (let row = from; row < to; row++) {
    const [px, py] = viewport.toScreen(x[row], y[row], width, height);
    context.fillRect(px - 0.7, py - 0.7, 1.4, 1.4);
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

/**
 * Where the unattacked twins of the driven cars drive, and where they are now.
 * @param {Canvas} canvas
 * @param {import("./marks.js").AgentMark[]} agents
 * @param {number[][]} taken by labels; those of the twins are added
 */
export function drawTwins(canvas, agents, taken) {
  const { context, palette, run, viewport, width, height } = canvas;
  run.drives.forEach(({ car, twin }, row) => {
    const mark = agents.find((agent) => agent.name === car);
    if (!twin || !mark?.drive) return;
    const [xs, ys] = [run.drive(row, "twin_x"), run.drive(row, "twin_y")];
    context.strokeStyle = palette.faint;
    context.lineWidth = 1.5;
    context.setLineDash([6, 4]);
    context.beginPath();
    line(canvas, Array.from(xs, (x, index) => [x, ys[index]]));
    context.stroke();
    context.setLineDash([]);
    const [x, y] = viewport.toScreen(mark.drive.twinAt[0], mark.drive.twinAt[1], width, height);
    const apart = viewport.scale(width, height) * Math.hypot(mark.x - mark.drive.twinAt[0], mark.y - mark.drive.twinAt[1]);
    if (apart < 12) return;
    context.beginPath();
    context.arc(x, y, 6.5, 0, 7);
    context.stroke();
    const box = [x - 8, y - 8, x + 8, y + 8];
    taken.push(box);
    writeLabel(canvas, [`${car}, ${twin}`], around(box), palette.faint, taken, { font: "12px system-ui, sans-serif" });
  });
}

/** The length of a grid cell, at the lower right, legible on top of objects. @param {Canvas} canvas */
export function drawScale({ context, viewport, width, height, palette }) {
  const scale = viewport.scale(width, height);
  const step = gridStep(scale);
  const [right, y] = [width - 14, height - 12];
  context.fillStyle = faded(palette.ground, 0.85);
  context.fillRect(right - step * scale - 5, y - 20, step * scale + 10, 25);
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
 * @param {Canvas} canvas
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
 * @param {Canvas} canvas
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

/** Shares of a cut link at which its gap begins and ends. */
const GAP = [0.4, 0.6];

/**
 * @param {Canvas} canvas
 * @param {import("./marks.js").LinkMarks} marks
 */
export function drawLinks({ context, viewport, width, height, palette }, { x, y, links }) {
  const hub = viewport.toScreen(x, y, width, height);
  for (const link of links) {
    if (link.state === "down") continue;
    const agent = viewport.toScreen(link.x, link.y, width, height);
    const length = Math.hypot(agent[0] - hub[0], agent[1] - hub[1]);
    if (length < 24) continue;
    /** @returns {[number, number]} */
    const at = (share) => [hub[0] + share * (agent[0] - hub[0]), hub[1] + share * (agent[1] - hub[1])];
    const ends = [10 / length, 1 - 14 / length]; // beside both signs
    const cut = link.state === "cut";
    context.strokeStyle = link.state === "up" ? faded(palette.faint, 0.55) : palette.fault;
    context.lineWidth = cut ? 2 : link.state === "up" ? 1.2 : 1.6;
    context.setLineDash(cut ? [7, 4] : link.state === "impaired" ? [2, 3] : []);
    context.beginPath();
    for (const [from, to] of cut ? [[ends[0], GAP[0]], [GAP[1], ends[1]]] : [ends]) {
      context.moveTo(...at(from));
      context.lineTo(...at(to));
    }
    context.stroke();
    context.setLineDash([]);
    if (cut) drawGapEnds(context, at, length, palette.fault);
  }
}

/** Bars across the ends of a gap. */
function drawGapEnds(context, at, length, colour) {
  const [from, to] = [at(0), at(1)];
  const [dx, dy] = [(-(to[1] - from[1]) / length) * 6, ((to[0] - from[0]) / length) * 6];
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  for (const share of GAP) {
    const [px, py] = at(share);
    context.moveTo(px - dx, py - dy);
    context.lineTo(px + dx, py + dy);
  }
  context.stroke();
}

/**
 * The sign of the command centre, with its label where there is room.
 * @param {Canvas} canvas
 * @param {import("./marks.js").LinkMarks} marks
 * @param {number[][]} taken by labels
 */
export function drawCentre(canvas, { x, y, links }, taken) {
  const { context, viewport, width, height, palette } = canvas;
  if (!links.length) return;
  const [px, py] = viewport.toScreen(x, y, width, height);
  taken.push([px - 7, py - 7, px + 7, py + 7]);
  context.fillStyle = faded(palette.ground, 0.8);
  context.strokeStyle = palette.faint;
  context.lineWidth = 1.6;
  context.beginPath();
  context.rect(px - 6, py - 6, 12, 12);
  context.moveTo(px - 2.5, py);
  context.lineTo(px + 2.5, py);
  context.moveTo(px, py - 2.5);
  context.lineTo(px, py + 2.5);
  context.fill();
  context.stroke();
  /** @type {import("./signs.js").Places} */
  const places = (wide, high) => [[px + 10, py + 4], [px + 10, py - high - 4], [px - wide - 10, py + 4], [px - wide - 10, py - high - 4]];
  writeLabel(canvas, ["command centre"], places, palette.faint, taken, { font: "11px system-ui, sans-serif" });
}
