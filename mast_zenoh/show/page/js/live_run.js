// The newest frames of a running run, which arrive one by one, joined to a run.

import { PATH_STEP_M, Run, expand } from "./run.js";

/** Most frames, and most boxes, that the page keeps. */
export const MOST_FRAMES = 600;
export const MOST_ROWS = 100000;

/**
 * @typedef {{header: any, columns: import("./run.js").Columns, rows: number, matches: Int32Array,
 *            before: Int32Array, views: Map<string, number>}} Part one frame
 */

/** The kept frames of a running run. */
export class LiveRun extends Run {
  /** @param {FrameHistory} frames */
  constructor(frames) {
    const parts = [...frames.parts];
    const { header: newest } = parts[parts.length - 1];
    /** @type {any} */ const columns = { time: Float64Array.from(parts, (part) => part.columns.time[0]) };
    for (const name of Object.keys(parts[0].columns).filter((each) => /^(box|effects|withheld)\./.test(each))) {
      columns[name] = name.endsWith(".frame") ? numbered(parts, name) : chained(parts, name);
    }
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
  absence = (seconds) => {
    const most = `${MOST_FRAMES} frames, or ${MOST_ROWS.toLocaleString("en")} boxes,`;
    return `The page has no frame of ${seconds.toFixed(1)} s, so it shows its oldest one: it keeps the newest ${most} since it was opened.`;
  };

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

/** s: resolution of the times of frames. */
const TIME_STEP_S = 1e-3;
/** Most places of the paths of all objects. */
const MOST_PLACES = 20000;

/** The newest frames of a running run, which arrive one by one, and what happened until then. */
export class FrameHistory {
  constructor() {
    /** @type {any} of the header */ this.lasting = null;
    /** @type {Map<number, {width: number, places: number[][]}>} by id of the object */ this.paths = new Map();
    this.places = 0;
    /** @type {Map<string, any>} what happened, each by what distinguishes it */ this.events = new Map();
    /** @type {Set<string>} nodes that are down */ this.down = new Set();
    /** @type {Part[]} */ this.parts = [];
    /** How many frames were dropped since the last one was added. */
    this.dropped = 0;
  }

  /** Forget all frames, and what happened in them. */
  clear() {
    this.dropFirst(this.parts.length);
    this.paths.clear();
    this.places = 0;
    this.events.clear();
    this.down.clear();
  }

  /** @param {number} count of frames, the oldest */
  dropFirst(count) {
    this.parts.splice(0, count);
    this.dropped += count;
  }

  /**
   * Use another lasting part of the header. Frames with other agents are dropped, and everything of another run.
   * @param {any} lasting
   * @returns {boolean} whether it is of another run
   */
  begin(lasting) {
    const shape = (/** @type {any} */ header) => JSON.stringify(header.agents.map((agent) => [agent.name, agent.sectors]));
    const other = this.lasting !== null && this.lasting.id !== lasting.id;
    if (other) this.clear();
    else if (this.lasting && shape(this.lasting) !== shape(lasting)) this.dropFirst(this.parts.length);
    this.lasting = lasting;
    return other;
  }

  /**
   * Add a frame that is newer than all others. A page that connects again gets its newest frame again.
   * @param {{header: any, columns: import("./run.js").Columns}} block
   * @returns {number | null} how many old frames were dropped; null: the frame is not newer
   */
  add({ header, columns }) {
    const newest = this.parts[this.parts.length - 1];
    if (newest && header.number <= newest.header.number) return null;
    const rows = columns["box.id"].length;
    const views = new Map(header.views.map((view) => [`${view.agent} ${view.estimate}`, view.row]));
    /** @type {Part} */ const part = { header, columns, rows, matches: expand(columns.matched, columns.match), before: new Int32Array(0), views };
    part.before = linked(part, newest);
    this.parts.push(part);
    this.follow(part);
    let kept = this.parts.reduce((sum, each) => sum + each.rows, 0);
    let old = 0;
    while (this.parts.length - old > 1 && (this.parts.length - old > MOST_FRAMES || kept > MOST_ROWS)) {
      kept -= this.parts[old++].rows;
    }
    this.dropFirst(old);
    const { dropped } = this;
    this.dropped = 0;
    return dropped;
  }

  /** Keep the paths of the objects, and what happened. @param {Part} part */
  follow({ header, columns, rows }) {
    for (let row = 0; row < rows && columns["box.truth"][row]; row++) {
      const id = columns["box.id"][row];
      const place = [columns["box.x"][row], columns["box.y"][row]];
      const path = this.paths.get(id) ?? { width: columns["box.w"][row], places: [] };
      const last = path.places[path.places.length - 1];
      if (last && Math.hypot(place[0] - last[0], place[1] - last[1]) <= PATH_STEP_M) continue;
      path.places.push(place);
      this.paths.set(id, path);
      this.places += 1;
    }
    if (this.places > MOST_PLACES) {
      this.paths.clear();
      this.places = 0;
    }
    for (const event of this.happened(header, columns)) {
      const key = JSON.stringify([event.kind, event.text, event.since ?? null]);
      if (!this.events.has(key)) this.events.set(key, event);
    }
  }

  /** What this frame tells of events; `since` distinguishes those with the same text. */
  happened(header, columns) {
    const time = columns.time[0];
    const events = [];
    for (const { kind, begins, ends, from_s: since, until_s: until } of header.spans) {
      if (begins) events.push({ kind, text: begins, time: since, since });
      const over = until < time - TIME_STEP_S; // the time of the frame is rounded
      if (ends && over) events.push({ kind, text: ends, time: until, since });
    }
    const { "effects.effect": effect, "effects.by": by } = columns;
    for (let row = 0; row < effect.length; row++) {
      const name = this.lasting.effects[effect[row]];
      const at = name === "removed" ? "before" : "after";
      const [x, y] = ["x", "y"].map((axis) => columns[`effects.${at}_${axis}`][row]);
      events.push({ kind: "effect", text: `${header.adversaries[by[row]]}: object ${name} (the first that this page has shown)`, time, x, y });
    }
    for (const node of header.down) if (!this.down.has(node)) events.push({ kind: "fault", text: `${node} is down`, time, since: time });
    for (const node of this.down) if (!header.down.includes(node)) events.push({ kind: "fault", text: `${node} is back`, time, since: time });
    this.down = new Set(header.down);
    return events;
  }

  /** The run of all kept frames. */
  joined() {
    return new LiveRun(this);
  }
}

/** @param {Part} part @param {Part | undefined} previous @returns {Int32Array} by row, the row of the object in `previous` */
function linked(part, previous) {
  const before = new Int32Array(part.rows).fill(-1);
  if (!previous || part.header.number - previous.header.number > 3) return before;
  const rows = new Map(keysOf(previous).map((key, row) => [key, row]));
  keysOf(part).forEach((key, row) => {
    before[row] = rows.get(key) ?? -1;
  });
  return before;
}

/** What names the object of each box: its id, and the first view that has it. @param {Part} part @returns {string[]} */
function keysOf({ columns, rows, header }) {
  const views = columns.code.length / Math.max(rows, 1);
  const names = header.views.filter((view, i) => header.views.findIndex((each) => each.row === view.row) === i);
  const byRow = new Map(names.map((view) => [view.row, `${view.agent} ${view.estimate}`]));
  return Array.from({ length: rows }, (_, row) => {
    const id = columns["box.id"][row];
    if (columns["box.truth"][row]) return `truth ${id}`;
    let view = 0;
    while (view < views && !columns.code[view * rows + row]) view++;
    return `${byRow.get(view)} ${id}`;
  });
}
