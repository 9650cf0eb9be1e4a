// Projection, clipping, windows and labels of the page.

import assert from "node:assert/strict";
import { test } from "node:test";

import { colourOfKind, faded, mixed } from "../../../mast_zenoh/show/page/js/palette.js";
import { clipPolygon, clipSegment, Lens, NEAR_M } from "../../../mast_zenoh/show/page/js/perspective.js";
import { expand, groupByFrame } from "../../../mast_zenoh/show/page/js/run.js";
import { around, reserveSigns, troubleOf, writeLabel } from "../../../mast_zenoh/show/page/js/signs.js";
import { CameraWindow, Viewport, wholeImage } from "../../../mast_zenoh/show/page/js/windows.js";

const beyond = (axis, limit) => (point) => point[axis] - limit;

test("polygons are cut at a plane", () => {
  const square = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]];
  assert.equal(clipPolygon(square, beyond(0, -1)), square);
  assert.equal(clipPolygon(square, beyond(0, 0)), square, "what touches the plane is kept");
  assert.deepEqual(clipPolygon(square, beyond(0, 5)), []);
  assert.deepEqual(clipPolygon(square, beyond(0, 1)), [[1, 0, 0], [4, 0, 0], [4, 4, 0], [1, 4, 0]]);
  assert.deepEqual(clipPolygon([[0, 0, 0], [4, 0, 0], [0, 4, 0]], beyond(0, 1)), [[1, 0, 0], [4, 0, 0], [1, 3, 0]]);
});

test("lines are cut at a plane", () => {
  const [from, to] = [[-2, 0, 0], [2, 8, 4]];
  assert.deepEqual(clipSegment(from, to, beyond(0, -2)), [from, to]);
  assert.deepEqual(clipSegment(from, to, beyond(0, 0)), [[0, 4, 2], to]);
  assert.deepEqual(clipSegment(to, from, beyond(0, 0)), [to, [0, 4, 2]]);
  assert.equal(clipSegment(from, to, beyond(0, 3)), null);
});

test("a camera sees what is ahead of it where it is", () => {
  const camera = { position: [1, 0, 2], rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], width: 640, height: 480, focal: 320 };
  const lens = new Lens(camera, [10, 20, 0], [Math.PI / 2, 0, 0]); // it looks north
  assert.deepEqual(lens.eye.map((value) => Math.round(value * 1e9) / 1e9), [10, 21, 2]);
  const [u, v] = lens.point([9, 31, 1]);
  assert.ok(Math.abs(u - (320 - 32)) < 1e-9, "west is to the left");
  assert.ok(Math.abs(v - (240 + 32)) < 1e-9);
  assert.equal(lens.point([10, 21 + NEAR_M - 0.1, 2]), null);
});

test("zooming keeps the place under the pointer", () => {
  for (const [window, back] of [[new Viewport(), "toWorld"], [new CameraWindow(wholeImage(), { width: 640, height: 480 }), "toImage"]]) {
    const before = window[back](100, 50, 800, 600);
    window.zoomAt(1.7, 100, 50, 800, 600);
    window[back](100, 50, 800, 600).forEach((value, axis) => assert.ok(Math.abs(value - before[axis]) < 1e-9));
    const [x, y] = window.toScreen(...before, 800, 600);
    assert.ok(Math.hypot(x - 100, y - 50) < 1e-9);
  }
});

test("rows are grouped by frame and matches are expanded", () => {
  assert.deepEqual(groupByFrame([1, 0, 1, 5], 2).map((rows) => [...rows]), [[1], [0, 2]]);
  assert.deepEqual([...expand([0, 1, 0, 1], [7, 9])], [-1, 7, -1, 9]);
});

test("colours are mixed and faded", () => {
  assert.equal(mixed("#000000", "#ffffff", 0.5), "#808080");
  assert.equal(faded("#102030", 0.5), "#10203080");
});

test("labels do not cover each other, and are left out where there is no room", () => {
  const context = { measureText: (text) => ({ width: 6 * text.length }), strokeText() {}, fillText() {} };
  const canvas = { context, width: 200, height: 200, palette: { ground: "#000000" } };
  const taken = [];
  const places = Array.from({ length: 6 }, () => writeLabel(canvas, ["label"], around([90, 90, 110, 110]), "#ffffff", taken));
  const found = places.filter(Boolean);
  assert.equal(found.length, 4, "the fifth place would cover the first");
  for (const a of found) for (const b of found) if (a !== b) assert.ok(a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1]);
});

test("a needed label stays on the canvas, wherever its sign is", () => {
  const context = { measureText: (text) => ({ width: 6 * text.length }), strokeText() {}, fillText() {} };
  const canvas = { context, width: 200, height: 200, palette: { ground: "#000000" } };
  for (const [x, y] of [[1, 100], [199, 100], [100, 1], [100, 199], [-15, 210]]) {
    const beside = (wide) => [[x - wide - 15, y - 8]];
    const [left, top, right, bottom] = writeLabel(canvas, ["infra_4"], beside, "#ffffff", [[0, 0, 200, 200]], { needed: true });
    assert.ok(left >= 2 && top >= 2 && right <= 198 && bottom <= 198, `cut off beside ${x}, ${y}`);
  }
});

test("a label beside a compromised agent keeps clear of its ring", () => {
  const canvas = { viewport: { toScreen: (x, y) => [x, y] }, width: 200, height: 200 };
  const reserved = (adversaries) => {
    const taken = [];
    reserveSigns(/** @type {any} */ (canvas), /** @type {any} */ ([{ x: 100, y: 100, adversaries }]), taken);
    return taken[0];
  };
  assert.deepEqual(reserved([]), [88, 88, 112, 112]);
  assert.ok(reserved(["adversary_1"])[0] < 100 - 13.5, "the ring, its line and a gap");
});

test("undecided agents are named as such, in the colour of the state", () => {
  const mark = { state: "undecided", down: false, cutOff: false };
  assert.equal(troubleOf(/** @type {any} */ (mark)), "undecided");
  assert.equal(troubleOf(/** @type {any} */ ({ ...mark, cutOff: true })), "undecided, cut off");
  assert.equal(troubleOf(/** @type {any} */ ({ ...mark, state: "trusted" })), "");
  const palette = /** @type {any} */ ({ states: { suspended: "#aa0000", undecided: "#0000aa" }, fault: "#00aa00", faint: "#111111" });
  assert.equal(colourOfKind("undecided", palette), "#0000aa");
  assert.equal(colourOfKind("suspension", palette), "#aa0000");
});
