// A run in the browser: boxes by frame, views, agents, and their numbers over time.

/**
 * @typedef {{agent: string, estimate: string, row: number}} View
 * @typedef {{name: string, kind: string, object: number, range_m: number, sector: [number, number],
 *            sectors?: number, camera: any, adversaries: string[]}} Agent
 * @typedef {{label: string, kind: string, from_s: number, until_s: number, nodes: string[], cut?: string[],
 *            impaired?: string[]}} Span cut, impaired: agents whose link to the command centre is
 * @typedef {{frame: number, kind: string, text: string, x?: number, y?: number}} RunEvent
 */

/** The estimate that is no estimate: all objects of the scene. */
export const TRUTH = "truth";

export class Run {
  /** @param {{header: any, columns: import("./columns.js").Columns}} block */
  constructor({ header, columns }) {
    this.header = header;
    this.columns = columns;
    /** @type {number} */ this.frames = header.frames;
    /** @type {Agent[]} */ this.agents = header.agents;
    /** @type {Span[]} */ this.spans = header.spans;
    /** @type {RunEvent[]} */ this.events = header.events;
    this.times = columns.time;
    this.rows = columns["box.frame"].length;
    this.boxesByFrame = groupByFrame(columns["box.frame"], this.frames);
    this.effectsByFrame = groupByFrame(columns["effects.frame"], this.frames);
    this.withheldByFrame = groupByFrame(columns["withheld.frame"], this.frames);
    this.sweepStart = sweepStarts(this.agents, this.frames);
  }

  /** @returns {string[]} names of the agents that have estimates, then of all others */
  get agentNames() {
    const names = [this.header.ego, ...this.agents.map((agent) => agent.name)];
    return [...new Set([...names, ...this.header.views.map((/** @type {View} */ view) => view.agent)])].filter(Boolean);
  }

  /** @returns {Int32Array} id of the object that a box follows in each view, -1: none; made when it is first read */
  get matches() {
    const value = expand(this.columns.matched, this.columns.match);
    Object.defineProperty(this, "matches", { value, writable: true, configurable: true });
    return value;
  }

  /** @param {string} agent @returns {string[]} estimates of an agent, the truth last */
  estimatesOf(agent) {
    const own = this.header.views.filter((/** @type {View} */ view) => view.agent === agent);
    return [...own.map((/** @type {View} */ view) => view.estimate), TRUTH];
  }

  /** @param {string} agent @param {string} estimate @returns {number} its row of codes; -1: it has none */
  viewRow(agent, estimate) {
    const known = this.header.views.find((/** @type {View} */ v) => v.agent === agent && v.estimate === estimate);
    return known ? known.row : -1;
  }

  /** @param {number} seconds @returns {number} the frame at a time: the last one that is not later */
  frameAt(seconds) {
    let low = 0;
    let high = this.frames - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= seconds + 1e-6) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** @returns {number} s, the end of the last frame */
  get end() {
    const last = this.times[this.frames - 1];
    return last + (this.frames > 1 ? last / (this.frames - 1) : 0.1);
  }

  /**
   * A quantity of an agent in a frame.
   * @param {string} name of the column, without "agents."
   * @param {number} agent row of `agents`
   * @param {number} frame
   */
  ofAgent(name, agent, frame) {
    return this.columns[`agents.${name}`][agent * this.frames + frame];
  }

  /** @param {number} agent @param {number} frame @returns {number[]} m, free distance per sector; []: unknown */
  swept(agent, frame) {
    const sectors = this.agents[agent].sectors ?? 0;
    const start = this.sweepStart[agent];
    return Array.from({ length: sectors }, (_, i) => this.columns.swept[start + i * this.frames + frame]);
  }

  /**
   * A measure of an estimate over time; null: not measured.
   * @param {string} agent @param {string} estimate @param {"fn" | "fp" | "tp" | "rmse_m"} measure
   * @returns {Float64Array | Int32Array | null} -1 where it is not defined
   */
  series(agent, estimate, measure) {
    const index = this.header.series.findIndex(
      (/** @type {any} */ each) => each.agent === agent && each.estimate === estimate,
    );
    if (index < 0) return null;
    return this.columns[`series.${measure}`].subarray(index * this.frames, (index + 1) * this.frames);
  }

  /** @param {number} agent row of `agents` @returns {Float64Array | Int32Array} trust in it over time, -1: not judged */
  trust(agent) {
    return this.columns.trust.subarray(agent * this.frames, (agent + 1) * this.frames);
  }
}

/** @param {ArrayLike<number>} frame @param {number} frames @returns {Int32Array[]} rows of each frame */
function groupByFrame(frame, frames) {
  const start = new Int32Array(frames + 1);
  for (let i = 0; i < frame.length; i++) if (frame[i] < frames) start[frame[i] + 1]++;
  for (let f = 0; f < frames; f++) start[f + 1] += start[f];
  const next = start.slice();
  const rows = new Int32Array(start[frames]);
  for (let i = 0; i < frame.length; i++) if (frame[i] < frames) rows[next[frame[i]]++] = i;
  return Array.from({ length: frames }, (_, f) => rows.subarray(start[f], start[f + 1]));
}

/** @param {ArrayLike<number>} flags @param {ArrayLike<number>} values of the set flags @returns {Int32Array} -1: unset */
function expand(flags, values) {
  const result = new Int32Array(flags.length).fill(-1);
  for (let i = 0, next = 0; i < flags.length; i++) if (flags[i]) result[i] = values[next++];
  return result;
}

/** @param {Agent[]} agents @param {number} frames @returns {number[]} first number of each agent's sweeps */
function sweepStarts(agents, frames) {
  let start = 0;
  return agents.map((agent) => {
    const own = start;
    start += (agent.sectors ?? 0) * frames;
    return own;
  });
}
