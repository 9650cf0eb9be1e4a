// Buttons, slider and keyboard.

import { choice, element } from "./elements.js";
import { LAYERS } from "./state.js";

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
    const layers = Object.entries(LAYERS).map(([name, [label]]) => {
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
    const of = run.live ? (state.playing ? ", live" : "") : ` of ${run.frames - 1}`;
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
    if (field instanceof HTMLSelectElement || (field && field.type === "range" && event.key.startsWith("Arrow"))) return false;
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
