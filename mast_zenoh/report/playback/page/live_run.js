// A running run: the newest of its frames, joined to a run.

import { Run } from "./run.js";

/** Most frames, and most boxes, that the page keeps. */
export const MOST_FRAMES = 600;
export const MOST_ROWS = 100000;

/**
 * @typedef {{header: any, columns: import("./columns.js").Columns, rows: number, matches: Int32Array,
 *            before: Int32Array, views: Map<string, number>}} Part one frame
 */

const JOINED = ["x", "y", "z", "l", "w", "h", "yaw", "score", "known", "vx", "vy", "sx", "sy", "rho", "kind", "id", "truth"];
const EFFECTS = ["effect", "downlink", "before_x", "before_y", "before_z", "after_x", "after_y", "after_z"];
const WITHHELD = ["id", "x", "y", "z", "l", "w", "h", "yaw"];

/** The kept frames of a running run. */
export class LiveRun extends Run {
  /** @param {import("./frame_history.js").FrameHistory} frames */
  constructor(frames) {
    const parts = [...frames.parts];
    const { header: newest } = parts[parts.length - 1];
    /** @type {any} */ const columns = { time: Float64Array.from(parts, (part) => part.columns.time[0]) };
    for (const name of JOINED) columns[`box.${name}`] = chained(parts, `box.${name}`);
    for (const name of EFFECTS) columns[`effects.${name}`] = chained(parts, `effects.${name}`);
    for (const name of WITHHELD) columns[`withheld.${name}`] = chained(parts, `withheld.${name}`);
    for (const group of ["box", "effects", "withheld"]) columns[`${group}.frame`] = numbered(parts, `${group}.frame`);
    const adversaries = united(parts, "adversaries");
    const subscribers = united(parts, "subscribers");
    columns["effects.by"] = renamed(parts, "effects.by", "adversaries", adversaries);
    columns["effects.subscriber"] = renamed(parts, "effects.subscriber", "subscribers", subscribers);
    const views = new Map(parts.flatMap((part) => part.header.views.map((view) => [`${view.agent} ${view.estimate}`, view])));
    const meanings = new Map(parts.flatMap((part) => part.header.meanings.map((each) => [JSON.stringify(each), each])));
    const header = {
      ...frames.lasting, ...newest, frames: parts.length, frame: parts.length - 1, adversaries, subscribers, name: frames.lasting.label,
      events: [...frames.events.values()], views: [...views.values()].map((view, row) => ({ ...view, row })), meanings: [...meanings.values()],
    };
    super({ header, columns });
    this.parts = parts;
    this.meaningRows = new Map([...meanings.keys()].map((key, row) => [key, row + 1]));
    this.live = newest;
    this.driven = frames.paths;
    this.places = frames.places;
    /** @type {Map<number, any>} */ this.codesByView = new Map();
    this.starts = [];
    parts.reduce((start, part) => {
      this.starts.push(start);
      return start + part.rows;
    }, 0);
  }

  codes(view) {
    return this.ofView(view).codes;
  }

  matchesOf(view) {
    return this.ofView(view).matches;
  }

  /** Codes and matches of a view, made when they are needed. @param {number} view */
  ofView(view) {
    const known = this.codesByView.get(view);
    if (known) return known;
    const { agent, estimate } = this.header.views[view];
    const [codes, matches] = [new Uint16Array(this.rows), new Int32Array(this.rows).fill(-1)];
    this.parts.forEach((part, index) => {
      const row = part.views.get(`${agent} ${estimate}`);
      if (row === undefined) return;
      const start = this.starts[index];
      const own = part.header.meanings.map((each) => this.meaningRows.get(JSON.stringify(each)) ?? 0);
      for (let i = 0; i < part.rows; i++) {
        const code = part.columns.code[row * part.rows + i];
        codes[start + i] = code ? own[code - 1] : 0;
        matches[start + i] = part.matches[row * part.rows + i];
      }
    });
    this.codesByView.set(view, { codes, matches });
    return this.codesByView.get(view);
  }

  before(row) {
    const frame = this.columns["box.frame"][row];
    const place = frame > 0 ? this.parts[frame].before[row - this.starts[frame]] : -1;
    return place < 0 ? -1 : this.starts[frame - 1] + place;
  }

  paths() {
    return [...this.driven.values()];
  }

  get drivenPlaces() {
    return this.places;
  }

  /** Say that no frame of a time is kept. @param {number} seconds */
  absence(seconds) {
    const most = `${MOST_FRAMES} frames, or ${MOST_ROWS.toLocaleString("en")} boxes,`;
    return `The page has no frame of ${seconds.toFixed(1)} s, so it shows its oldest one: it keeps the newest ${most} since it was opened.`;
  }

  numberOf(frame) {
    return this.parts[frame].header.number;
  }

  get begin() {
    return this.times[0];
  }

  get end() {
    const last = this.times[this.frames - 1];
    return Math.max(last, this.times[0] + 1);
  }

  ofAgent(name, agent, frame) {
    return this.parts[frame].columns[`agents.${name}`][agent];
  }

  swept(agent, frame) {
    const sectors = this.agents[agent].sectors ?? 0;
    const start = this.agents.slice(0, agent).reduce((sum, each) => sum + (each.sectors ?? 0), 0);
    return [...(this.parts[frame].columns.swept?.subarray(start, start + sectors) ?? [])];
  }

  series(agent, estimate, measure) {
    const values = new Float64Array(this.frames).fill(-1);
    let known = false;
    this.parts.forEach(({ header, columns }, frame) => {
      const index = header.series.findIndex((each) => each.agent === agent && each.estimate === estimate);
      if (index < 0) return;
      values[frame] = columns[`series.${measure}`][index];
      known = true;
    });
    return known ? values : null;
  }

  trust(agent) {
    return Float64Array.from(this.parts, ({ columns }) => columns.trust[agent]);
  }
}

/** A column of all parts, with numbers as precise as theirs. @param {Part[]} parts @param {string} name */
function chained(parts, name) {
  const length = parts.reduce((sum, part) => sum + part.columns[name].length, 0);
  const whole = parts[0].columns[name] instanceof Int32Array ? new Int32Array(length) : new Float64Array(length);
  let at = 0;
  for (const part of parts) {
    whole.set(part.columns[name], at);
    at += part.columns[name].length;
  }
  return whole;
}

/** The place of the part of each row. @param {Part[]} parts @param {string} name */
function numbered(parts, name) {
  const length = parts.reduce((sum, part) => sum + part.columns[name].length, 0);
  const frames = new Int32Array(length);
  let at = 0;
  parts.forEach((part, index) => {
    frames.fill(index, at, at + part.columns[name].length);
    at += part.columns[name].length;
  });
  return frames;
}

/** @param {Part[]} parts @param {string} name @returns {string[]} all names in the headers */
function united(parts, name) {
  return [...new Set(parts.flatMap((part) => part.header[name]))];
}

/** A column of indexes into names of each header, as indexes into all names. */
function renamed(parts, column, name, names) {
  return Int32Array.from(parts.flatMap((part) => [...part.columns[column]].map((index) => names.indexOf(part.header[name][index]))));
}
