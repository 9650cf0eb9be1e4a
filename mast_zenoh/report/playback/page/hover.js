// Which box is under the pointer, and what is said about it.

/** px: a box is found this near to its centre, however small it is drawn. */
const NEAR = 9;

/**
 * The box at a pixel; errors before matches, tracks before the truth that they match.
 * @param {import("./marks.js").Marks} marks
 * @param {import("./viewport.js").Viewport} viewport
 * @returns {import("./marks.js").BoxMark | null}
 */
export function hit(marks, viewport, px, py, width, height) {
  const [x, y] = viewport.toWorld(px, py, width, height);
  const near = NEAR / viewport.scale(width, height);
  let best = null;
  let least = Infinity;
  for (const box of marks.boxes) {
    const [dx, dy] = [x - box.x, y - box.y];
    const along = Math.abs(dx * Math.cos(box.yaw) + dy * Math.sin(box.yaw));
    const across = Math.abs(-dx * Math.sin(box.yaw) + dy * Math.cos(box.yaw));
    const distance = Math.hypot(dx, dy);
    if (distance > near && (along > box.l / 2 + 0.3 || across > box.w / 2 + 0.3)) continue;
    const rank = distance - (box.outcome === "matched" ? 0 : 2) - (box.kind === "track" ? 1 : 0);
    if (rank < least) [best, least] = [box, rank];
  }
  return best;
}

const CAUSES = {
  inserted: "follows an object inserted",
  moved: "its object was moved",
  removed: "its object was removed",
  altered: "its object was altered",
  withheld: "withheld by the command centre",
};

/**
 * Lines about a box.
 * @param {import("./marks.js").BoxMark} box
 * @returns {string[]} the first is its heading
 */
export function describe(box) {
  const outcomes = {
    "truth matched": "object, matched", "truth missed": "object, missed", "track matched": "track, matched",
    "track false": "false track", "truth scene": "object",
  };
  const what = outcomes[`${box.kind} ${box.outcome}`] ?? `${box.kind === "truth" ? "object" : "track"}, not evaluated`;
  const lines = [`${what} · id ${box.id}`];
  const size = `${box.l.toFixed(1)} × ${box.w.toFixed(1)} × ${box.h.toFixed(1)} m`;
  lines.push(box.class === "unknown" ? size : `${box.class}, ${size}`);
  if (box.known) lines.push(`speed ${Math.hypot(box.vx, box.vy).toFixed(1)} m/s`);
  if (box.kind === "track") lines.push(`score ${box.score.toFixed(2)}`);
  if (box.error !== null) lines.push(`error ${box.error.toFixed(2)} m from object ${box.match}`);
  if (box.sx) lines.push(`claims σ ${box.sx.toFixed(2)} m, ${box.sy.toFixed(2)} m`);
  const by = box.cause === "withheld" ? ", reported by" : " by";
  if (box.cause) lines.push(`cause: ${CAUSES[box.cause] ?? box.cause}${box.by ? `${by} ${box.by.replaceAll("+", ", ")}` : ""}`);
  return lines;
}
