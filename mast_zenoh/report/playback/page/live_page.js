// The page of a running run: finds the place for its viewer, and starts it.

import { showLive } from "./live.js";

const place = /** @type {HTMLElement} */ (document.querySelector(".viewer"));
showLive(place).then((viewer) => {
  document.documentElement.classList.add("scripted");
  /** @type {any} */ (window).viewer = viewer;
  place.classList.add("v-ready");
});
