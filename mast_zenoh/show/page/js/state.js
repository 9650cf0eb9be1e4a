// What the viewer shows: one object that everything listens to.

import { TRUTH } from "./run.js";
import { wholeImage } from "./windows.js";

/** @typedef {{run: number, agent: string, estimate: string, eye?: "above" | "camera"}} PanelChoice eye: from where it is seen */

/** @type {Record<string, [string, boolean]>} names of the layers, in the order of their menu, and which are shown at first */
export const LAYERS = {
  ids: ["ids of objects", false],
  trails: ["trails", true],
  velocity: ["velocity, 1 s ahead", true],
  ellipses: ["uncertainty, 95 %", false],
  links: ["links to the command centre", true],
  ranges: ["sensor ranges", true],
  space: ["space swept free", true],
  points: ["points of the lidar", true],
  manipulations: ["what adversaries changed", true],
  paths: ["paths driven in the run", true],
};

export class State extends EventTarget {
  /** @param {import("./run.js").Run[]} runs @param {number} panels how many are side by side at first */
  constructor(runs, panels) {
    super();
    this.runs = runs;
    /** Of the run that the slider follows: `timeline`. */
    this.frame = 0;
    /** Of a running run: whether the newest frame is shown. */
    this.playing = runs[0].live !== null;
    this.speed = 1;
    /** @type {number | null} s, of the chosen frame, if the page does not keep it: the oldest one is shown */ this.gone = null;
    this.follow = "";
    this.swipe = false;
    /** The window of all camera views. */
    this.lens = wholeImage();
    /** Of the width, where the divider of two swiped panels is. */
    this.share = 0.5;
    /** @type {"paper" | "safe"} */ this.palette = "paper";
    /** @type {"dark" | "light"} */
    this.theme = window.matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    /** @type {Record<string, boolean>} */
    this.layers = Object.fromEntries(Object.entries(LAYERS).map(([name, [, shown]]) => [name, shown]));
    /** Whether the panels are as they were at first. */
    this.untouched = true;
    /** @type {PanelChoice[]} */ this.panels = [];
    this.showPanels(panels);
    this.seekTime(runs[0].times[Math.min(runs[0].header.frame, runs[0].frames - 1)]);
  }

  /** The run that the slider follows: the one that ends last. */
  get timeline() {
    return this.runs.reduce((longest, run) => (run.end > longest.end + 1e-6 ? run : longest));
  }

  /** Change something, and tell all that listen. @param {Partial<State>} changes */
  set(changes) {
    if (Object.entries(changes).every(([name, value]) => this[name] === value)) return;
    Object.assign(this, changes);
    this.dispatchEvent(new CustomEvent("change", { detail: Object.keys(changes) }));
  }

  /** @param {number} count 1 to 3 */
  showPanels(count) {
    const panels = this.panels.slice(0, count);
    while (panels.length < count) panels.push(this.nextChoice(panels.length));
    this.set({ panels, swipe: this.swipe && count > 1 });
  }

  /** What a further panel shows: the other run, or the next estimate of the ego. @param {number} index */
  nextChoice(index) {
    if (this.runs.length > 1) {
      const first = this.panels[0] ?? { agent: this.runs[0].header.ego, estimate: this.first(0, ["picture"]) };
      return { ...first, run: index % this.runs.length };
    }
    const order = [["mission", "picture"], ["picture"], ["local"]][index] ?? [];
    const shown = this.panels.map((panel) => panel.estimate);
    const free = [...order, "local", TRUTH].filter((each) => !shown.includes(each));
    return { run: 0, agent: this.runs[0].header.ego, estimate: this.first(0, free) };
  }

  /** The first estimate that the ego of a run has. @param {number} run @param {string[]} wanted */
  first(run, wanted) {
    const known = this.runs[run].estimatesOf(this.runs[run].header.ego);
    return wanted.find((each) => known.includes(each)) ?? known[0];
  }

  /** @param {number} index @param {Partial<PanelChoice>} changes */
  choose(index, changes) {
    this.untouched = false;
    const panels = this.panels.map((panel, i) => (i === index ? { ...panel, ...changes } : panel));
    const { run, agent, estimate } = panels[index];
    if (!this.runs[run].agentNames.includes(agent)) panels[index].agent = this.runs[run].header.ego;
    const known = this.runs[run].estimatesOf(panels[index].agent);
    if (!known.includes(estimate)) panels[index].estimate = known[0];
    this.set({ panels });
  }

  /** s, of the frame */
  get time() {
    return this.timeline.times[this.frame];
  }

  /** The frame of a run at the current time. @param {number} run */
  frameOf(run) {
    return this.runs[run] === this.timeline ? this.frame : this.runs[run].frameAt(this.time);
  }

  /** @param {number} frame any whole number: kept within the run */
  seek(frame) {
    this.set({ frame: Math.min(Math.max(Math.round(frame), 0), this.timeline.frames - 1), gone: null });
  }

  /** @param {number} seconds */
  seekTime(seconds) {
    this.seek(this.timeline.frameAt(Math.max(seconds, this.timeline.times[0])));
  }
}
