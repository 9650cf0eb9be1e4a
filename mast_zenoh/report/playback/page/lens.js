// An agent's camera in one frame: from places in the world to pixels of its image, without anything behind it.

import { clipPolygon, clipSegment } from "./clipping.js";

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
