// Cuts polygons and lines at a plane. Pure functions on points of any number of dimensions.

/**
 * @typedef {number[]} Point
 * @typedef {(point: Point) => number} Side positive on the side that is kept, affine in the point
 */

/**
 * The part of a polygon on one side of a plane (Sutherland and Hodgman, CACM 1974).
 * @param {Point[]} points
 * @param {Side} side
 * @returns {Point[]} the polygon itself if nothing is cut off; empty: all is
 */
export function clipPolygon(points, side) {
  const sides = points.map(side);
  if (sides.every((each) => each >= 0)) return points;
  /** @type {Point[]} */ const kept = [];
  for (let i = 0; i < points.length; i++) {
    const next = (i + 1) % points.length;
    if (sides[i] >= 0) kept.push(points[i]);
    if (sides[i] >= 0 !== sides[next] >= 0) kept.push(crossing(points[i], points[next], sides[i], sides[next]));
  }
  return kept;
}

/**
 * The part of a line on one side of a plane.
 * @param {Point} from
 * @param {Point} to
 * @param {Side} side
 * @returns {[Point, Point] | null} null: nothing remains
 */
export function clipSegment(from, to, side) {
  const [a, b] = [side(from), side(to)];
  if (a < 0 && b < 0) return null;
  if (a >= 0 && b >= 0) return [from, to];
  const cut = crossing(from, to, a, b);
  return a >= 0 ? [from, cut] : [cut, to];
}

/** Where a line meets the plane. @returns {Point} */
function crossing(from, to, a, b) {
  const share = a / (a - b); // a and b have different signs
  return from.map((value, axis) => value + share * (to[axis] - value));
}
