// Buttons, slider, keyboard, legend, events and the divider of two panels.

import { OUTCOMES, faded } from "./palette.js";
import { LAYERS } from "./state.js";

/**
 * Make an element.
 * @param {string} tag
 * @param {Record<string, any>} properties attributes; functions are listeners: onclick
 * @param {(Node | string)[]} children
 * @returns {any}
 */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== undefined) made.setAttribute(name, String(value));
  }
  made.append(...children);
  return made;
}

/**
 * Make a list of choices.
 * @param {string} label for those who do not see it
 * @param {[string, string][]} options value and text
 * @param {string} value the chosen one
 * @param {(value: string) => void} onchange
 */
export function choice(label, options, value, onchange) {
  const items = options.map(([each, text]) => element("option", { value: each, selected: each === value }, text));
  const select = element("select", { "aria-label": label, title: label }, ...items);
  select.addEventListener("change", () => onchange(select.value));
  return select;
}

/**
 * Fit a canvas to its place on the page and to the resolution of the screen.
 * @param {HTMLCanvasElement} canvas
 * @returns {{context: CanvasRenderingContext2D, width: number, height: number}} sizes in CSS pixels
 */
export function resizeCanvas(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  // Keeps the pixels out of the graphics card: without one, drawing through its emulation takes five times as long.
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const HELP = [
  ["space", "play or pause"], ["← →", "one frame back or on"], ["shift ← →", "ten frames"], ["home, end", "first, last frame"],
  ["+ −", "zoom"], ["f", "fit"], ["1 2 3", "number of panels"], ["w", "swipe"], ["c", "camera in the first panel"], ["i", "ids"], ["drag, wheel", "pan, zoom"],
];

export class Controls {
  /**
   * @param {import("./state.js").State} state
   * @param {{fit: () => void, zoom: (factor: number) => void}} actions
   */
  constructor(state, actions) {
    this.state = state;
    this.actions = actions;
    /** @type {HTMLButtonElement[]} */ this.counts = [];
    const last = state.timeline.frames - 1;
    this.play = element("button", { type: "button", class: "v-play", onclick: () => state.set({ playing: !state.playing }) });
    this.slider = element("input", {
      type: "range", min: 0, max: last, step: 1, value: state.frame, class: "v-slider", "aria-label": "frame",
      oninput: () => {
        if (state.runs[0].live) state.set({ playing: Number(this.slider.value) === state.runs[0].frames - 1 });
        state.seek(Number(this.slider.value));
      },
    });
    this.time = element("output", { class: "v-now" });
    const step = (by, text, label) => {
      const onclick = () => this.step(by);
      return element("button", { type: "button", title: label, "aria-label": label, onclick }, text);
    };
    const speed = state.runs[0].live ? [] : [this.speeds()];
    this.notice = element("p", { class: "v-notice", role: "status", hidden: true });
    this.transport = element(
      "div", { class: "v-transport" }, this.play, step(-1, "‹", "one frame back"), step(1, "›", "one frame on"), this.slider, this.time, ...speed,
    );
    this.toolbar = element("div", { class: "v-toolbar" }, ...this.tools());
  }

  /** How fast a finished run is played. */
  speeds() {
    return choice("speed", SPEEDS.map((each) => [String(each), `${each}×`]), "1", (value) => this.state.set({ speed: Number(value) }));
  }

  tools() {
    const { state } = this;
    this.counts = [1, 2, 3].map((count) => {
      const names = ["one panel", "two panels side by side", "three panels side by side"];
      const onclick = () => state.showPanels(count);
      return element("button", { type: "button", title: names[count - 1], "aria-label": names[count - 1], onclick }, String(count));
    });
    const onswipe = () => {
      if (state.panels.length < 2) state.showPanels(2);
      state.set({ swipe: !state.swipe });
    };
    this.swipe = element("button", { type: "button", title: "compare two panels by swiping (w)", onclick: onswipe }, "swipe");
    const some = { links: (run) => run.header.centre, points: (run) => run.scanned };
    const possible = Object.entries(LAYERS).filter(([name]) => !some[name] || state.runs.some(some[name]));
    const layers = possible.map(([name, [label]]) => {
      const box = element("input", { type: "checkbox", checked: state.layers[name] });
      box.addEventListener("change", () => state.set({ layers: { ...state.layers, [name]: box.checked } }));
      return element("label", { "data-layer": name }, box, ` ${label}`);
    });
    this.layers = element("details", { class: "v-menu" }, element("summary", {}, "layers"), element("div", {}, ...layers));
    /** @type {[string, string][]} */
    const agents = state.runs[0].agents.map((agent) => [agent.name, `follow ${agent.name}`]);
    this.follow = choice("follow an agent", [["", "follow: none"], ...agents], "", (value) => state.set({ follow: value }));
    const fit = element("button", { type: "button", title: "fit (f)", onclick: this.actions.fit }, "fit");
    this.colours = choice("colours", [["paper", "paper’s colours"], ["safe", "colour-blind safe"]], "paper", (value) =>
      state.set({ palette: /** @type {"paper" | "safe"} */ (value) }));
    const ontheme = () => state.set({ theme: state.theme === "dark" ? "light" : "dark" });
    this.theme = element("button", { type: "button", class: "v-theme", onclick: ontheme });
    const help = HELP.map(([keys, what]) => element("div", {}, element("kbd", {}, keys), ` ${what}`));
    const keys = element("details", { class: "v-menu" }, element("summary", {}, "keys"), element("div", {}, ...help));
    const group = element("span", { class: "v-group" }, element("span", {}, "panels"), ...this.counts, this.swipe);
    return [group, this.layers, this.follow, fit, this.colours, this.theme, keys];
  }

  /** @param {number} by frames */
  step(by) {
    this.state.set({ playing: false });
    this.state.seek(this.state.frame + by);
  }

  update() {
    const { state } = this;
    this.play.textContent = state.playing ? "❚❚" : "▶";
    this.play.setAttribute("aria-label", state.playing ? "pause" : "play");
    const run = state.timeline;
    this.slider.max = String(run.frames - 1);
    this.slider.value = String(state.frame);
    const of = run.live ? (state.playing ? ", live" : "") : ` of ${run.numberOf(run.frames - 1)}${run.every > 1 ? `, one in ${run.every}` : ""}`;
    this.time.textContent = `${state.time.toFixed(1)} s · frame ${run.numberOf(state.frame)}${of}`;
    this.notice.hidden = state.gone === null;
    const notice = state.gone === null ? "" : run.absence(state.gone);
    if (this.notice.textContent !== notice) this.notice.textContent = notice;
    this.counts.forEach((button, i) => button.setAttribute("aria-pressed", String(i + 1 === state.panels.length)));
    this.swipe.setAttribute("aria-pressed", String(state.swipe));
    this.follow.value = state.follow;
    this.colours.value = state.palette;
    this.theme.textContent = state.theme === "dark" ? "light" : "dark";
    this.layers.querySelectorAll("label").forEach((label) => {
      label.querySelector("input").checked = state.layers[label.dataset.layer];
    });
  }

  /** @param {KeyboardEvent} event @returns {boolean} whether the key means something here */
  key(event) {
    const { state, actions } = this;
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const field = event.target instanceof Element && event.target.closest("select, summary, input, button");
    if (field && [" ", "Enter", "ArrowUp", "ArrowDown"].includes(event.key)) return false;
    if (field instanceof HTMLSelectElement || (field instanceof HTMLInputElement && field.type === "range" && event.key.startsWith("Arrow"))) return false;
    const far = event.shiftKey ? 10 : 1;
    const actionsByKey = {
      " ": () => state.set({ playing: !state.playing }),
      ArrowLeft: () => this.step(-far), ArrowRight: () => this.step(far),
      Home: () => this.step(-Infinity), End: () => (state.runs[0].live ? state.set({ playing: true }) : this.step(state.timeline.frames)),
      "+": () => actions.zoom(1.25), "=": () => actions.zoom(1.25), "-": () => actions.zoom(0.8), f: actions.fit,
      1: () => state.showPanels(1), 2: () => state.showPanels(2), 3: () => state.showPanels(3),
      c: () => state.choose(0, { eye: state.panels[0].eye === "camera" ? "above" : "camera" }),
      w: () => this.swipe.click(), i: () => state.set({ layers: { ...state.layers, ids: !state.layers.ids } }),
    };
    const action = actionsByKey[event.key];
    action?.();
    return action !== undefined;
  }
}

export class Swipe {
  /**
   * @param {HTMLElement} stage that holds the panels
   * @param {import("./state.js").State} state
   */
  constructor(stage, state) {
    this.stage = stage;
    this.state = state;
    this.handle = element("div", {
      class: "v-divider", role: "separator", tabindex: 0, "aria-label": "divider of the two panels", "aria-valuemin": 0, "aria-valuemax": 100,
    });
    this.handle.addEventListener("pointerdown", (event) => this.handle.setPointerCapture(event.pointerId));
    this.handle.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      const box = stage.getBoundingClientRect();
      this.place((event.clientX - box.left) / box.width);
    });
    this.handle.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -0.05, ArrowRight: 0.05 }[event.key];
      if (by === undefined) return;
      event.stopPropagation();
      event.preventDefault();
      this.place(this.state.share + by);
    });
    this.place(0.5);
  }

  /** @param {number} share of the width that shows the first panel */
  place(share) {
    const kept = Math.min(Math.max(share, 0), 1);
    this.state.set({ share: kept });
    this.stage.style.setProperty("--swipe", `${kept * 100}%`);
    this.handle.setAttribute("aria-valuenow", String(Math.round(kept * 100)));
  }
}

const LABELS = {
  "truth matched": "truth, matched", "track matched": "track, matched", "truth missed": "missed truth (FN)",
  "track false": "false track (FP)", "unevaluated": "not evaluated",
};

/**
 * Make the legend.
 * @param {import("./palette.js").Palette} palette
 * @param {import("./run.js").Run[]} runs
 * @returns {HTMLElement[]}
 */
export function legendOf(palette, runs) {
  const boxes = [...OUTCOMES.slice(1), OUTCOMES[0]].map((name) => {
    const filled = name === "truth missed" || name === "track false";
    const colour = palette.outcomes[name];
    const crossed = name === "track false" ? `<path d="M2 2L20 12M2 12L20 2" stroke="${colour}"/>` : "";
    const dash = name === "unevaluated" ? ' stroke-dasharray="4 3"' : "";
    const fill = filled ? faded(colour, 0.35) : "none";
    return key(LABELS[name], `<rect x="2" y="2" width="18" height="10" fill="${fill}" stroke="${colour}" stroke-width="1.6"${dash}/>${crossed}`);
  });
  const agent = palette.agent;
  const signs = [
    key("vehicle with sensors", `<circle cx="11" cy="7" r="5" fill="none" stroke="${agent}" stroke-width="2"/>`),
    key("roadside sensor", `<path d="M11 1L17 12H5Z" fill="${agent}"/>`),
  ];
  if (runs.some((run) => run.header.judged)) {
    signs.push(...Object.entries(palette.states).map(([name, colour]) => key(`${name} agent`, `<path d="M11 1L17 12H5Z" fill="${colour}"/>`)));
    signs.push(key("withheld object", `<rect x="2" y="2" width="18" height="10" fill="none" stroke="${palette.withheld}" stroke-dasharray="3 2" stroke-width="1.4"/>`));
  }
  if (runs.some((run) => run.agents.some((each) => each.adversaries.length))) {
    const colour = palette.adversary;
    const ring = `<circle cx="11" cy="7" r="6" fill="none" stroke="${colour}"`;
    signs.push(
      key("adversary on its wire", `${ring} stroke-dasharray="3 2"/>`),
      key("lying now", `${ring} stroke-width="2.5"/>`),
      key("inserted", `<path d="M11 0L18 7L11 14L4 7Z" fill="none" stroke="${colour}" stroke-width="1.6"/>`),
      key("removed", `<path d="M5 1L17 13M5 13L17 1" stroke="${colour}" stroke-width="2"/>`),
      key("moved", `<path d="M2 7H19M14 3L19 7L14 11" fill="none" stroke="${colour}" stroke-width="1.6"/>`),
    );
  }
  if (runs.some((run) => run.header.spoofers?.length)) signs.push(key("spoofer of a lidar", `<rect x="7" y="3" width="8" height="8" fill="${palette.adversary}"/>`));
  if (runs.some((run) => run.scanned)) signs.push(key("point of the lidar", `<circle cx="11" cy="7" r="1.5" fill="${palette.faint}"/>`));
  const spans = runs.flatMap((run) => run.spans);
  if (runs.some((run) => run.header.centre && run.agents.length)) signs.push(key("link to the command centre", `<path d="M1 7H21" stroke="${palette.faint}" stroke-width="1.4"/>`));
  if (spans.some((span) => span.cut?.length)) {
    signs.push(key("cut by a partition", `<path d="M0 7H7M15 7H22" stroke="${palette.fault}" stroke-width="2" stroke-dasharray="4 2"/>` +
      `<path d="M8 2V12M14 2V12" stroke="${palette.fault}" stroke-width="2"/>`));
  }
  if (spans.some((span) => span.impaired?.length)) {
    signs.push(key("impaired by a fault", `<path d="M1 7H21" stroke="${palette.fault}" stroke-width="1.8" stroke-dasharray="2 3"/>`));
  }
  return [...boxes, ...signs];
}

/** @param {string} text @param {string} drawing SVG without any text of the run */
function key(text, drawing) {
  const sign = element("span", { class: "v-sign", "aria-hidden": "true" });
  sign.innerHTML = `<svg viewBox="0 0 22 14">${drawing}</svg>`;
  return element("span", { class: "v-key" }, sign, text);
}

export class EventList {
  /**
   * @param {import("./state.js").State} state
   * @param {(x: number, y: number) => void} goTo shows a place
   */
  constructor(state, goTo) {
    this.state = state;
    this.goTo = goTo;
    /** @type {number[]} s, of all events */ this.times = [];
    /** How many are marked as past. */ this.past = 0;
    this.list = element("ol", { class: "v-events" });
    this.root = element("div", { class: "v-side" }, element("h3", {}, "Events"), this.list);
    this.fill();
  }

  /** Make the list of the runs that panels show. */
  fill() {
    const runs = [...new Set(this.state.panels.map((panel) => panel.run))];
    const events = runs.flatMap((index) => this.state.runs[index].events.map((event) => ({ ...event, run: index })));
    const timed = events.map((event) => ({ ...event, time: event.time ?? this.state.runs[event.run].times[event.frame] }));
    timed.sort((a, b) => a.time - b.time);
    this.times = timed.map((event) => event.time);
    this.past = 0;
    const several = runs.length > 1;
    this.list.replaceChildren(
      ...timed.map((event) => {
        const text = several ? `${this.state.runs[event.run].header.name}: ${event.text}` : event.text;
        const onclick = () => {
          this.state.set({ playing: false });
          this.state.seekTime(event.time);
          const { live, begin } = this.state.timeline;
          if (live && event.time < begin - 1e-3) this.state.set({ gone: event.time });
          if (event.x !== undefined && event.y !== undefined) this.goTo(event.x, event.y);
        };
        const time = element("span", { class: "v-when" }, `${event.time.toFixed(1)} s`);
        return element("li", {}, element("button", { type: "button", class: `v-event v-${event.kind}`, onclick }, time, text));
      }),
    );
    if (!timed.length) this.list.append(element("li", { class: "v-none" }, this.state.runs[0].live ? "Nothing has happened yet." : "Nothing was planned or changed in this run."));
  }

  /** Mark the events that have happened. */
  mark() {
    const later = this.times.findIndex((time) => time > this.state.time + 1e-6);
    const past = later < 0 ? this.times.length : later;
    for (let i = Math.min(past, this.past); i < Math.max(past, this.past); i++) {
      this.list.children[i].classList.toggle("v-past", i < past);
    }
    this.past = past;
  }
}
