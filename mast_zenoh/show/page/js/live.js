// The page of a running run: receives its frames from the server of this page, and shows them.

import { element } from "./controls.js";
import { FrameHistory } from "./live_run.js";
import { decodeBlock } from "./run.js";
import { Viewer } from "./viewer.js";

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

// The first frame, or a later one where the page is opened again.
const WAITING = "Waiting for the next frame of the run.";
/** ms before a lost connection is tried again. */
const RETRY_MS = 1000;
/** The code with which the server refuses a page. */
const TOO_MANY = 1013;
/** ms over which the rate is measured. */
const RATE_MS = 3000;

/**
 * Show the run until it ends.
 * @param {HTMLElement} root
 * @returns {Promise<Viewer>} once its first frame is there
 */
export function showLive(root) {
  const status = element("p", { class: "v-live", role: "status" }, WAITING);
  root.replaceChildren(status);
  return new Promise((resolve) => new LiveView(root, status, resolve).connect());
}

class LiveView {
  constructor(root, status, started) {
    this.root = root;
    this.status = status;
    this.started = started;
    this.frames = new FrameHistory();
    this.wires = new WireTable();
    /** @type {Viewer | null} */ this.viewer = null;
    /** @type {{number: number, at: number}[]} */ this.shown = [];
    /** @type {any[]} */ this.queue = [];
    this.dropped = 0;
    this.busy = false;
    this.counted = false;
    /** Whether the run has ended, or the page is being left. */
    this.over = false;
  }

  connect() {
    if (this.over) return;
    const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${this.root.dataset.live}`;
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => this.take(data, socket);
    socket.onclose = ({ code, reason }) => {
      if (this.over) return;
      if (code === TOO_MANY) {
        this.say(`Nothing is shown here: ${reason}.`);
        return;
      }
      this.say("The connection is lost; trying again.");
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  /** @param {string | ArrayBuffer} data @param {WebSocket} socket from which it came */
  take(data, socket) {
    const message = typeof data === "string" ? JSON.parse(data) : null;
    if (message?.kind === "over") this.over = true; // the connection may close before the frames ahead of it are shown
    this.queue.push({ message, data, socket });
    if (!this.busy) this.work();
  }

  async work() {
    this.busy = true;
    while (this.queue.length) {
      const { message, data, socket } = this.queue.shift();
      try {
        if (message) this.handleControl(message);
        else await this.extend(data);
      } catch (error) {
        this.say(`A frame cannot be shown: ${error}`);
      }
      if (!message && socket.readyState === WebSocket.OPEN) socket.send("shown"); // two are sent ahead
    }
    this.busy = false;
  }

  /** @param {any} message */
  handleControl(message) {
    if (message.kind === "lasting" && this.frames.begin(message.header)) this.leave("Another run is shown here; opening it.");
    if (message.kind === "notes" && !this.viewer) this.say([WAITING, ...message.notes].join(" · ")); // frames have them too
    if (message.kind === "dropped") this.dropped += message.count;
    if (message.kind === "over") {
      if (message.reload) this.leave("The run has ended; opening all of it.");
      else this.say("The run has ended.");
    }
  }

  /** Load the page again, which shows something else by now. @param {string} reason */
  leave(reason) {
    this.over = true;
    this.queue = [];
    this.say(reason);
    location.reload();
  }

  /** @param {ArrayBuffer} data a frame */
  async extend(data) {
    const block = await decodeBlock(new Uint8Array(data));
    if (!this.frames.lasting) return;
    const dropped = this.frames.add(block);
    if (dropped === null) return;
    const run = this.frames.joined();
    if (this.viewer) this.viewer.extend(run, dropped);
    else {
      this.viewer = new Viewer(this.root, [run]);
      this.root.prepend(this.status);
      this.root.append(this.wires.root);
      this.started(this.viewer);
    }
    this.wires.show(run.live.wires);
    this.count(run);
  }

  /** Say how much of the run is shown. @param {import("./live_run.js").LiveRun} run */
  count(run) {
    if (this.over) return;
    const now = performance.now();
    const { number, newest, down, refused, notes } = run.live;
    if (this.counted) this.shown.push({ number, at: now });
    this.counted = true; // the first frame waited for this page
    if (!this.shown.length) return;
    while (this.shown.length > 2 && now - this.shown[0].at > RATE_MS) this.shown.shift();
    const first = this.shown[0];
    const parts = [`running · frame ${newest}`];
    if (now - first.at > RATE_MS / 6) {
      const per = (/** @type {number} */ count) => (count / ((now - first.at) / 1000)).toFixed(1);
      parts.push(`${per(number - first.number)} frames/s, of which ${per(this.shown.length - 1)} are shown`);
    }
    if (this.dropped) parts.push(`${this.dropped} left out because this page was too slow`);
    if (down.length) parts.push(`down: ${down.join(", ")}`);
    if (refused) parts.push(`${refused} invalid messages in this frame`);
    this.say([...parts, ...notes].join(" · "));
  }

  /** @param {string} text */
  say(text) {
    if (this.status.textContent !== text) this.status.textContent = text;
  }
}

const place = /** @type {HTMLElement} */ (document.querySelector(".viewer"));
showLive(place).then((viewer) => {
  document.documentElement.classList.add("scripted");
  /** @type {any} */ (window).viewer = viewer;
  place.classList.add("v-ready");
});
