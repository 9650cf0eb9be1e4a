// Finds the places for viewers in the page, reads their data, and starts them.

import { Run, decodeText } from "./run.js";
import { Viewer } from "./viewer.js";

/** @param {HTMLElement} root @returns {Promise<Viewer>} */
async function start(root) {
  const sources = [...root.querySelectorAll("script[data-run]")];
  const blocks = await Promise.all(sources.map((source) => decodeText(source.textContent ?? "")));
  const labels = blocks.map(({ header }) => header.label);
  const distinct = new Set(labels).size === labels.length;
  blocks.forEach(({ header }) => {
    header.name = distinct ? header.label : header.folder;
  });
  return new Viewer(root, blocks.map((block) => new Run(block)));
}

for (const root of document.querySelectorAll(".viewer")) {
  start(/** @type {HTMLElement} */ (root)).then(
    (viewer) => {
      document.documentElement.classList.add("scripted");
      for (const each of document.querySelectorAll("details.static")) each.removeAttribute("open");
      const global = /** @type {any} */ (window);
      if (!(global.viewer instanceof Viewer)) global.viewer = viewer;
      root.classList.add("v-ready");
    },
    (error) => {
      root.replaceChildren(Object.assign(document.createElement("p"), { textContent: `The viewer cannot start: ${error.message}` }));
      throw error;
    },
  );
}
