// Draws agents, the signs of manipulations and labels, from above and in camera views.

/** @typedef {(wide: number, high: number) => [number, number][]} Places upper left corners for a label of a size, px */

/** px: height of a line. */
const LINE = 14;
/** px: radius of the ring around an agent with an adversary on its wires. */
const RING = 12;

/**
 * Write lines at the first free place.
 * @param {{context: CanvasRenderingContext2D, width: number, height: number, palette: import("./palette.js").Palette}} canvas
 * @param {string[]} lines
 * @param {Places} places to try, the best first
 * @param {string} colour
 * @param {number[][]} taken left, top, right and bottom of all labels so far; the new one is added
 * @param {{font?: string, needed?: boolean}} [style] needed: written even if every place is taken: at the first that is
 *   inside, or as near to the first as is inside
 * @returns {number[] | null} where it is; null: nowhere
 */
export function writeLabel(canvas, lines, places, colour, taken, { font = "600 12px system-ui, sans-serif", needed = false } = {}) {
  const { context, width, height, palette } = canvas;
  context.font = font;
  const wide = Math.max(...lines.map((text) => context.measureText(text).width));
  const high = LINE * lines.length;
  const tried = places(wide, high);
  const inside = tried.filter(([left, top]) => left >= 2 && top >= 2 && left + wide <= width - 2 && top + high <= height - 2);
  const free = inside.find(
    ([left, top]) => !taken.some((box) => left < box[2] && box[0] < left + wide && top < box[3] && box[1] < top + high),
  );
  if (!free && !needed) return null;
  const [x, y] = free ?? inside[0] ?? tried[0];
  const [left, top] = [Math.max(2, Math.min(x, width - 2 - wide)), Math.max(2, Math.min(y, height - 2 - high))];
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

/** @param {import("./marks.js").AgentMark} mark @param {import("./palette.js").Palette} palette */
export function colourOfAgent(mark, palette) {
  if (mark.down) return palette.faint;
  if (mark.state) return palette.states[mark.state];
  return mark.adversaries.length ? palette.adversary : palette.agent;
}

/** @param {import("./marks.js").AgentMark} mark @returns {string} what is wrong with it; empty: nothing */
export function troubleOf(mark) {
  if (mark.down) return "down";
  const troubles = ["faulty", "suspended", "undecided"].includes(mark.state) ? [mark.state] : [];
  if (mark.cutOff) troubles.push("cut off");
  return troubles.join(", ");
}

/**
 * Keep labels off the signs of agents.
 * @param {import("./above.js").Canvas} canvas
 * @param {import("./marks.js").AgentMark[]} agents
 * @param {number[][]} taken by labels and signs; those of the agents are added
 */
export function reserveSigns({ viewport, width, height }, agents, taken) {
  for (const mark of agents) {
    const [x, y] = viewport.toScreen(mark.x, mark.y, width, height);
    const reach = mark.adversaries.length ? RING + 4 : RING;
    taken.push([x - reach, y - reach, x + reach, y + reach]);
  }
}

/**
 * @param {import("./above.js").Canvas} canvas
 * @param {import("./marks.js").AgentMark[]} agents
 * @param {number[][]} taken by labels and signs; labels of the agents are added
 */
export function drawAgents(canvas, agents, taken) {
  const { viewport, width, height } = canvas;
  for (const mark of agents) {
    const [x, y] = viewport.toScreen(mark.x, mark.y, width, height);
    if (x < -20 || y < -20 || x > width + 20 || y > height + 20) continue;
    const colour = drawAgentSign(canvas, mark, x, y);
    if (mark.drive && mark.drive.state !== "rolls") drawBrakeLights(canvas, mark, x, y);
    const trouble = troubleOf(mark);
    const lines = [mark.name, ...(trouble ? [trouble] : []), ...brakingOf(mark)];
    writeLabel(canvas, lines, behindOf(x, y, mark.heading), colour, taken, { needed: true });
  }
}

/**
 * Squares where the spoofers of lidars are.
 * @param {import("./above.js").Canvas} canvas
 * @param {number} frame
 * @param {number[][]} taken by labels and signs; labels of the spoofers are added
 */
export function drawSpoofers(canvas, frame, taken) {
  const { context, viewport, width, height, palette, run } = canvas;
  for (const [name, east, north] of run.spoofersAt(frame)) {
    const [x, y] = viewport.toScreen(east, north, width, height);
    context.fillStyle = palette.adversary;
    context.fillRect(x - 4, y - 4, 8, 8);
    writeLabel(canvas, [name], around([x - 8, y - 6, x + 8, y + 6]), palette.adversary, taken);
  }
}

/** @param {import("./marks.js").AgentMark} mark @returns {string[]} how it brakes; []: it does not */
function brakingOf({ drive }) {
  return drive && drive.state !== "rolls" ? [`${drive.state}, ${Math.abs(drive.acceleration).toFixed(1)} m/s²`] : [];
}

/** m: from the middle of a car to its rear, and its width. px: at least. */
const REAR_M = 2.3;
const WIDE_M = 1.9;
const REAR = 9;
const WIDE = 13;

/**
 * A bar across the rear of a car that brakes: the colour of false tracks, if it does so needlessly.
 * @param {import("./above.js").Canvas} canvas
 * @param {import("./marks.js").AgentMark} mark
 * @param {number} x px @param {number} y px
 */
function drawBrakeLights({ context, palette, viewport, width, height }, mark, x, y) {
  const scale = viewport.scale(width, height);
  const [back, half] = [Math.max(REAR_M * scale, REAR), Math.max(WIDE_M * scale, WIDE) / 2];
  const [ahead, left] = [[Math.cos(mark.heading), -Math.sin(mark.heading)], [-Math.sin(mark.heading), -Math.cos(mark.heading)]];
  const at = (/** @type {number} */ side) => [x - back * ahead[0] + side * left[0], y - back * ahead[1] + side * left[1]];
  context.strokeStyle = mark.drive?.state === "brakes" ? palette.fault : palette.outcomes["track false"];
  context.lineWidth = 5;
  context.lineCap = "butt";
  context.beginPath();
  context.moveTo(...(/** @type {[number, number]} */ (at(-half))));
  context.lineTo(...(/** @type {[number, number]} */ (at(half))));
  context.stroke();
}

/**
 * Draw the sign of an agent.
 * @param {{context: CanvasRenderingContext2D, palette: import("./palette.js").Palette}} canvas
 * @param {import("./marks.js").AgentMark} mark
 * @param {number} x px @param {number} y px
 * @returns {string} the colour of its label
 */
export function drawAgentSign({ context, palette }, mark, x, y) {
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
    context.arc(x, y, RING, 0, 7);
    context.stroke();
    context.setLineDash([]);
  }
  return mark.adversaries.length ? palette.adversary : colour;
}

/**
 * Places for the label of an agent: behind it first, not on its way.
 * @returns {Places}
 */
function behindOf(x, y, heading) {
  return (wide, high) => {
    const behind = [Math.cos(heading) > 0 ? -wide - 15 : 15, Math.sin(heading) > 0 ? 8 : -high - 8];
    const places = [behind, [15, -high - 4], [15, 6], [-wide - 15, -high - 4], [-wide - 15, 6], [-wide / 2, 16], [-wide / 2, -high - 16]];
    return places.map(([dx, dy]) => /** @type {[number, number]} */ ([x + dx, y + dy]));
  };
}

/** @param {CanvasRenderingContext2D} context @param {number} size px, half of its height */
export function drawDiamond(context, x, y, size, colour) {
  context.strokeStyle = colour;
  context.lineWidth = 1.8;
  context.beginPath();
  context.moveTo(x, y - size);
  context.lineTo(x + size, y);
  context.lineTo(x, y + size);
  context.lineTo(x - size, y);
  context.closePath();
  context.stroke();
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
