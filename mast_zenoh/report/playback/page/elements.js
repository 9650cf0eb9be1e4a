// Makes elements of the page.

/**
 * Make an element.
 * @param {string} tag
 * @param {Record<string, any>} properties attributes; functions are listeners: onclick
 * @param {(Node | string)[]} children
 * @returns {any}
 */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== undefined) made.setAttribute(name, String(value));
  }
  made.append(...children);
  return made;
}

/**
 * Make a list of choices.
 * @param {string} label for those who do not see it
 * @param {[string, string][]} options value and text
 * @param {string} value the chosen one
 * @param {(value: string) => void} onchange
 */
export function choice(label, options, value, onchange) {
  const items = options.map(([each, text]) => element("option", { value: each, selected: each === value }, text));
  const select = element("select", { "aria-label": label, title: label }, ...items);
  select.addEventListener("change", () => onchange(select.value));
  return select;
}

/**
 * Fit a canvas to its place on the page and to the resolution of the screen.
 * @param {HTMLCanvasElement} canvas
 * @returns {{context: CanvasRenderingContext2D, width: number, height: number}} sizes in CSS pixels
 */
export function resizeCanvas(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  // Keeps the pixels out of the graphics card: without one, drawing through its emulation takes five times as long.
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}
