// What the signs in the panels mean, with the colours in use.

import { element } from "./elements.js";
import { faded, OUTCOMES } from "./palette.js";

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
  const spans = runs.flatMap((run) => run.spans);
  if (runs.some((run) => run.agents.length)) signs.push(key("link to the command centre", `<path d="M1 7H21" stroke="${palette.faint}" stroke-width="1.4"/>`));
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
