/* Series of numbers from text, as codec.py writes them. */

const NOTHING = 65535;

/* The bytes of base 64 text that holds deflated data. */
async function inflated(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(plain).arrayBuffer());
}

/* One series: differences of levels, low bytes before high ones. */
function decoded(bytes, from, length, low, step) {
  const values = new Float64Array(length);
  let code = 0;
  for (let t = 0; t < length; t++) {
    code = (code + bytes[from + t] + 256 * bytes[from + length + t]) & 65535;
    values[t] = code === NOTHING ? NaN : low + step * code;
  }
  return values;
}

/* All series of a block by their names. */
async function unpacked(block, length) {
  const bytes = await inflated(block.text);
  const found = {};
  block.series.forEach(([name, low, step], n) => {
    found[name] = decoded(bytes, 2 * length * n, length, low, step);
  });
  return found;
}
