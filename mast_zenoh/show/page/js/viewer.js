// The viewer: panels, controls, charts and events around one state.

import { Charts } from "./charts.js";
import { Controls, EventList, Swipe, element, legendOf } from "./controls.js";
import { agentMarks, marksOf } from "./marks.js";
import { paletteOf } from "./palette.js";
import { Panel } from "./panel.js";
import { State } from "./state.js";
import { Viewport, wholeImage } from "./windows.js";

export class Viewer {
  /** @param {HTMLElement} root @param {import("./run.js").Run[]} runs */
  constructor(root, runs) {
    this.root = root;
    const wide = root.clientWidth;
    this.state = new State(runs, runs.length > 1 ? 2 : wide >= 1500 ? 3 : wide >= 800 ? 2 : 1);
    this.viewport = new Viewport();
    this.controls = new Controls(this.state, { fit: () => this.fit(), zoom: (factor) => this.zoom(factor) });
    this.stage = element("div", { class: "v-panels" });
    this.swipe = new Swipe(this.stage, this.state);
    this.legend = element("p", { class: "v-legend" });
    this.charts = new Charts(this.state);
    this.events = new EventList(this.state, (x, y) => this.goTo(x, y));
    const below = element("div", { class: "v-below" }, this.charts.root, this.events.root);
    root.replaceChildren(this.controls.toolbar, this.stage, this.legend, this.controls.transport, this.controls.notice, below);
    this.advancing = 0;
    /** Number of the next drawing that the screen was asked for, 0: none. */ this.waiting = 0;
    /** Name of the palette of the legend. */ this.colours = "";
    this.printing = false;
    this.print = window.matchMedia("print");
    this.panels = this.makePanels();
    this.listen();
    this.update(["theme"]);
    this.fit(); // after the panels have their places
  }

  /** What a panel shows, as data. @param {number} index */
  marks(index = 0) {
    return this.panels[index].marks();
  }

  makePanels() {
    const panels = this.state.panels.map((_, index) => new Panel(this.state, this.viewport, index));
    panels[0].beside = panels[1] ?? null;
    this.stage.replaceChildren(...panels.map((panel) => panel.root), this.swipe.handle);
    return panels;
  }

  listen() {
    const { state, root } = this;
    state.addEventListener("change", (event) => this.update(/** @type {CustomEvent} */ (event).detail));
    const target = document.body.classList.contains("v-alone") ? document : root;
    target.addEventListener("keydown", (event) => {
      if (this.controls.key(/** @type {KeyboardEvent} */ (event))) event.preventDefault();
    });
    new ResizeObserver(() => this.redraw()).observe(root);
    this.print.addEventListener("change", () => this.draw());
    for (const name of ["beforeprint", "afterprint"]) {
      window.addEventListener(name, () => {
        this.printing = name === "beforeprint";
        this.draw();
      });
    }
    document.addEventListener("pointerdown", (event) => {
      for (const menu of root.querySelectorAll("details.v-menu[open]")) {
        if (!menu.contains(/** @type {Node} */ (event.target))) menu.removeAttribute("open");
      }
    });
  }

  /** @param {string[]} changed names of what has changed */
  update(changed) {
    const { state } = this;
    if (changed.includes("panels")) {
      if (this.panels.length !== state.panels.length) this.panels = this.makePanels();
      else this.panels.forEach((panel) => panel.rebuildChoices());
      this.events.fill();
    }
    if (changed.includes("playing") && state.playing) this.begin();
    this.stage.classList.toggle("v-swipe", state.swipe);
    this.stage.dataset.panels = String(state.panels.length);
    if (changed.includes("theme")) {
      this.root.dataset.theme = state.theme;
      document.documentElement.dataset.theme = state.theme;
    }
    this.redraw();
  }

  /** Play from here, or from the beginning at the end. */
  begin() {
    const { state } = this;
    if (state.runs[0].live) {
      state.seek(state.timeline.frames - 1);
      return;
    }
    if (state.frame >= state.timeline.frames - 1) state.seek(0);
    let [time, before, frame] = [state.time, performance.now(), state.frame];
    const advance = (now) => {
      if (!state.playing) return;
      if (state.frame !== frame) time = state.time; // the slider was moved
      time += (Math.max(now - before, 0) / 1000) * state.speed; // the first may have begun before
      before = now;
      state.seekTime(time);
      frame = state.frame;
      if (frame >= state.timeline.frames - 1) state.set({ playing: false });
      else this.advancing = requestAnimationFrame(advance);
    };
    cancelAnimationFrame(this.advancing); // paused and played within one frame of the screen
    this.advancing = requestAnimationFrame(advance);
  }

  /**
   * Show a run that has got more frames.
   * @param {import("./live_run.js").LiveRun} run
   * @param {number} dropped how many of its first frames are gone
   */
  extend(run, dropped) {
    const { state } = this;
    const [before] = state.runs;
    const changed = before.header.views.length !== run.header.views.length;
    if (before.agents !== run.agents) this.colours = ""; // the legend follows the agents
    const happened = before.events.length !== run.events.length;
    const kept = state.frame - dropped;
    if (!state.playing && kept < 0) state.gone ??= state.time;
    state.runs[0] = run;
    state.frame = state.playing ? run.frames - 1 : Math.min(Math.max(kept, 0), run.frames - 1);
    if (changed && state.untouched) {
      const count = state.panels.length;
      state.panels = [];
      state.showPanels(count);
    } else if (changed) this.panels.forEach((panel) => panel.rebuildChoices());
    if (happened) this.events.fill();
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = 0;
      this.draw();
    });
  }

  /** The colours in use; light on paper. */
  palette() {
    const theme = this.printing || this.print.matches ? "light" : this.state.theme;
    return paletteOf(this.state.runs[0].header.colours, this.state.palette, theme);
  }

  /** Draw at once; `redraw` waits for the next frame of the screen. */
  draw() {
    const { state } = this;
    const followed = agentMarks(state.runs[0], state.frameOf(0)).find((agent) => agent.name === state.follow);
    if (followed) [this.viewport.x, this.viewport.y] = [followed.x, followed.y];
    const palette = this.palette();
    if (this.colours !== palette.name) this.legend.replaceChildren(...legendOf(palette, state.runs));
    this.colours = palette.name;
    for (const panel of this.panels) panel.draw(palette);
    if (state.swipe) this.swipe.handle.style.top = `${this.panels[0].stage.offsetTop}px`;
    this.charts.draw(palette);
    for (const panel of this.panels) panel.describe();
    this.controls.update();
    this.events.mark();
  }

  /** Show what matters in this frame. */
  fit() {
    const { state } = this;
    const run = state.runs[0];
    const marks = marksOf(run, state.frameOf(0), run.header.ego, "picture");
    const places = marks.boxes.filter((box) => box.outcome !== "false").map((box) => [box.x, box.y]);
    for (const { from, to } of marks.effects) places.push((to ?? from ?? []).slice(0, 2));
    if (!places.length) for (const row of run.boxesByFrame[state.frameOf(0)]) places.push([run.columns["box.x"][row], run.columns["box.y"][row]]);
    const ego = marks.agents.find((agent) => agent.name === run.header.ego);
    const { clientWidth, clientHeight } = this.panels[0].canvas;
    const agents = marks.agents.map((agent) => [agent.x, agent.y]);
    this.viewport.fit(agents, places, ego ? [ego.x, ego.y] : null, clientWidth / Math.max(clientHeight, 1));
    state.set({ follow: "", lens: wholeImage() });
    this.redraw();
  }

  /** @param {number} factor */
  zoom(factor) {
    const { clientWidth: width, clientHeight: height } = this.panels[0].canvas;
    this.panels[0].window.zoomAt(factor, width / 2, height / 2, width, height);
    this.redraw();
  }

  /** Show a place, if it is outside the window. */
  goTo(x, y) {
    const { clientWidth: width, clientHeight: height } = this.panels[0].canvas;
    const [px, py] = this.viewport.toScreen(x, y, width, height);
    if (px > 20 && py > 20 && px < width - 20 && py < height - 20) return;
    [this.viewport.x, this.viewport.y] = [x, y];
    this.state.set({ follow: "" });
    this.redraw();
  }
}
