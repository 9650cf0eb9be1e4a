// A run in the browser: the data block of columns, boxes by frame, views, agents, and their numbers over time.

/**
 * @typedef {{name: string, rows: number, width: number, scale: number, differences: boolean}} ColumnEntry
 * @typedef {Record<string, Float64Array | Int32Array>} Columns
 */

/**
 * Decode a block.
 * @param {string} text base64 of the deflated block
 * @returns {Promise<{header: any, columns: Columns}>}
 */
export function decodeText(text) {
  const letters = atob(text.trim());
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
  return decodeBlock(packed);
}

/**
 * Decode a block.
 * @param {Uint8Array} packed the deflated block
 * @returns {Promise<{header: any, columns: Columns}>}
 */
export async function decodeBlock(packed) {
  const stream = new Blob([/** @type {any} */ (packed)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(content.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(content.subarray(4, 4 + length)));
  if ((header.format ?? 1) !== 1) throw new Error(`data of format ${header.format}, expected 1`);
  /** @type {Columns} */
  const columns = {};
  let at = 4 + length;
  for (const entry of header.columns) {
    decodeWhenRead(columns, content, at, entry);
    at += entry.rows * entry.width;
  }
  return { header, columns };
}

/** Add a column that is decoded when it is first read: most are not needed for the first drawing. */
function decodeWhenRead(columns, content, at, entry) {
  const keep = (value) => Object.defineProperty(columns, entry.name, { value, writable: true });
  const get = () => {
    keep(decodeColumn(content, at, entry));
    return columns[entry.name];
  };
  Object.defineProperty(columns, entry.name, { get, set: keep, configurable: true, enumerable: true });
}

/**
 * Decode one column: planes of bytes, folded numbers, differences.
 * @param {Uint8Array} content
 * @param {number} at first byte of the lowest plane
 * @param {ColumnEntry} entry
 * @returns {Float64Array | Int32Array} numbers in their unit; whole numbers where the scale is 1
 */
function decodeColumn(content, at, { rows, width, scale, differences }) {
  const values = new Int32Array(rows);
  for (let plane = 0; plane < width; plane++) {
    const start = at + plane * rows;
    const shift = 8 * plane;
    for (let i = 0; i < rows; i++) values[i] |= content[start + i] << shift;
  }
  let sum = 0;
  for (let i = 0; i < rows; i++) {
    const step = (values[i] >>> 1) ^ -(values[i] & 1);
    sum = differences ? sum + step : step;
    values[i] = sum;
  }
  if (scale === 1) return values;
  const scaled = new Float64Array(rows);
  for (let i = 0; i < rows; i++) scaled[i] = values[i] * scale;
  return scaled;
}

/**
 * @typedef {{agent: string, estimate: string, row: number}} View
 * @typedef {{name: string, kind: string, object: number, range_m: number, sector: [number, number],
 *            sectors?: number, camera: any, adversaries: string[]}} Agent
 * @typedef {{label: string, kind: string, from_s: number, until_s: number, nodes: string[], cut?: string[],
 *            impaired?: string[]}} Span cut, impaired: agents whose link to the command centre is
 * @typedef {{frame: number, kind: string, text: string, time?: number, x?: number, y?: number}} RunEvent time: s, of a running run
 */

/** The estimate that is no estimate: all objects of the scene. */
export const TRUTH = "truth";
/** m between two places of a path. */
export const PATH_STEP_M = 2;

export class Run {
  /** @param {{header: any, columns: Columns}} block */
  constructor({ header, columns }) {
    this.header = header;
    this.columns = columns;
    /** @type {number} */ this.frames = header.frames;
    /** @type {Agent[]} */ this.agents = header.agents;
    /** @type {Span[]} */ this.spans = header.spans;
    /** @type {RunEvent[]} */ this.events = header.events;
    this.times = columns.time;
    this.rows = columns["box.frame"].length;
    /** Of a running run: what is said of it now, such as its wires; null for a finished run. */
    /** @type {any} */ this.live = null;
    this.boxesByFrame = groupByFrame(columns["box.frame"], this.frames);
    this.effectsByFrame = groupByFrame(columns["effects.frame"], this.frames);
    this.withheldByFrame = groupByFrame(columns["withheld.frame"], this.frames);
    this.sweepStart = sweepStarts(this.agents, this.frames);
    /** @type {Int32Array | null} */ this.pointStart = null;
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

  /** @param {number} view a row of views @returns {ArrayLike<number>} by row of boxes: 0, or 1 + its row of meanings */
  codes(view) {
    return this.columns.code.subarray(view * this.rows, (view + 1) * this.rows);
  }

  /** @param {number} view a row of views @returns {ArrayLike<number>} by row of boxes: id of the matched object, or -1 */
  matchesOf(view) {
    return this.matches.subarray(view * this.rows, (view + 1) * this.rows);
  }

  /** @param {number} row of a box @returns {number} row of the same object's box in the frame before; -1: none */
  before(row) {
    const { "box.id": id, "box.frame": frame, "box.truth": truth } = this.columns;
    const same = row > 0 && id[row - 1] === id[row] && truth[row - 1] === truth[row] && frame[row - 1] === frame[row] - 1;
    return same ? row - 1 : -1;
  }

  /** Where objects drive in the whole run. @returns {{width: number, places: number[][]}[]} m */
  paths() {
    if (this.drivenPaths) return this.drivenPaths;
    const { "box.id": id, "box.truth": truth, "box.x": x, "box.y": y, "box.w": w } = this.columns;
    this.drivenPaths = [];
    for (let start = 0; start < this.rows && truth[start]; ) {
      let end = start + 1;
      while (end < this.rows && truth[end] && id[end] === id[start]) end++;
      /** @type {number[][]} */
      const places = [];
      for (let row = start; row < end; row++) {
        const last = places[places.length - 1];
        if (!last || row === end - 1 || Math.hypot(x[row] - last[0], y[row] - last[1]) > PATH_STEP_M) places.push([x[row], y[row]]);
      }
      this.drivenPaths.push({ width: w[start], places });
      start = end;
    }
    return this.drivenPaths;
  }

  /** Say that no frame of a time is kept, in a running run. @type {(seconds: number) => string} */
  absence = () => "";

  /** A number that grows with the paths. */
  get drivenPlaces() {
    return this.rows;
  }

  /** @param {number} frame @returns {number} its number in the scene */
  numberOf(frame) {
    return (this.header.numbers?.[0] ?? 0) + this.every * frame;
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

  /** s, where its time axis begins */
  get begin() {
    return 0;
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
   * @param {"series" | "peaks"} column "peaks": the largest value from each frame to the next one shown
   * @returns {Float64Array | Int32Array | null} -1 where it is not defined
   */
  series(agent, estimate, measure, column = "series") {
    const index = this.header.series.findIndex(
      (/** @type {any} */ each) => each.agent === agent && each.estimate === estimate,
    );
    if (index < 0) return null;
    return this.columns[`${column}.${measure}`].subarray(index * this.frames, (index + 1) * this.frames);
  }

  /** Names and places of the spoofers of lidars. @param {number} frame @returns {[string, number, number][]} */
  spoofersAt(frame) {
    const { "spoofers.x": x, "spoofers.y": y } = this.columns;
    const names = /** @type {string[]} */ (this.header.spoofers ?? []);
    return names.map((name, row) => [name, x[row * this.frames + frame], y[row * this.frames + frame]]);
  }

  /** The agent whose lidar's points are shown; empty: none were recorded. @returns {string} */
  get scanned() {
    return this.header.points ?? "";
  }

  /** @param {number} frame @returns {[number, number]} first row of its points in `points.x` and so on, and their end */
  pointsAt(frame) {
    if (!this.scanned) return [0, 0];
    if (!this.pointStart) {
      const counts = this.columns["points.count"];
      this.pointStart = new Int32Array(counts.length + 1);
      for (let i = 0; i < counts.length; i++) this.pointStart[i + 1] = this.pointStart[i] + counts[i];
    }
    return [this.pointStart[frame], this.pointStart[frame + 1]];
  }

  /** @returns {number} 1, or n if only every n-th frame of a long run is shown */
  get every() {
    return this.header.numbers?.[1] ?? 1;
  }

  /** The driven cars of a finished run, and their unattacked twins; twin: its name, empty: there is none. @returns {{car: string, twin: string}[]} */
  get drives() {
    return this.header.drives ?? [];
  }

  /**
   * What a car did, by frame.
   * @param {number} drive row of `drives` @param {"speed" | "acceleration" | "brake" | "twin_x" | "twin_y"} name
   * @returns {Float64Array | Int32Array} brake: 0: no, 1: it brakes, 2: needlessly
   */
  drive(drive, name) {
    return this.columns[`drive.${name}`].subarray(drive * this.frames, (drive + 1) * this.frames);
  }

  /** @param {number} agent row of `agents` @returns {Float64Array | Int32Array} trust in it over time, -1: not judged */
  trust(agent) {
    return this.columns.trust.subarray(agent * this.frames, (agent + 1) * this.frames);
  }
}

/** @param {ArrayLike<number>} frame @param {number} frames @returns {Int32Array[]} rows of each frame */
export function groupByFrame(frame, frames) {
  const start = new Int32Array(frames + 1);
  for (let i = 0; i < frame.length; i++) if (frame[i] < frames) start[frame[i] + 1]++;
  for (let f = 0; f < frames; f++) start[f + 1] += start[f];
  const next = start.slice();
  const rows = new Int32Array(start[frames]);
  for (let i = 0; i < frame.length; i++) if (frame[i] < frames) rows[next[frame[i]]++] = i;
  return Array.from({ length: frames }, (_, f) => rows.subarray(start[f], start[f + 1]));
}

/** @param {ArrayLike<number>} flags @param {ArrayLike<number>} values of the set flags @returns {Int32Array} -1: unset */
export function expand(flags, values) {
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
