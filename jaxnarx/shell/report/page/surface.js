/* The steady state over two inputs, the others held where the sliders are. */

const CELLS = 32;
const SLICE = 24; /* milliseconds of work between looks at the clock */

class Surface {
  constructor(place, program, bench) {
    Object.assign(this, { place, program, bench, job: 0 });
    const names = program.inputs.map((p) => p.name);
    options(place.first, names, 0);
    options(place.second, names, Math.min(1, names.length - 1));
    options(place.output, program.reported.map((p) => p.name), 0);
    for (const select of [place.first, place.second, place.output]) {
      select.addEventListener("change", () => this.start());
    }
    place.canvas.addEventListener("mousemove", (event) => this.point(event));
    place.canvas.addEventListener("click", (event) => this.point(event, true));
    place.canvas.addEventListener("keydown", (event) => this.keys(event));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
    this.at = [CELLS >> 1, CELLS >> 1];
  }

  chosen() {
    return [this.place.first, this.place.second, this.place.output].map((s) => Number(s.value));
  }

  /* Values between the ends of a trained range. */
  value(port, share) { return port.low + (port.high - port.low) * share; }

  inputs(i, j) {
    const [a, b] = this.chosen(), ports = this.program.inputs;
    const u = this.bench.now.slice();
    u[a] = this.value(ports[a], (i + 0.5) / CELLS);
    if (a !== b) u[b] = this.value(ports[b], (j + 0.5) / CELLS);
    return u;
  }

  /* Cells are computed in slices, so that the page stays alive; a new start ends the old. */
  start() {
    const job = ++this.job;
    this.values = new Float64Array(CELLS * CELLS).fill(NaN);
    this.outside = new Uint8Array(CELLS * CELLS);
    this.place.canvas.dataset.done = "";
    let n = 0;
    const work = () => {
      if (job !== this.job) return;
      const until = performance.now() + SLICE;
      while (n < CELLS * CELLS && performance.now() < until) this.cell(n++);
      this.paint();
      if (n < CELLS * CELLS) setTimeout(work);
      else this.place.canvas.dataset.done = "1";
    };
    work();
  }

  cell(n) {
    const o = this.chosen()[2];
    const rest = settle(this.program, this.inputs(n % CELLS, Math.floor(n / CELLS)), null, 1500);
    this.values[n] = rest.settled ? rest.y[o] : NaN;
    this.outside[n] = distance(this.program, (flag) => rest.model[flag]) > 1 ? 1 : 0;
  }

  paint() {
    const { canvas } = this.place;
    if (!this.values) return;
    const context = canvas.getContext("2d"), size = canvas.width / CELLS;
    const known = Array.from(this.values).filter(Number.isFinite);
    const low = Math.min(...known), high = Math.max(...known);
    const [pale, dark] = [colour("panel"), colour("blue")].map(channels);
    context.clearRect(0, 0, canvas.width, canvas.height);
    for (let n = 0; n < this.values.length; n++) {
      const i = n % CELLS, j = CELLS - 1 - Math.floor(n / CELLS);
      const v = this.values[n];
      if (!Number.isFinite(v)) continue;
      const share = 0.08 + 0.92 * (high > low ? (v - low) / (high - low) : 0.5);
      const mixed = pale.map((c, k) => Math.round(c + (dark[k] - c) * share));
      context.fillStyle = `rgb(${mixed.join(",")})`;
      context.fillRect(Math.floor(i * size), Math.floor(j * size), Math.ceil(size), Math.ceil(size));
      if (this.outside[n]) this.hatch(context, i * size, j * size, size);
    }
    this.point(null);
    const port = this.program.reported[this.chosen()[2]];
    const [a, b] = this.chosen().map((n) => this.program.inputs[n]);
    this.place.scale.textContent = `${withUnit(port)}: ${short(low)} (pale) to ${short(high)} (dark)`;
    this.place.across.textContent = `${withUnit(a)}: ${short(a.low)} to ${short(a.high)}`;
    this.place.up.textContent = `${withUnit(b)}: ${short(b.low)} to ${short(b.high)}`;
  }

  hatch(context, x, y, size) {
    context.strokeStyle = colour("orange");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(x, y + size);
    context.lineTo(x + size, y);
    context.stroke();
  }

  /* What a cell holds; a click moves the sliders there. */
  point(event, take = false) {
    const { canvas } = this.place;
    if (event) {
      const box = canvas.getBoundingClientRect();
      const cell = (share) => Math.max(0, Math.min(CELLS - 1, Math.floor(CELLS * share)));
      this.at = [cell((event.clientX - box.left) / box.width),
        CELLS - 1 - cell((event.clientY - box.top) / box.height)];
    }
    const [i, j] = this.at, [a, b, o] = this.chosen(), u = this.inputs(i, j);
    const { inputs, reported } = this.program;
    const n = j * CELLS + i;
    this.place.told.textContent = `${inputs[a].name} ${short(u[a])}, ${inputs[b].name} ${short(u[b])}: `
      + `${reported[o].name} ${short(this.values[n])}${this.outside[n] ? ", outside of the domain" : ""}`;
    if (take) this.bench.set(u);
  }

  keys(event) {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (event.key === "Enter") this.bench.set(this.inputs(...this.at));
    if (!by) return;
    event.preventDefault();
    this.at = this.at.map((v, k) => Math.max(0, Math.min(CELLS - 1, v + by[k])));
    this.point(null);
  }
}

/* Red, green and blue of "#rrggbb" or "#rgb". */
function channels(text) {
  const hex = text.slice(1);
  const wide = hex.length === 3 ? [...hex].map((c) => c + c).join("") : hex;
  return [0, 2, 4].map((k) => parseInt(wide.slice(k, k + 2), 16));
}
