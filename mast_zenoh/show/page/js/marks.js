// What a panel draws in a frame, as plain data: tests compare it with the recording. Which box is under the pointer.

import { TRUTH } from "./run.js";

/**
 * @typedef {{row: number, kind: string, outcome: string, id: number, x: number, y: number, z: number, l: number,
 *            w: number, h: number, yaw: number, score: number, known: boolean, vx: number, vy: number, sx: number,
 *            sy: number, rho: number, class: string, cause: string, by: string, match: number,
 *            error: number | null}} BoxMark
 * @typedef {{effect: string, by: string, from: number[] | null, to: number[] | null}} EffectMark
 * @typedef {{index: number, name: string, kind: string, x: number, y: number, heading: number, state: string,
 *            down: boolean, lying: boolean, cutOff: boolean, adversaries: string[], drive: DriveMark | null}} AgentMark
 * @typedef {{speed: number, acceleration: number, state: "rolls" | "brakes" | "brakes needlessly", twin: string,
 *            twinAt: number[]}} DriveMark m/s, m/s², m; twin: its name, empty: there is none
 * @typedef {{id: number, x: number, y: number, z: number, l: number, w: number, h: number, yaw: number}} WithheldMark
 * @typedef {{frame: number, time_s: number, agent: string, estimate: string, boxes: BoxMark[], effects: EffectMark[],
 *            agents: AgentMark[], withheld: WithheldMark[],
 *            links: LinkMarks,
 *            camera?: import("./perspective.js").CameraMarks | null}} Marks
 */

const BOX_COLUMNS = ["x", "y", "z", "l", "w", "h", "yaw", "score", "vx", "vy", "sx", "sy", "rho"];
/** Estimates of objects that an agent has without the command centre. */
const OWN = ["local", "received"];
/** Estimates behind the picture's way to the agent. */
const BEHIND = ["mission", "picture_received", "picture_on_arrival"];

/**
 * All marks of a view in a frame.
 * @param {import("./run.js").Run} run
 * @param {number} frame
 * @param {string} agent
 * @param {string} estimate
 * @returns {Marks}
 */
export function marksOf(run, frame, agent, estimate) {
  const whole = !OWN.includes(estimate) && estimate !== TRUTH;
  const agents = agentMarks(run, frame);
  return {
    frame,
    time_s: run.times[frame],
    agent,
    estimate,
    boxes: boxMarks(run, frame, agent, estimate),
    effects: estimate === "local" || estimate === TRUTH ? [] : effectMarks(run, frame, agent, estimate),
    agents,
    links: linkMarks(run, frame, agents),
    withheld: whole ? withheldMarks(run, frame) : [],
  };
}

/** @returns {BoxMark[]} */
function boxMarks(run, frame, agent, estimate) {
  const columns = run.columns;
  const view = run.viewRow(agent, estimate);
  const [codes, matches] = view < 0 ? [null, null] : [run.codes(view), run.matchesOf(view)];
  const rows = run.boxesByFrame[frame];
  const truthRow = new Map();
  for (const row of rows) if (columns["box.truth"][row]) truthRow.set(columns["box.id"][row], row);
  /** @type {BoxMark[]} */ const marks = [];
  for (const row of rows) {
    const truth = columns["box.truth"][row] === 1;
    const code = codes ? codes[row] : 0;
    if (!code && !(estimate === TRUTH && truth)) continue;
    const [outcome, cause, by] = code ? run.header.meanings[code - 1] : ["scene", "", ""];
    const match = matches ? matches[row] : -1;
    const mark = /** @type {any} */ ({ row, kind: truth ? "truth" : "track", outcome, cause, by, match, id: columns["box.id"][row] });
    for (const name of BOX_COLUMNS) mark[name] = columns[`box.${name}`][row];
    mark.known = columns["box.known"][row] === 1;
    mark.class = run.header.classes[columns["box.kind"][row]];
    const object = truthRow.get(match);
    const away = object === undefined ? null : [columns["box.x"][object] - mark.x, columns["box.y"][object] - mark.y];
    mark.error = away ? Math.hypot(away[0], away[1]) : null;
    marks.push(mark);
  }
  return marks;
}

/** @returns {EffectMark[]} */
function effectMarks(run, frame, agent, estimate) {
  const columns = run.columns;
  const marks = [];
  for (const row of run.effectsByFrame[frame]) {
    if (columns["effects.downlink"][row]) {
      const subscriber = run.header.subscribers[columns["effects.subscriber"][row]];
      if (!BEHIND.includes(estimate) || (subscriber && subscriber !== agent)) continue;
    }
    const effect = run.header.effects[columns["effects.effect"][row]];
    const place = (when) => ["x", "y", "z"].map((axis) => columns[`effects.${when}_${axis}`][row]);
    marks.push({
      effect,
      by: run.header.adversaries[columns["effects.by"][row]],
      from: effect === "inserted" ? null : place("before"),
      to: effect === "removed" ? null : place("after"),
    });
  }
  return marks;
}

/** @returns {AgentMark[]} */
export function agentMarks(run, frame) {
  const time = run.times[frame] + 1e-6; // times are rounded
  const cut = new Set(run.spans.filter((span) => span.from_s <= time && time < span.until_s).flatMap((span) => span.cut ?? []));
  return run.agents.map((agent, index) => {
    const flags = run.ofAgent("state", index, frame);
    return {
      index,
      name: agent.name,
      kind: agent.kind,
      x: run.ofAgent("x", index, frame),
      y: run.ofAgent("y", index, frame),
      heading: run.ofAgent("heading", index, frame),
      state: flags % 8 ? run.header.states[(flags % 8) - 1] : "",
      down: (flags & run.header.flags.down) > 0,
      lying: (flags & run.header.flags.lying) > 0,
      cutOff: cut.has(agent.name),
      adversaries: agent.adversaries,
      drive: driveMark(run, agent.name, frame),
    };
  });
}

/**
 * What a driven car does in a frame; null: it is not driven.
 * @param {import("./run.js").Run} run @param {string} car @param {number} frame
 * @returns {DriveMark | null}
 */
export function driveMark(run, car, frame) {
  const row = run.drives.findIndex((each) => each.car === car);
  if (row < 0) return null;
  const at = (/** @type {any} */ name) => run.drive(row, name)[frame];
  const state = /** @type {const} */ (["rolls", "brakes", "brakes needlessly"])[at("brake")];
  return { speed: at("speed"), acceleration: at("acceleration"), state, twin: run.drives[row].twin, twinAt: [at("twin_x"), at("twin_y")] };
}

/** @returns {WithheldMark[]} */
function withheldMarks(run, frame) {
  const names = ["id", "x", "y", "z", "l", "w", "h", "yaw"];
  return [...run.withheldByFrame[frame]].map(
    (row) => /** @type {any} */ (Object.fromEntries(names.map((name) => [name, run.columns[`withheld.${name}`][row]]))),
  );
}

/**
 * Where a box was before, the latest place first.
 * @param {import("./run.js").Run} run
 * @param {number} row of the box
 * @param {number} most number of places
 * @returns {[number, number][]} m
 */
export function trailOf(run, row, most) {
  const { "box.x": x, "box.y": y } = run.columns;
  /** @type {[number, number][]} */
  const places = [];
  for (let at = row; at >= 0 && places.length <= most; at = run.before(at)) places.push([x[at], y[at]]);
  return places;
}

/**
 * How many boxes of each outcome there are.
 * @param {Marks} marks
 */
export function tally(marks) {
  const count = (kind, outcome) => marks.boxes.filter((box) => box.kind === kind && box.outcome === outcome).length;
  return { missed: count("truth", "missed"), false: count("track", "false"), matched: count("track", "matched") };
}

/** m: how far the sign stands from an agent that is alone. */
const BESIDE_M = 14;

/**
 * @typedef {"up" | "impaired" | "cut" | "down"} LinkState
 * @typedef {{agent: string, x: number, y: number, state: LinkState}} LinkMark
 * @typedef {{x: number, y: number, links: LinkMark[]}} LinkMarks place of the command centre's sign, m
 */

/**
 * The links in a frame; none in a run without a command centre.
 * @param {import("./run.js").Run} run
 * @param {number} frame
 * @param {AgentMark[]} agents
 * @returns {LinkMarks}
 */
export function linkMarks(run, frame, agents) {
  if (!run.header.centre) return { x: 0, y: 0, links: [] };
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

/** px: a box is found this near to its centre, however small it is drawn. */
const NEAR = 9;

/**
 * The box at a pixel; errors before matches, tracks before the truth that they match.
 * @param {Marks} marks
 * @param {import("./windows.js").Viewport} viewport
 * @returns {BoxMark | null}
 */
export function hit(marks, viewport, px, py, width, height) {
  const [x, y] = viewport.toWorld(px, py, width, height);
  const near = NEAR / viewport.scale(width, height);
  let best = null;
  let least = Infinity;
  for (const box of marks.boxes) {
    const [dx, dy] = [x - box.x, y - box.y];
    const along = Math.abs(dx * Math.cos(box.yaw) + dy * Math.sin(box.yaw));
    const across = Math.abs(-dx * Math.sin(box.yaw) + dy * Math.cos(box.yaw));
    const distance = Math.hypot(dx, dy);
    if (distance > near && (along > box.l / 2 + 0.3 || across > box.w / 2 + 0.3)) continue;
    const rank = distance - (box.outcome === "matched" ? 0 : 2) - (box.kind === "track" ? 1 : 0);
    if (rank < least) [best, least] = [box, rank];
  }
  return best;
}

const CAUSES = {
  inserted: "follows an object inserted",
  moved: "its object was moved",
  removed: "its object was removed",
  altered: "its object was altered",
  withheld: "withheld from the picture",
};

/**
 * Lines about a box.
 * @param {BoxMark} box
 * @returns {string[]} the first is its heading
 */
export function describe(box) {
  const outcomes = {
    "truth matched": "object, matched", "truth missed": "object, missed", "track matched": "track, matched",
    "track false": "false track", "truth scene": "object",
  };
  const what = outcomes[`${box.kind} ${box.outcome}`] ?? `${box.kind === "truth" ? "object" : "track"}, not evaluated`;
  const lines = [`${what} · id ${box.id}`];
  const size = `${box.l.toFixed(1)} × ${box.w.toFixed(1)} × ${box.h.toFixed(1)} m`;
  lines.push(box.class === "unknown" ? size : `${box.class}, ${size}`);
  if (box.known) lines.push(`speed ${Math.hypot(box.vx, box.vy).toFixed(1)} m/s`);
  if (box.kind === "track") lines.push(`score ${box.score.toFixed(2)}`);
  if (box.error !== null) lines.push(`error ${box.error.toFixed(2)} m from object ${box.match}`);
  if (box.sx) lines.push(`claims σ ${box.sx.toFixed(2)} m, ${box.sy.toFixed(2)} m`);
  const by = box.cause === "withheld" ? ", reported by" : " by";
  if (box.cause) lines.push(`cause: ${CAUSES[box.cause] ?? box.cause}${box.by ? `${by} ${box.by.replaceAll("+", ", ")}` : ""}`);
  return lines;
}
