// Draws the links between agents and the command centre. It has no place in the scene: its sign stands amid the agents.

import { writeLabel } from "./labels.js";
import { faded } from "./palette.js";

/** m: how far the sign stands from an agent that is alone. */
const BESIDE_M = 14;
/** Shares of a cut link at which its gap begins and ends. */
const GAP = [0.4, 0.6];

/**
 * @typedef {"up" | "impaired" | "cut" | "down"} LinkState
 * @typedef {{agent: string, x: number, y: number, state: LinkState}} LinkMark
 * @typedef {{x: number, y: number, links: LinkMark[]}} LinkMarks place of the command centre's sign, m
 */

/**
 * The links in a frame.
 * @param {import("./run.js").Run} run
 * @param {number} frame
 * @param {import("./marks.js").AgentMark[]} agents
 * @returns {LinkMarks}
 */
export function linkMarks(run, frame, agents) {
  const time = run.times[frame];
  const present = run.spans.filter((span) => span.from_s <= time + 1e-6 && time + 1e-6 < span.until_s);
  const impaired = new Set(present.flatMap((span) => span.impaired ?? []));
  const links = agents.map(({ name, x, y, down, cutOff }) => ({ agent: name, x, y, state: stateOf(down, cutOff, impaired.has(name)) }));
  const mean = (axis) => links.reduce((sum, link) => sum + link[axis], 0) / Math.max(links.length, 1);
  return { x: mean("x"), y: mean("y") + (links.length === 1 ? BESIDE_M : 0), links };
}

/** @returns {LinkState} */
function stateOf(down, cutOff, impaired) {
  if (down) return "down";
  if (cutOff) return "cut";
  return impaired ? "impaired" : "up";
}

/**
 * @param {import("./scene.js").Canvas} canvas
 * @param {LinkMarks} marks
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
 * @param {import("./scene.js").Canvas} canvas
 * @param {LinkMarks} marks
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
  /** @type {import("./labels.js").Places} */
  const places = (wide, high) => [[px + 10, py + 4], [px + 10, py - high - 4], [px - wide - 10, py + 4], [px - wide - 10, py - high - 4]];
  writeLabel(canvas, ["command centre"], places, palette.faint, taken, { font: "11px system-ui, sans-serif" });
}
