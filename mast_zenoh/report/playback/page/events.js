// The list of events: a click goes to the frame and the place.

import { element } from "./elements.js";

export class EventList {
  /**
   * @param {import("./state.js").State} state
   * @param {(x: number, y: number) => void} goTo shows a place
   */
  constructor(state, goTo) {
    this.state = state;
    this.goTo = goTo;
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
    /** How many are marked as past. */
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
          if (event.x !== undefined) this.goTo(event.x, event.y);
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
