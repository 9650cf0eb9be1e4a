// Colours of the panels and of the charts, which come with the data.

/**
 * @typedef {{name: string, outcomes: Record<string, string>, adversary: string, fault: string, states: Record<string, string>,
 *            agent: string, ground: string, building: string, building_edge: string, grid: string, faint: string,
 *            ink: string, path: string, sky: string, withheld: string, lines: string[], agents: string[]}} Palette
 */

/** Names of outcomes for the legend, in drawing order. */
export const OUTCOMES = ["unevaluated", "truth matched", "track matched", "truth missed", "track false"];

/**
 * The colours of a palette on a ground.
 * @param {Record<string, Record<string, any>>} colours of the data's header, by name and theme
 * @param {"paper" | "safe"} name
 * @param {"dark" | "light"} theme
 * @returns {Palette}
 */
export function paletteOf(colours, name, theme) {
  return { name: `${name} ${theme}`, ...colours[name][theme] };
}

/** @param {string} kind of a span or event @param {Palette} palette */
export function colourOfKind(kind, palette) {
  const named = { attack: palette.adversary, effect: palette.adversary, interception: palette.adversary };
  if (kind === "brake" || kind === "collision") return palette.outcomes["track false"];
  const judged = { suspension: palette.states.suspended, undecided: palette.states.undecided };
  return named[kind] ?? { fault: palette.fault, ...judged }[kind] ?? palette.faint;
}

/** @param {string} colour #rrggbb @param {number} alpha 0 to 1 */
export function faded(colour, alpha) {
  return colour + Math.round(alpha * 255).toString(16).padStart(2, "0");
}

/** @param {string} near #rrggbb @param {string} far @param {number} share of the second, 0 to 1 @returns {string} #rrggbb */
export function mixed(near, far, share) {
  const parts = (/** @type {string} */ colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  const [from, to] = [parts(near), parts(far)];
  return `#${from.map((value, i) => Math.round(value + (to[i] - value) * share).toString(16).padStart(2, "0")).join("")}`;
}
