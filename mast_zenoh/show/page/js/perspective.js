// What an agent's camera shows in a frame, as pixels of its image: plain data, which tests compare with the recording.

import { boundsOf } from "./signs.js";

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

/** m: nothing nearer to the camera than this is drawn. */
export const NEAR_M = 0.5;

const beyondNear = (/** @type {number[]} */ point) => point[0] - NEAR_M;

export class Lens {
  /**
   * @param {{position: number[], rotation: number[], width: number, height: number, focal: number}} camera mount in the
   *   agent's frame: m, and a rotation by rows; px
   * @param {number[]} at m, of the agent
   * @param {number[]} turn rad: yaw, pitch and roll of the agent
   */
  constructor(camera, at, turn) {
    this.width = camera.width;
    this.height = camera.height;
    this.focal = camera.focal;
    const body = rotationOf(turn);
    const mounted = camera.position.map((_, axis) => dot(body[axis], camera.position));
    this.eye = at.map((value, axis) => value + mounted[axis]);
    const mount = [0, 1, 2].map((row) => camera.rotation.slice(3 * row, 3 * row + 3));
    /** Columns: ahead, left and up of the camera in the world. */
    this.axes = [0, 1, 2].map((column) => body.map((row) => dot(row, mount.map((each) => each[column]))));
  }

  /**
   * The camera of an agent.
   * @param {import("./run.js").Run} run
   * @param {number} agent row of `agents`
   * @param {number} frame
   */
  static of(run, agent, frame) {
    const values = (/** @type {string[]} */ names) => names.map((name) => run.ofAgent(name, agent, frame));
    return new Lens(run.agents[agent].camera, values(["x", "y", "z"]), values(["yaw", "pitch", "roll"]));
  }

  /** @param {number[]} place m, in the world @returns {number[]} m ahead, left and up of the camera */
  local(place) {
    const away = [place[0] - this.eye[0], place[1] - this.eye[1], place[2] - this.eye[2]];
    const [ahead, left, up] = this.axes;
    return [dot(ahead, away), dot(left, away), dot(up, away)];
  }

  /** @param {number[]} local m, beyond the near plane @returns {[number, number]} px */
  pixel(local) {
    const scale = this.focal / local[0];
    return [this.width / 2 - scale * local[1], this.height / 2 - scale * local[2]];
  }

  /** @param {number[]} place @returns {[number, number] | null} px; null: behind the near plane */
  point(place) {
    const local = this.local(place);
    return local[0] < NEAR_M ? null : this.pixel(local);
  }

  /** @param {number[][]} places corners @returns {[number, number][]} px of the part beyond the near plane */
  polygon(places) {
    const locals = places.map((place) => this.local(place));
    if (locals.every((local) => local[0] < NEAR_M)) return [];
    return clipPolygon(locals, beyondNear).map((local) => this.pixel(local));
  }

  /** @param {number[]} from @param {number[]} to @returns {[number, number][] | null} px */
  segment(from, to) {
    return clipSegment(this.local(from), this.local(to), beyondNear)?.map((local) => this.pixel(local)) ?? null;
  }

  /**
   * The part of a polygon of the image that lies below the horizon.
   * @param {[number, number][]} polygon px
   * @returns {[number, number][]}
   */
  belowHorizon(polygon) {
    const [ahead, left, up] = this.axes.map((axis) => axis[2]);
    const rise = (/** @type {number[]} */ [u, v]) => ahead * this.focal - left * (u - this.width / 2) - up * (v - this.height / 2);
    return /** @type {[number, number][]} */ (clipPolygon(polygon, (pixel) => -rise(pixel)));
  }
}

/** @param {number[]} turn rad: yaw, pitch, roll @returns {number[][]} active rotation, by rows */
function rotationOf([yaw, pitch, roll]) {
  const [cy, sy, cp, sp, cr, sr] = [yaw, pitch, roll].flatMap((angle) => [Math.cos(angle), Math.sin(angle)]);
  return [
    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
    [-sp, cp * sr, cp * cr],
  ];
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/**
 * @typedef {[number, number][]} Pixels
 * @typedef {{side: string, towards: boolean, polygon: Pixels}} Face
 * @typedef {{box: import("./marks.js").BoxMark, row: number, kind: string, outcome: string, id: number, distance: number,
 *            behind: boolean, faces: Face[], bounds: number[]}} Solid
 * @typedef {{distance: number, polygon: Pixels}} Wall
 * @typedef {{mark: import("./marks.js").AgentMark, name: string, at: [number, number], foot: Pixels | null}} AgentSign
 * @typedef {{mark: import("./marks.js").EffectMark, effect: string, from: [number, number] | null,
 *            to: [number, number] | null, line: Pixels | null, size: number}} EffectSign
 * @typedef {{agent: string, width: number, height: number, lens: Lens, ground_m: number, boxes: Solid[], own: number[],
 *            walls: Wall[], agents: AgentSign[], effects: EffectSign[], withheld: Face[][]}} CameraMarks
 */

/**
 * Faces of a box by the signs of their corners along its length, width and height; the last two: axis and sign.
 * @type {[string, number[][], number, number][]}
 */
const FACES = [
  ["front", [[1, 1, -1], [1, -1, -1], [1, -1, 1], [1, 1, 1]], 0, 1],
  ["back", [[-1, 1, -1], [-1, -1, -1], [-1, -1, 1], [-1, 1, 1]], 0, -1],
  ["left", [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]], 1, 1],
  ["right", [[1, -1, -1], [-1, -1, -1], [-1, -1, 1], [1, -1, 1]], 1, -1],
  ["top", [[1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1]], 2, 1],
  ["bottom", [[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]], 2, -1],
];
/** m: buildings beyond are not drawn. */
const FARTHEST_WALL_M = 250;
/** m: height of an inserted object's sign. */
const SIGN_M = 2.6;
/** m above a vehicle's place: its sign, so that it does not hide the vehicle. */
const OVER_VEHICLE_M = 2.8;

/**
 * Project the marks of a panel through an agent's camera.
 * @param {import("./run.js").Run} run
 * @param {import("./marks.js").Marks} marks
 * @returns {CameraMarks | null} null: the agent has no camera in the scene
 */
export function cameraMarksOf(run, marks) {
  const index = run.agents.findIndex((agent) => agent.name === marks.agent);
  if (index < 0) return null;
  const lens = Lens.of(run, index, marks.frame);
  const own = run.agents[index].object;
  const ground = groundLevel(run, marks.frame, lens);
  const isOwn = (box) => own >= 0 && (box.kind === "truth" ? box.id === own : box.match === own || isAround(box, lens.eye));
  const [left, hidden] = [marks.boxes.filter((box) => !isOwn(box)), marks.boxes.filter(isOwn)];
  const solids = left.map((box) => solidOf(lens, box, run)).filter((solid) => solid.faces.length);
  solids.sort((a, b) => b.distance - a.distance);
  return {
    agent: marks.agent,
    width: lens.width,
    height: lens.height,
    lens,
    ground_m: ground,
    boxes: solids,
    own: hidden.map((box) => box.row),
    walls: wallsOf(run, lens, ground),
    agents: marks.agents.filter((agent) => agent.index !== index).flatMap((agent) => agentSign(run, marks.frame, lens, agent, ground)),
    effects: marks.effects.map((effect) => effectSign(lens, effect)),
    withheld: marks.withheld.map((box) => facesOf(lens, box)),
  };
}

/** Whether a track that is not evaluated stands where the camera is: the vehicle that carries it. */
function isAround(box, eye) {
  const [dx, dy] = [eye[0] - box.x, eye[1] - box.y];
  const along = Math.abs(dx * Math.cos(box.yaw) + dy * Math.sin(box.yaw));
  const across = Math.abs(dy * Math.cos(box.yaw) - dx * Math.sin(box.yaw));
  return box.outcome === "unevaluated" && along < box.l / 2 && across < box.w / 2;
}

/** @returns {Solid} */
function solidOf(lens, box, run) {
  const faces = facesOf(lens, box);
  const { row, kind, outcome, id } = box;
  const distance = Math.hypot(box.x - lens.eye[0], box.y - lens.eye[1], box.z - lens.eye[2]);
  const behind = faces.length > 0 && isHidden(run, lens.eye, [box.x, box.y, box.z]);
  return { box, row, kind, outcome, id, distance, behind, faces, bounds: boundsOf(faces.flatMap((face) => face.polygon)) };
}

/**
 * The faces of a box that reach beyond the near plane.
 * @param {Lens} lens
 * @param {{x: number, y: number, z: number, l: number, w: number, h: number, yaw: number}} box
 * @returns {Face[]}
 */
function facesOf(lens, box) {
  const [cos, sin] = [Math.cos(box.yaw), Math.sin(box.yaw)];
  const half = [box.l / 2, box.w / 2, box.h / 2];
  const away = [lens.eye[0] - box.x, lens.eye[1] - box.y, lens.eye[2] - box.z];
  const eye = [away[0] * cos + away[1] * sin, away[1] * cos - away[0] * sin, away[2]];
  const faces = FACES.map(([side, corners, axis, sign]) => ({
    side,
    towards: eye[axis] * sign > half[axis],
    polygon: lens.polygon(corners.map((signs) => cornerOf(box, half, cos, sin, signs))),
  }));
  return faces.filter((face) => face.polygon.length > 2);
}

/** @returns {number[]} m */
function cornerOf(box, half, cos, sin, signs) {
  const [a, b] = [signs[0] * half[0], signs[1] * half[1]];
  return [box.x + a * cos - b * sin, box.y + a * sin + b * cos, box.z + signs[2] * half[2]];
}

/** The height of the ground: under the objects nearest to the camera. */
function groundLevel(run, frame, lens) {
  const { "box.x": x, "box.y": y, "box.z": z, "box.h": h, "box.truth": truth } = run.columns;
  const bottoms = [...run.boxesByFrame[frame]]
    .filter((row) => truth[row])
    .map((row) => [Math.hypot(x[row] - lens.eye[0], y[row] - lens.eye[1]), z[row] - h[row] / 2])
    .sort((a, b) => a[0] - b[0])
    .slice(0, 5)
    .map((each) => each[1])
    .sort((a, b) => a - b);
  return bottoms.length ? bottoms[bottoms.length >> 1] : 0;
}

/** Whether a building stands between two places. @param {number[]} eye @param {number[]} place */
function isHidden(run, eye, place) {
  return run.header.buildings.some((outline, index) => {
    const top = run.header.tops[index];
    return outline.some((from, corner) => {
      const share = shareOfCrossing(eye, place, from, after(outline, corner));
      return share !== null && eye[2] + share * (place[2] - eye[2]) < top;
    });
  });
}

/** @returns {number | null} how far along the first line it crosses the second, 0 to 1 */
function shareOfCrossing(a, b, c, d) {
  const [rx, ry, sx, sy] = [b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]];
  const area = rx * sy - ry * sx;
  if (!area) return null;
  const along = ((c[0] - a[0]) * sy - (c[1] - a[1]) * sx) / area;
  const across = ((c[0] - a[0]) * ry - (c[1] - a[1]) * rx) / area;
  return along > 0 && along < 1 && across >= 0 && across <= 1 ? along : null;
}

/** The sides of buildings that face the camera, and their roofs, the farthest first. @returns {Wall[]} */
function wallsOf(run, lens, ground) {
  /** @type {Wall[]} */ const walls = [];
  run.header.buildings.forEach((outline, index) => {
    const top = run.header.tops[index];
    const centre = [0, 1].map((axis) => outline.reduce((sum, each) => sum + each[axis], 0) / outline.length);
    const distance = Math.hypot(centre[0] - lens.eye[0], centre[1] - lens.eye[1]);
    const sides = outline.map((from, corner) => {
      const to = after(outline, corner);
      return [[from[0], from[1], ground], [to[0], to[1], ground], [to[0], to[1], top], [from[0], from[1], top]];
    });
    const nearest = Math.min(...outline.map((each) => Math.hypot(each[0] - lens.eye[0], each[1] - lens.eye[1])));
    if (nearest > FARTHEST_WALL_M) return;
    const turn = Math.sign(outline.reduce((sum, [x, y], i) => sum + x * after(outline, i)[1] - after(outline, i)[0] * y, 0));
    for (const corners of sides) {
      const [[ax, ay], [bx, by]] = corners;
      const outside = turn * ((bx - ax) * (lens.eye[1] - ay) - (by - ay) * (lens.eye[0] - ax)) < 0;
      if (outside) add(lens.polygon(corners));
    }
    if (lens.eye[2] > top) add(lens.polygon(outline.map(([x, y]) => [x, y, top])));
    function add(polygon) {
      if (polygon.length > 2) walls.push({ distance, polygon });
    }
  });
  return walls.sort((a, b) => b.distance - a.distance);
}

function after(list, index) {
  return list[(index + 1) % list.length];
}

/** @returns {AgentSign[]} none if it is behind the camera */
function agentSign(run, frame, lens, mark, ground) {
  const z = run.ofAgent("z", mark.index, frame);
  const place = [mark.x, mark.y, mark.kind === "static" ? z : z + OVER_VEHICLE_M];
  const at = lens.point(place);
  const foot = [mark.x, mark.y, mark.kind === "static" ? ground : z + 1.6];
  return at ? [{ mark, name: mark.name, at, foot: lens.segment(place, foot) }] : [];
}

/** @returns {EffectSign} */
function effectSign(lens, mark) {
  const [from, to] = [mark.from && lens.point(mark.from), mark.to && lens.point(mark.to)];
  const line = mark.from && mark.to ? lens.segment(mark.from, mark.to) : null;
  const depth = lens.local(mark.to ?? mark.from)[0];
  return { mark, effect: mark.effect, from, to, line, size: (SIGN_M * lens.focal) / Math.max(depth, 1) };
}
