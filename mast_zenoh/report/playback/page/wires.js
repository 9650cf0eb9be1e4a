// The wires of a running run: the nodes on them, their rates, lags and losses.

import { element } from "./elements.js";

/** @typedef {{key: string, legs: any[], to: string[]}} Wire */

export class WireTable {
  constructor() {
    this.rows = element("tbody");
    const head = ["wire", "from, through, to", "messages/s", "frames behind", "lost"].map((text) => element("th", { scope: "col" }, text));
    const table = element("table", {}, element("thead", {}, element("tr", {}, ...head)), this.rows);
    this.summary = element("summary", {}, "Wires");
    this.root = element("details", { class: "v-wires" }, this.summary, element("div", { class: "v-scroll" }, table));
    this.root.addEventListener("toggle", () => this.fill());
    this.intercepted = -1;
    /** @type {Wire[]} */ this.wires = [];
  }

  /** Show wires; opens the table if more of them have inserted nodes than before. @param {Wire[]} wires */
  show(wires) {
    const intercepted = wires.filter((wire) => wire.legs.length > 1).length;
    if (intercepted > this.intercepted && intercepted) this.root.setAttribute("open", "");
    this.intercepted = intercepted;
    const several = intercepted === 1 ? "one" : String(intercepted);
    this.summary.textContent = `Wires: ${wires.length} shown, nodes inserted into ${intercepted ? several : "none"}`;
    this.wires = wires;
    this.fill();
  }

  /** Write the rows, if they can be seen. */
  fill() {
    if (this.root.hasAttribute("open")) this.rows.replaceChildren(...this.wires.map((wire) => rowOf(wire)));
  }
}

/** @param {Wire} wire */
function rowOf({ key, legs, to }) {
  const nodes = legs.map((leg, index) => {
    const kind = index && leg.role !== "link" ? "v-inserted" : index ? "v-link" : "";
    return element("span", { class: kind }, leg.node);
  });
  const ends = element("span", {}, to.length > 2 ? `${to.length} nodes` : to.join(", ") || "observers");
  const path = [...nodes, ends].flatMap((node, index) => (index ? [" → ", node] : [node]));
  const each = (/** @type {(leg: any) => string} */ text) => legs.map(text).join(" → ");
  const rates = each((leg) => (leg.rate_hz === null ? "–" : leg.rate_hz.toFixed(1)));
  const lags = each((leg) => (leg.lag === null ? "–" : String(leg.lag)));
  const lost = legs.length > 1 ? legs.slice(1).map((leg) => (leg.lost === null ? "–" : `${Math.round(leg.lost * 100)} %`)).join(", ") : "";
  const cells = [element("td", {}, key), element("td", {}, ...path), ...[rates, lags, lost].map((text) => element("td", {}, text))];
  return element("tr", { class: legs.length > 1 ? "v-intercepted" : "" }, ...cells);
}
