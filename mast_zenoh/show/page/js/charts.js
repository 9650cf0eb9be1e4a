// The numbers over time, below the panels and on their time: bands, missed, false, RMSE, trust.

import { element, resizeCanvas } from "./controls.js";
import { colourOfKind, faded } from "./palette.js";
import { TRUTH } from "./run.js";

const LEFT = 74;
const RIGHT = 14;
const LANE = 17;
const ROW = 62;
const FOOT = 24;
/** Kinds of spans that say what the command centre thinks, not what happens. */
const JUDGEMENTS = ["suspension", "undecided"];
const DASHES = [[], [6, 3], [2, 2.5], [8, 3, 2, 3], [1, 4]];

/** @typedef {{label: string, unit: string, least: number, lines: {values: ArrayLike<number>, times: ArrayLike<number>, colour: string, dash: number[], name: string, scored: number[]}[]}} Row */

export class Charts {
  /** @param {import("./state.js").State} state */
  constructor(state) {
    this.state = state;
    this.canvas = element("canvas", { class: "v-charts", role: "img", "aria-label": "Numbers over time" });
    this.legend = element("p", { class: "v-series" });
    this.now = element("div", { class: "v-cursor" });
    this.root = element("div", { class: "v-time" }, element("div", { class: "v-plot" }, this.canvas, this.now), this.legend);
    const seek = (event) => {
      const box = this.canvas.getBoundingClientRect();
      const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
      if (state.runs[0].live) state.set({ playing: false });
      state.seekTime(this.begin + share * (this.end - this.begin));
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.canvas.addEventListener("pointermove", (event) => event.buttons && seek(event));
  }

  get begin() {
    return Math.min(...this.state.runs.map((run) => run.begin));
  }

  get end() {
    return Math.max(...this.state.runs.map((run) => run.end));
  }

  /** Draw if anything but the time has changed, and place the line at the time. @param {import("./palette.js").Palette} palette */
  draw(palette) {
    const { state, canvas } = this;
    const grown = state.runs.map((run) => [run.end, run.spans.length]);
    const key = JSON.stringify([canvas.clientWidth, window.devicePixelRatio, palette.name, state.panels, grown]);
    if (key !== this.key) this.drawAll(palette);
    this.key = key;
    const share = (state.time - this.begin) / (this.end - this.begin);
    this.now.style.transform = `translateX(${Math.round(LEFT + share * (canvas.clientWidth - LEFT - RIGHT))}px)`;
  }

  drawAll(palette) {
    const rows = this.rows(palette);
    const spans = this.spans();
    const lanes = placeInLanes(spans, this.end - this.begin);
    const head = lanes.length ? lanes.length * LANE + 8 : 4;
    this.canvas.style.height = `${head + rows.length * ROW + FOOT + 2}px`; // with its border
    const { context, width, height } = resizeCanvas(this.canvas);
    const [begin, end] = [this.begin, this.end];
    const x = (seconds) => LEFT + ((Math.max(seconds, begin) - begin) / (end - begin)) * (width - LEFT - RIGHT);
    context.fillStyle = palette.ground;
    context.fillRect(0, 0, width, height);
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    this.drawBands(context, palette, lanes, x, height, width);
    rows.forEach((row, index) => drawRow(context, palette, row, x, head + index * ROW, width));
    drawAxis(context, palette, begin, end, x, height - FOOT);
    this.now.style.height = `${height - FOOT}px`;
    this.showLegend(rows);
  }

  /** Bands of all runs that a panel shows, each once. */
  spans() {
    const shown = [...new Set(this.state.panels.map((panel) => panel.run))];
    const unique = new Map();
    for (const run of shown) for (const span of this.state.runs[run].spans) if (span.until_s >= this.begin) unique.set(JSON.stringify(span), span);
    return [...unique.values()];
  }

  /** @param {import("./palette.js").Palette} palette @returns {Row[]} */
  rows(palette) {
    const { state } = this;
    /** @type {[string, "fn" | "fp" | "rmse_m", string, number][]} */
    const measures = [["missed", "fn", "", 2], ["false", "fp", "", 2], ["RMSE", "rmse_m", "m", 0.5]];
    /** @type {Row[]} */
    const rows = measures.map(([label, measure, unit, least]) => ({ label, unit, least, lines: this.lines(palette, measure) }));
    const name = (/** @type {import("./run.js").Run} */ run, /** @type {string} */ car) => (state.runs.length > 1 ? `${run.header.name}, ${car}` : car);
    const shown = [...new Set(state.panels.map((panel) => state.runs[panel.run]))];
    const drives = shown.flatMap((run) => run.drives.map(({ car }, row) => ({ run, row, name: name(run, car) })));
    for (const [label, unit, values] of /** @type {[string, string, (run: any, row: number) => ArrayLike<number>][]} */ ([
      ["speed", "m/s", (run, row) => run.drive(row, "speed")],
      ["braking", "m/s²", (run, row) => run.drive(row, "acceleration").map((/** @type {number} */ value) => Math.max(-value, 0))],
    ])) {
      const lines = drives.map(({ run, row, name }, index) => ({
        values: values(run, row), times: run.times, colour: palette.lines[index % palette.lines.length], dash: DASHES[index % DASHES.length], name, scored: [0, run.frames - 1],
      }));
      rows.push({ label, unit, least: 2, lines });
    }
    const judged = state.runs[state.panels[0].run];
    if (judged.header.judged) {
      const colours = palette.agents;
      const lines = judged.agents.map((agent, index) => ({
        values: judged.trust(index), times: judged.times, colour: colours[index % colours.length],
        dash: DASHES[(index + Math.floor(index / colours.length)) % DASHES.length], name: agent.name, scored: [0, -1],
      }));
      rows.push({ label: "trust", unit: "", least: 1, lines });
    }
    return rows.filter((row) => row.lines.length);
  }

  lines(palette, measure) {
    const { state } = this;
    return state.panels.flatMap(({ run, agent, estimate }, index) => {
      const values = estimate === TRUTH ? null : state.runs[run].series(agent, estimate, measure, state.runs[run].every > 1 ? "peaks" : "series");
      if (!values) return [];
      const label = state.runs[run].header.estimates[estimate] ?? estimate;
      const short = label.replace("ego alone", "own tracks").replace("alone, as", "own tracks as").replace("ego with", "with");
      const of = label.includes("ego") && agent === state.runs[run].header.ego ? label : `${agent}: ${short}`;
      const name = state.runs.length > 1 ? `${state.runs[run].header.name}, ${of}` : of;
      const scored = state.runs[run].header.scored ?? [0, values.length - 1];
      return [{ values, times: state.runs[run].times, colour: palette.lines[index], dash: DASHES[index], name, scored }];
    });
  }

  drawBands(context, palette, lanes, x, height, width) {
    lanes.forEach((lane, index) => {
      for (const { span, labelAt } of lane) {
        const colour = colourOfKind(span.kind, palette);
        const [from, until] = [x(span.from_s), x(span.until_s)];
        if (!JUDGEMENTS.includes(span.kind)) {
          context.fillStyle = faded(colour, 0.09);
          context.fillRect(from, 0, until - from, height - FOOT);
        }
        context.fillStyle = faded(colour, 0.55);
        context.fillRect(from, 4 + index * LANE, Math.max(until - from, 2), LANE - 4);
        context.textBaseline = "middle";
        const text = shortened(context, span.label, Math.max(width - RIGHT - Math.max(from, x(labelAt)) - 6, 60));
        const at = Math.min(Math.max(from, LEFT) + 4, width - RIGHT - context.measureText(text).width - 2);
        context.lineWidth = 3;
        context.strokeStyle = palette.ground;
        context.strokeText(text, at, 3 + index * LANE + LANE / 2 - 1);
        context.fillStyle = palette.ink;
        context.fillText(text, at, 3 + index * LANE + LANE / 2 - 1);
      }
    });
  }

  /** @param {Row[]} rows */
  showLegend(rows) {
    const names = (/** @type {Row | undefined} */ row) => row?.lines.map(({ name, colour, dash }) => swatch(name, colour, dash)) ?? [];
    const trust = rows.find((row) => row.label === "trust");
    const estimates = names(rows.find((row) => row.label !== "trust"));
    this.legend.replaceChildren(...estimates, ...(trust ? [element("span", { class: "v-break" }, "trust in"), ...names(trust)] : []));
  }
}

/** @param {string} name @param {string} colour @param {number[]} dash */
function swatch(name, colour, dash) {
  const line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  line.setAttribute("viewBox", "0 0 28 8");
  line.setAttribute("class", "v-swatch");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  for (const [key, value] of Object.entries({ d: "M0 4H28", stroke: colour, "stroke-width": 2.5, "stroke-dasharray": dash.join(" ") })) {
    path.setAttribute(key, String(value));
  }
  line.append(path);
  return element("span", { class: "v-key" }, line, name);
}

/** Put bands into the fewest lanes, so that none overlap; undecided agents take what the others leave. */
function placeInLanes(spans, length) {
  const lanes = [];
  const open = (/** @type {{kind: string}} */ span) => Number(span.kind === "undecided");
  for (const span of [...spans].sort((a, b) => open(a) - open(b) || a.from_s - b.from_s)) {
    const needed = Math.max(span.until_s, span.from_s + 0.3 * length);
    const lane = lanes.find((each) => each[each.length - 1].until <= span.from_s);
    const placed = { span, until: needed, labelAt: span.from_s };
    if (lane) lane.push(placed);
    else if (lanes.length < 8) lanes.push([placed]);
  }
  return lanes;
}

/** @param {CanvasRenderingContext2D} context */
function shortened(context, text, width) {
  if (context.measureText(text).width <= width) return text;
  let kept = text;
  while (kept.length > 4 && context.measureText(`${kept}…`).width > width) kept = kept.slice(0, -1);
  return `${kept.trimEnd()}…`;
}

/** @param {CanvasRenderingContext2D} context @param {Row} row */
function drawRow(context, palette, row, x, top, width) {
  let high = row.least; // of the scored frames: the first ones, without tracks, would flatten all others
  for (const { values, scored } of row.lines) for (let i = scored[0]; i <= scored[1]; i++) high = Math.max(high, values[i] ?? 0);
  const bottom = top + ROW - 8;
  const y = (value) => bottom - (Math.min(value, high) / high) * (ROW - 18);
  context.strokeStyle = palette.grid;
  context.lineWidth = 1;
  context.fillStyle = palette.faint;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const digits = high >= 3 ? 0 : 1;
  for (const value of [0, high]) {
    context.beginPath();
    context.moveTo(LEFT, y(value));
    context.lineTo(width - RIGHT, y(value));
    context.stroke();
    context.fillText(value ? value.toFixed(digits) : "0", LEFT - 5, y(value));
  }
  context.textAlign = "left";
  context.fillStyle = palette.ink;
  context.fillText(row.label, 6, (y(0) + y(high)) / 2 - (row.unit ? 6 : 0));
  if (row.unit) context.fillText(`(${row.unit})`, 6, (y(0) + y(high)) / 2 + 9);
  for (const { values, times, colour, dash } of row.lines) {
    context.strokeStyle = colour;
    context.lineWidth = 1.6;
    context.setLineDash(dash);
    context.beginPath();
    for (let i = 0; i < values.length; i++) {
      if (values[i] < 0) continue;
      if (i && values[i - 1] >= 0) context.lineTo(x(times[i]), y(values[i]));
      else context.moveTo(x(times[i]), y(values[i]));
    }
    context.stroke();
    context.setLineDash([]);
  }
}

/** @param {CanvasRenderingContext2D} context */
function drawAxis(context, palette, begin, end, x, top) {
  const step = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((each) => x(begin + each) - x(begin) >= 48) ?? 1000;
  context.fillStyle = palette.faint;
  context.strokeStyle = palette.faint;
  context.textBaseline = "top";
  context.textAlign = "center";
  for (let seconds = Math.ceil(begin / step - 1e-9) * step; seconds <= end + 1e-9; seconds += step) {
    context.beginPath();
    context.moveTo(x(seconds), top);
    context.lineTo(x(seconds), top + 4);
    context.stroke();
    context.fillText(`${seconds}`, x(seconds), top + 6);
  }
  context.textAlign = "left";
  context.fillText("time (s)", 6, top + 6);
}
