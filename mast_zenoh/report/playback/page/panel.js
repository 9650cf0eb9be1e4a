// One panel: the choice of run, agent and estimate, the picture, and what is under the pointer.

import { drawBoxes } from "./boxes.js";
import { choice, element, fitted } from "./elements.js";
import { describe, hit } from "./hover.js";
import { marksOf, tally } from "./marks.js";
import { drawAgents, drawGround, drawScale, drawSensors } from "./scene.js";
import { TRUTH } from "./run.js";

export class Panel {
  /**
   * @param {import("./state.js").State} state
   * @param {import("./viewport.js").Viewport} viewport
   * @param {number} index
   */
  constructor(state, viewport, index) {
    this.state = state;
    this.viewport = viewport;
    this.index = index;
    /** @type {Panel | null} the panel that covers this one to the right of the divider */ this.beside = null;
    /** @type {import("./marks.js").BoxMark | null} */ this.chosen = null;
    this.choices = element("div", { class: "v-choices" });
    this.counts = element("p", { class: "v-counts" });
    this.canvas = element("canvas", { class: "v-canvas", role: "img", tabindex: 0 });
    this.tip = element("div", { class: "v-tip", hidden: true });
    this.stage = element("div", { class: "v-stage" }, this.canvas, this.tip);
    const head = element("div", { class: "v-head" }, this.choices, this.counts);
    this.root = element("div", { class: "v-panel" }, head, this.stage);
    this.listen();
    this.chooseAgain();
  }

  get choice() {
    return this.state.panels[this.index];
  }

  get run() {
    return this.state.runs[this.choice.run];
  }

  /** What the panel shows, as data. */
  marks() {
    return marksOf(this.run, this.state.frameOf(this.choice.run), this.choice.agent, this.choice.estimate);
  }

  /** Make the lists of choices again, after a choice. */
  chooseAgain() {
    const { run, agent, estimate } = this.choice;
    const labels = { ...this.run.header.estimates, [TRUTH]: "truth: all objects" };
    const set = (name) => (value) => this.state.choose(this.index, { [name]: name === "run" ? Number(value) : value });
    /** @type {[string, string][]} */
    const runs = this.state.runs.map((each, i) => [String(i), each.header.name]);
    this.choices.replaceChildren(
      ...(runs.length > 1 ? [choice("run", runs, String(run), set("run"))] : []),
      choice("agent", this.run.agentNames.map((name) => [name, name]), agent, set("agent")),
      choice("estimate", this.run.estimatesOf(agent).map((name) => [name, wording(labels[name])]), estimate, set("estimate")),
    );
  }

  /** @param {import("./palette.js").Palette} palette */
  draw(palette) {
    const { context, width, height } = fitted(this.canvas);
    if (!width || !height) return;
    const marks = this.marks();
    const { run, viewport } = this;
    const canvas = { context, width, height, viewport, palette, layers: this.state.layers, run };
    this.shown = { marks, width, height };
    this.chosen = this.chosen && (marks.boxes.find((box) => box.id === this.chosen?.id && box.kind === this.chosen?.kind) ?? null);
    context.textAlign = "left";
    drawGround(canvas);
    drawSensors(canvas, marks.agents, marks.frame, this.choice.agent);
    drawBoxes(canvas, marks, this.chosen);
    drawAgents(canvas, marks.agents);
    drawScale(canvas);
    this.showCounts(marks);
    this.showTip();
  }

  showCounts(marks) {
    const { agent, estimate } = this.choice;
    const counts = tally(marks);
    const rmse = this.run.series(agent, estimate, "rmse_m")?.[marks.frame] ?? -1;
    const parts = [`${counts.missed} missed`, `${counts.false} false`, `${counts.matched} matched`];
    if (rmse >= 0) parts.push(`RMSE ${rmse.toFixed(2)} m`);
    if (this.state.time > this.run.end) parts.unshift(`ended at ${this.run.end.toFixed(1)} s`);
    const text = estimate === TRUTH ? `${marks.boxes.length} objects` : parts.join(" · ");
    if (this.counts.textContent !== text) this.counts.textContent = text;
    this.canvas.setAttribute("aria-label", `From above at t = ${marks.time_s.toFixed(1)} s, ${agent}, ${estimate}: ${text}`);
  }

  showTip() {
    this.tip.hidden = !this.chosen;
    if (!this.chosen || !this.shown) return;
    const { width, height } = this.shown;
    const [x, y] = this.viewport.toScreen(this.chosen.x, this.chosen.y, width, height);
    this.tip.replaceChildren(...describe(this.chosen).map((text, i) => element(i ? "div" : "strong", {}, text)));
    const left = x > width / 2 ? x - this.tip.offsetWidth - 14 : x + 14;
    const top = y > height / 2 ? y - this.tip.offsetHeight - 10 : y + 10;
    this.tip.style.left = `${Math.min(Math.max(left, 4), Math.max(width - this.tip.offsetWidth - 4, 4))}px`;
    this.tip.style.top = `${Math.min(Math.max(top, 4), Math.max(height - this.tip.offsetHeight - 4, 4))}px`;
  }

  listen() {
    const canvas = this.canvas;
    /** @type {Map<number, {x: number, y: number}>} */ const pointers = new Map();
    const changed = () => this.state.dispatchEvent(new CustomEvent("change", { detail: ["viewport"] }));
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return { x: event.clientX - box.left, y: event.clientY - box.top };
    };
    const choose = (event) => {
      const { x, y } = place(event);
      const covered = this.beside && this.state.swipe && x > this.state.share * canvas.clientWidth;
      const panel = covered ? this.beside : this;
      for (const each of [this, this.beside]) if (each && each !== panel) each.chosen = null;
      const { marks, width, height } = panel.shown ?? {};
      panel.chosen = marks ? hit(marks, this.viewport, x, y, width, height) : null;
      changed();
    };
    canvas.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, place(event));
      canvas.setPointerCapture(event.pointerId);
      choose(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return choose(event);
      const now = place(event);
      const { clientWidth: width, clientHeight: height } = canvas;
      const other = [...pointers.entries()].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const ratio = Math.hypot(now.x - other.x, now.y - other.y) / Math.hypot(before.x - other.x, before.y - other.y);
        if (ratio > 0) this.viewport.zoomAt(ratio, other.x, other.y, width, height);
      } else if (now.x !== before.x || now.y !== before.y) {
        this.viewport.pan(now.x - before.x, now.y - before.y, width, height);
        this.state.set({ follow: "" });
      }
      pointers.set(event.pointerId, now);
      changed();
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType !== "mouse") return;
      this.chosen = null;
      if (this.beside) this.beside.chosen = null;
      changed();
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        // In a report the wheel scrolls the page, unless the picture has the focus.
        if (!event.ctrlKey && !document.body.classList.contains("v-alone") && document.activeElement !== canvas) return;
        event.preventDefault();
        const { x, y } = place(event);
        this.viewport.zoomAt(Math.exp(-event.deltaY * 0.0015), x, y, canvas.clientWidth, canvas.clientHeight);
        changed();
      },
      { passive: false },
    );
  }
}

/** @param {string} label of an estimate in the tables, which speak of the ego */
function wording(label) {
  const words = { "ego alone": "own tracks", "alone, as received": "own tracks, as received" };
  return words[label] ?? label.replace("ego with picture", "mission: own and picture");
}
