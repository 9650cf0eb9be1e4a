// Unpacks the data block of a run. The writer is columns.py.

/**
 * @typedef {{name: string, rows: number, width: number, scale: number, differences: boolean}} ColumnEntry
 * @typedef {Record<string, Float64Array | Int32Array>} Columns
 */

/**
 * Decode a block.
 * @param {string} text base64 of the deflated block
 * @returns {Promise<{header: any, columns: Columns}>}
 */
export function decodeText(text) {
  const letters = atob(text.trim());
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
  return decodeBlock(packed);
}

/**
 * Decode a block.
 * @param {Uint8Array} packed the deflated block
 * @returns {Promise<{header: any, columns: Columns}>}
 */
export async function decodeBlock(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(content.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(content.subarray(4, 4 + length)));
  if ((header.format ?? 1) !== 1) throw new Error(`data of format ${header.format}, expected 1`);
  /** @type {Columns} */
  const columns = {};
  let at = 4 + length;
  for (const entry of header.columns) {
    decodeWhenRead(columns, content, at, entry);
    at += entry.rows * entry.width;
  }
  return { header, columns };
}

/** Add a column that is decoded when it is first read: most are not needed for the first drawing. */
function decodeWhenRead(columns, content, at, entry) {
  const keep = (value) => Object.defineProperty(columns, entry.name, { value, writable: true });
  const get = () => {
    keep(decodeColumn(content, at, entry));
    return columns[entry.name];
  };
  Object.defineProperty(columns, entry.name, { get, set: keep, configurable: true, enumerable: true });
}

/**
 * Decode one column: planes of bytes, folded numbers, differences.
 * @param {Uint8Array} content
 * @param {number} at first byte of the lowest plane
 * @param {ColumnEntry} entry
 * @returns {Float64Array | Int32Array} numbers in their unit; whole numbers where the scale is 1
 */
function decodeColumn(content, at, { rows, width, scale, differences }) {
  const values = new Int32Array(rows);
  for (let plane = 0; plane < width; plane++) {
    const start = at + plane * rows;
    const shift = 8 * plane;
    for (let i = 0; i < rows; i++) values[i] |= content[start + i] << shift;
  }
  let sum = 0;
  for (let i = 0; i < rows; i++) {
    const step = (values[i] >>> 1) ^ -(values[i] & 1);
    sum = differences ? sum + step : step;
    values[i] = sum;
  }
  if (scale === 1) return values;
  const scaled = new Float64Array(rows);
  for (let i = 0; i < rows; i++) scaled[i] = values[i] * scale;
  return scaled;
}
