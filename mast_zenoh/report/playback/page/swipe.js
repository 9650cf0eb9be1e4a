// Two panels on top of each other, with a divider: left of it one, right of it the other.

import { element } from "./elements.js";

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
