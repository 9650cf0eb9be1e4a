// Colours of the panels and of the charts: the paper's key or a colour-blind-safe one, on dark or light ground.

/**
 * @typedef {{name: string, outcomes: Record<string, string>, adversary: string, fault: string, states: Record<string, string>,
 *            agent: string, ground: string, building: string, buildingEdge: string, grid: string, faint: string,
 *            ink: string, path: string, sky: string, withheld: string, lines: string[], agents: string[]}} Palette
 */

/** Names of outcomes for the legend, in drawing order. */
export const OUTCOMES = ["unevaluated", "truth matched", "track matched", "truth missed", "track false"];

const GROUNDS = {
  dark: {
    ground: "#10141b", building: "#2a313d", buildingEdge: "#465062", grid: "#1d242e", faint: "#9aa7b8",
    ink: "#e8edf4", path: "#1b222c", sky: "#1a2230", withheld: "#c9d2de",
    lines: ["#6db3ff", "#ffb000", "#5fd3a5"], agents: ["#c9d2de", "#8fd3c8", "#c8b0ff", "#d9c48f", "#8f9db3"],
  },
  light: {
    ground: "#fbfcfd", building: "#dfe3ea", buildingEdge: "#b4bcc9", grid: "#e9edf2", faint: "#566070",
    ink: "#1b1f24", path: "#eef1f5", sky: "#e3ebf5", withheld: "#566070",
    lines: ["#0072b2", "#c05a00", "#00795a"], agents: ["#3d4654", "#1f7a70", "#6a4fc0", "#7d6420", "#8a94a6"],
  },
};

/** What each palette changes, by theme; the paper's colours on dark ground come from the data. */
const KEYS = {
  paper: {
    dark: { fault: "#d9a441", agent: "#7fe3ff" },
    light: {
      outcomes: {
        "unevaluated": "#128a37", "truth matched": "#1b1f24", "track matched": "#1766e0",
        "truth missed": "#bd8b00", "track false": "#d31818",
      },
      adversary: "#b5128f", fault: "#8a6100", agent: "#00728f",
      states: { unknown: "#6b7280", trusted: "#00728f", faulty: "#a86400", suspended: "#c8401c" },
    },
  },
  safe: {
    dark: {
      outcomes: {
        "unevaluated": "#00b386", "truth matched": "#ffffff", "track matched": "#56b4e9",
        "truth missed": "#f0e442", "track false": "#ff7a1a",
      },
      adversary: "#e79ac6", fault: "#d9a441", agent: "#b9e2f7",
      states: { unknown: "#9aa7b8", trusted: "#b9e2f7", faulty: "#f0e442", suspended: "#ff7a1a" },
    },
    light: {
      outcomes: {
        "unevaluated": "#00795a", "truth matched": "#1b1f24", "track matched": "#0072b2",
        "truth missed": "#b88700", "track false": "#d55e00",
      },
      adversary: "#a3497d", fault: "#7a5c00", agent: "#0072b2",
      states: { unknown: "#6b7280", trusted: "#0072b2", faulty: "#b88700", suspended: "#d55e00" },
    },
  },
};

/**
 * The colours of a palette on a ground.
 * @param {any} colours of the data's header: outcomes, adversary, states
 * @param {"paper" | "safe"} name
 * @param {"dark" | "light"} theme
 * @returns {Palette}
 */
export function paletteOf(colours, name, theme) {
  return { name: `${name} ${theme}`, ...GROUNDS[theme], ...colours, ...KEYS[name][theme] };
}

/** @param {string} kind of a span or event @param {Palette} palette */
export function colourOfKind(kind, palette) {
  const named = { attack: palette.adversary, effect: palette.adversary, interception: palette.adversary };
  return named[kind] ?? { fault: palette.fault, suspension: palette.states.suspended }[kind] ?? palette.faint;
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
