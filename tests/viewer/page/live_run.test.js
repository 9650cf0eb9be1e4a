// The page keeps the newest frames of one running run, each once, and every event of it.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { FrameHistory } from "../../../mast_zenoh/show/page/js/live_run.js";

const WHOLE = ["id", "kind", "truth", "known", "effect", "downlink", "by", "subscriber", "frame"];
const GEOMETRY = ["frame", "id", "x", "y", "z", "l", "w", "h", "yaw"];
const MOTION = ["score", "known", "vx", "vy", "sx", "sy", "rho", "kind", "truth"];
const PLACES = ["before_x", "before_y", "before_z", "after_x", "after_y", "after_z"];
const LASTING = { id: "run-1", label: "a run", agents: [{ name: "ego", sectors: 8 }], effects: ["inserted", "removed"] };

let history;
beforeEach(() => {
  history = new FrameHistory();
  history.begin(LASTING);
});

/** Add a block of one frame, all of whose boxes are objects. */
function add(number, { time = number / 10, boxes = 2, x = 0, spans = [], down = [], effects = [] } = {}) {
  const columns = { time: [time], matched: [], match: [], code: [] };
  const filled = (group, name, rows, value) => {
    const kind = WHOLE.includes(name) ? Int32Array : Float64Array;
    columns[`${group}.${name}`] = kind.from({ length: rows }, (_, row) => value(row));
  };
  const box = { id: (row) => row, truth: () => 1, x: () => x };
  for (const name of [...GEOMETRY, ...MOTION]) filled("box", name, boxes, box[name] ?? (() => 0));
  for (const name of GEOMETRY) filled("withheld", name, 0, () => 0);
  for (const name of ["effect", "frame", "by", "subscriber", "downlink", ...PLACES]) {
    filled("effects", name, effects.length, (row) => (name === "effect" ? effects[row] : 0));
  }
  const names = { adversaries: ["adversary_1"], subscribers: [""], views: [], meanings: [], series: [] };
  return history.add({ header: { number, spans, down, ...names }, columns });
}

test("old frames are dropped and counted", () => {
  let dropped = 0;
  for (let number = 0; number < 605; number++) dropped += add(number);
  const first = history.joined();
  assert.deepEqual([dropped, first.frames, first.numberOf(0)], [5, 600, 5]);
  assert.deepEqual([605, 606, 607].map((number) => add(number, { boxes: 40000 })), [1, 1, 599]);
  const last = history.joined();
  assert.deepEqual([last.frames, last.numberOf(0), last.rows], [2, 606, 80000]);
  assert.match(last.absence(1.25), /^The page has no frame of 1.3 s, so it shows its oldest one/);
});

test("frames of another run are not joined", () => {
  const spans = [{ kind: "fault", begins: "Delay begins", ends: "Delay heals", from_s: 0, until_s: 9 }];
  for (const number of [7, 8, 9]) add(number, { spans, down: ["infra_1"] });
  const kept = () => [history.parts.length, history.paths.size, history.events.size, history.down.size];
  assert.deepEqual([history.begin({ ...LASTING, label: "rewired" }), ...kept()], [false, 3, 2, 2, 1]);
  const otherAgents = [history.begin({ ...LASTING, agents: [] }), ...kept(), add(10)];
  assert.deepEqual(otherAgents, [false, 0, 2, 2, 1, 3], "what happened is kept, and the dropped frames are counted");
  assert.deepEqual([history.begin({ ...LASTING, id: "run-2" }), ...kept(), add(0)], [true, 0, 0, 0, 0, 1]);
  assert.deepEqual([history.joined().frames, history.joined().drivenPlaces], [1, 2]);
});

test("a frame that arrives again is ignored", () => {
  assert.deepEqual([add(5), add(5), add(4), add(6)], [0, null, null, 0]);
  assert.deepEqual(history.parts.map((part) => part.header.number), [5, 6]);
});

test("equal events at other times are all listed once", () => {
  const delay = (from_s, until_s) => ({ kind: "fault", begins: "Delay begins", ends: "Delay heals", from_s, until_s });
  const link = (from_s, until_s) => ({ kind: "interception", begins: "link_1 inserted", ends: "link_1 removed", from_s, until_s });
  const down = ["infra_1"];
  add(1, { effects: [0, 0], down });
  add(2, { effects: [0], spans: [link(0.15, 0.2)] });
  add(3, { time: 0.333, spans: [link(0.15, 1 / 3 - 4e-4)] }); // still inserted: times are rounded
  add(7, { spans: [link(0.15, 0.35), link(0.6, 0.7), delay(0.5, 0.8)], down });
  const spans = [link(0.15, 0.35), link(0.6, 0.9), delay(0.5, 0.8), delay(1.5, 9)];
  for (const number of [20, 30]) add(number, { spans });
  assert.deepEqual([...history.events.values()].map((event) => `${event.time} ${event.text}`).sort(), [
    "0.1 adversary_1: object inserted (the first that this page has shown)",
    "0.1 infra_1 is down",
    "0.15 link_1 inserted",
    "0.2 infra_1 is back",
    "0.35 link_1 removed",
    "0.5 Delay begins",
    "0.6 link_1 inserted",
    "0.7 infra_1 is down",
    "0.8 Delay heals",
    "0.9 link_1 removed",
    "1.5 Delay begins",
    "2 infra_1 is back",
  ]);
});

test("places are as precise as in a finished run: map coordinates have seven digits before the point", () => {
  add(1, { x: 4567890.12 });
  add(2, { x: 4567890.13 });
  const joined = history.joined();
  const { "box.x": x, "box.id": id } = joined.columns;
  assert.deepEqual([...x], [4567890.12, 4567890.12, 4567890.13, 4567890.13]);
  assert.equal(id.constructor.name, "Int32Array");
  assert.equal(joined.before(3), 1);
});
