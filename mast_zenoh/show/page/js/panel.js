// One panel: the choice of run, agent and estimate, the canvas, and what is under the pointer.

import { drawBoxes, drawCentre, drawGround, drawIds, drawLinks, drawPoints, drawScale, drawSensors, drawTwins } from "./above.js";
import { drawCamera, hitSolid } from "./camera.js";
import { choice, element, resizeCanvas } from "./controls.js";
import { describe, hit, marksOf, tally } from "./marks.js";
import { faded } from "./palette.js";
import { cameraMarksOf } from "./perspective.js";
import { TRUTH } from "./run.js";
import { drawAgents, drawSpoofers, reserveSigns } from "./signs.js";
import { CameraWindow, screenBounds } from "./windows.js";

export class Panel {
  /**
   * @param {import("./state.js").State} state
   * @param {import("./windows.js").Viewport} viewport
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
    this.rebuildChoices();
  }

  get choice() {
    return this.state.panels[this.index];
  }

  get run() {
    return this.state.runs[this.choice.run];
  }

  /** What the panel shows, as data. @returns {import("./marks.js").Marks} `camera` in a camera view */
  marks() {
    const marks = marksOf(this.run, this.state.frameOf(this.choice.run), this.choice.agent, this.choice.estimate);
    if (this.choice.eye === "camera") marks.camera = cameraMarksOf(this.run, marks);
    return marks;
  }

  /** What dragging and zooming move. @returns {import("./windows.js").Viewport | CameraWindow} */
  get window() {
    const camera = this.choice.eye === "camera" && this.run.agents.find((agent) => agent.name === this.choice.agent)?.camera;
    return camera ? new CameraWindow(this.state.lens, camera) : this.viewport;
  }

  /** Make the lists of choices again, after a choice. */
  rebuildChoices() {
    const { run, agent, estimate, eye } = this.choice;
    const labels = { ...this.run.header.estimates, [TRUTH]: "truth: all objects" };
    const set = (name) => (value) => this.state.choose(this.index, { [name]: name === "run" ? Number(value) : value });
    /** @type {[string, string][]} */
    const runs = this.state.runs.map((each, i) => [String(i), each.header.name]);
    this.choices.replaceChildren(
      ...(runs.length > 1 ? [choice("run", runs, String(run), set("run"))] : []),
      choice("agent", this.run.agentNames.map((name) => [name, name]), agent, set("agent")),
      choice("estimate", this.run.estimatesOf(agent).map((name) => [name, wording(labels[name])]), estimate, set("estimate")),
      choice("seen from", this.run.agents.some((each) => each.name === agent) ? [["above", "from above"], ["camera", "camera"]] : [["above", "from above"]], eye ?? "above", set("eye")),
    );
  }

  /** @param {import("./palette.js").Palette} palette */
  draw(palette) {
    const { context, width, height } = resizeCanvas(this.canvas);
    if (!width || !height) return;
    const marks = this.marks();
    const { run, viewport } = this;
    const { layers } = this.state;
    this.shown = { marks, width, height };
    this.root.classList.toggle("v-camera", Boolean(marks.camera));
    this.chosen = this.chosen && (marks.boxes.find((box) => box.id === this.chosen?.id && box.kind === this.chosen?.kind) ?? null);
    if (marks.camera) {
      const canvas = { context, width, height, palette, layers, run, window: this.image };
      drawCamera(canvas, marks, marks.camera, this.chosen);
    } else {
      const canvas = { context, width, height, viewport, palette, layers, run };
      /** @type {number[][]} */ const taken = [];
      drawGround(canvas);
      if (layers.links) drawLinks(canvas, marks.links);
      drawSensors(canvas, marks.agents, marks.frame, this.choice.agent);
      if (layers.points && this.choice.agent === run.scanned) drawPoints(canvas, marks.frame);
      drawBoxes(canvas, marks, this.chosen, taken);
      reserveSigns(canvas, marks.agents, taken);
      drawTwins(canvas, marks.agents, taken);
      if (layers.links) drawCentre(canvas, marks.links, taken);
      drawAgents(canvas, marks.agents, taken);
      if (layers.manipulations) drawSpoofers(canvas, marks.frame, taken);
      if (layers.ids) drawIds(canvas, marks, taken);
      drawScale(canvas);
    }
    if (this.state.time > run.end) drawEnd({ context, width, palette }, run.end);
  }

  /** Say in words what is drawn: after all panels are drawn, because measuring after writing makes the page lay out again. */
  describe() {
    if (!this.shown) return;
    this.showCounts(this.shown.marks);
    this.showTip();
  }

  showCounts(marks) {
    const { agent, estimate } = this.choice;
    const counts = tally(marks);
    const rmse = this.run.series(agent, estimate, "rmse_m")?.[marks.frame] ?? -1;
    const parts = [`${counts.missed} missed`, `${counts.false} false`, `${counts.matched} matched`];
    if (rmse >= 0) parts.push(`RMSE ${rmse.toFixed(2)} m`);
    const drive = marks.agents.find((each) => each.name === agent)?.drive;
    if (drive && drive.speed >= 0) parts.push(`${agent} drives ${drive.speed.toFixed(1)} m/s, ${drive.acceleration.toFixed(1).replace("-", "−")} m/s²`);
    if (this.state.time > this.run.end) parts.unshift(`ended at ${this.run.end.toFixed(1)} s`);
    const text = estimate === TRUTH ? `${marks.boxes.length} objects` : parts.join(" · ");
    if (this.counts.textContent !== text) this.counts.textContent = text;
    this.canvas.setAttribute("aria-label", `${marks.camera ? "Camera" : "From above"} at t = ${marks.time_s.toFixed(1)} s, ${agent}, ${estimate}: ${text}`);
  }

  showTip() {
    const visible = this.chosen && !this.shown?.marks.camera?.own.includes(this.chosen.row);
    this.tip.hidden = !visible;
    if (!visible || !this.chosen || !this.shown) return;
    const { width, height } = this.shown;
    const [x, y] = this.placeOf(this.chosen);
    this.tip.replaceChildren(...describe(this.chosen).map((text, i) => element(i ? "div" : "strong", {}, text)));
    const left = x > width / 2 ? x - this.tip.offsetWidth - 14 : x + 14;
    const top = y > height / 2 ? y - this.tip.offsetHeight - 10 : y + 10;
    this.tip.style.left = `${Math.min(Math.max(left, 4), Math.max(width - this.tip.offsetWidth - 4, 4))}px`;
    this.tip.style.top = `${Math.min(Math.max(top, 4), Math.max(height - this.tip.offsetHeight - 4, 4))}px`;
  }

  /** The part of the camera's image that is shown. @returns {CameraWindow} */
  get image() {
    return /** @type {CameraWindow} */ (this.window);
  }

  /** Where a box is on the canvas. @returns {[number, number]} px */
  placeOf(box) {
    const { marks, width, height } = /** @type {any} */ (this.shown);
    if (!marks.camera) return this.viewport.toScreen(box.x, box.y, width, height);
    const solid = marks.camera.boxes.find((each) => each.row === box.row);
    const [left, top, right, bottom] = screenBounds(this.image, solid?.bounds ?? [0, 0, 0, 0], width, height);
    return [(Math.max(left, 0) + Math.min(right, width)) / 2, (Math.max(top, 0) + Math.min(bottom, height)) / 2];
  }

  /** The box at a pixel. @returns {import("./marks.js").BoxMark | null} */
  boxAt(x, y) {
    const { marks, width, height } = this.shown ?? {};
    if (!marks) return null;
    return marks.camera ? (hitSolid(marks.camera, this.image, x, y, width, height)?.box ?? null) : hit(marks, this.viewport, x, y, width, height);
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
      const panel = covered && this.beside ? this.beside : this;
      for (const each of [this, this.beside]) if (each && each !== panel) each.chosen = null;
      panel.chosen = panel.boxAt(x, y);
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
        if (ratio > 0) this.window.zoomAt(ratio, other.x, other.y, width, height);
      } else if (now.x !== before.x || now.y !== before.y) {
        this.window.pan(now.x - before.x, now.y - before.y, width, height);
        if (this.window === this.viewport) this.state.set({ follow: "" });
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
        // In a report the wheel scrolls the page, unless the canvas has the focus.
        if (!event.ctrlKey && !document.body.classList.contains("v-alone") && document.activeElement !== canvas) return;
        event.preventDefault();
        const { x, y } = place(event);
        this.window.zoomAt(Math.exp(-event.deltaY * 0.0015), x, y, canvas.clientWidth, canvas.clientHeight);
        changed();
      },
      { passive: false },
    );
  }
}

/** Say that a run is over, while another goes on. */
function drawEnd({ context, width, palette }, end) {
  const text = `ended at ${end.toFixed(1)} s`;
  context.font = "600 14px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  const wide = context.measureText(text).width + 24;
  context.fillStyle = faded(palette.ground, 0.88);
  context.fillRect((width - wide) / 2, 8, wide, 26);
  context.strokeStyle = palette.faint;
  context.lineWidth = 1;
  context.strokeRect((width - wide) / 2, 8, wide, 26);
  context.fillStyle = palette.ink;
  context.fillText(text, width / 2, 22);
  context.textAlign = "left";
}

/** @param {string} label of an estimate in the tables, which speak of the ego */
function wording(label) {
  const words = { "ego alone": "own tracks", "alone, as received": "own tracks, as received" };
  return words[label] ?? label.replace("ego with picture", "mission: own and picture");
}
