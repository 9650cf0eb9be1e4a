// Collects the frames of a running run.

import { LiveRun, MOST_FRAMES, MOST_ROWS } from "./live_run.js";
import { expand, PATH_STEP_M } from "./run.js";

/** s: resolution of the times of frames. */
const TIME_STEP_S = 1e-3;
/** Most places of the paths of all objects. */
const MOST_PLACES = 20000;

/** @typedef {import("./live_run.js").Part} Part */

/** The newest frames of a running run, which arrive one by one, and what happened until then. */
export class FrameHistory {
  constructor() {
    /** @type {any} of the header */ this.lasting = null;
    /** @type {Part[]} */ this.parts = [];
    /** How many frames were dropped since the last one was added. */
    this.dropped = 0;
    this.clear();
  }

  /** Forget all frames, and what happened in them. */
  clear() {
    this.dropFirst(this.parts.length);
    /** @type {Map<number, {width: number, places: number[][]}>} by id of the object */ this.paths = new Map();
    this.places = 0;
    /** @type {Map<string, any>} what happened, each by what distinguishes it */ this.events = new Map();
    /** @type {Set<string>} nodes that are down */ this.down = new Set();
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
   * @param {{header: any, columns: import("./columns.js").Columns}} block
   * @returns {number | null} how many old frames were dropped; null: the frame is not newer
   */
  add({ header, columns }) {
    const newest = this.parts[this.parts.length - 1];
    if (newest && header.number <= newest.header.number) return null;
    const rows = columns["box.id"].length;
    const views = new Map(header.views.map((view) => [`${view.agent} ${view.estimate}`, view.row]));
    const part = { header, columns, rows, matches: expand(columns.matched, columns.match), before: new Int32Array(0), views };
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
