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
    this.seen = new Uint8Array(CELLS * CELLS);
    this.place.canvas.dataset.done = "";
    this.single = this.chosen()[0] === this.chosen()[1];
    this.place.map.hidden = this.single;
    this.place.curve.hidden = !this.single;
    const count = this.single ? CELLS : CELLS * CELLS;
    let n = 0;
    const work = () => {
      if (job !== this.job) return;
      const until = performance.now() + SLICE;
      while (n < count && performance.now() < until) this.cell(n++);
      this.paint();
      if (n < count) setTimeout(work);
      else this.place.canvas.dataset.done = "1";
    };
    work();
  }

  cell(n) {
    const o = this.chosen()[2];
    const rest = settle(this.program, this.inputs(n % CELLS, Math.floor(n / CELLS)), null, 1500);
    this.values[n] = rest.settled ? rest.y[o] : NaN;
    this.seen[n] = 1;
    this.outside[n] = distance(this.program, (flag) => rest.model[flag]) > 1 ? 1 : 0;
  }

  paint() {
    const { canvas } = this.place;
    if (!this.values) return;
    if (this.single) { this.curve(); return; }
    const context = canvas.getContext("2d"), size = canvas.width / CELLS;
    const known = Array.from(this.values).filter(Number.isFinite);
    const low = Math.min(...known), high = Math.max(...known);
    const [pale, dark] = [colour("panel"), colour("blue")].map(channels);
    context.clearRect(0, 0, canvas.width, canvas.height);
    for (let n = 0; n < this.values.length; n++) {
      const i = n % CELLS, j = CELLS - 1 - Math.floor(n / CELLS);
      const v = this.values[n];
      if (!Number.isFinite(v)) {
        if (this.seen[n]) this.cross(context, i * size, j * size, size);
        continue;
      }
      const share = 0.08 + 0.92 * (high > low ? (v - low) / (high - low) : 0.5);
      const mixed = pale.map((c, k) => Math.round(c + (dark[k] - c) * share));
      context.fillStyle = `rgb(${mixed.join(",")})`;
      context.fillRect(Math.floor(i * size), Math.floor(j * size), Math.ceil(size), Math.ceil(size));
      if (this.outside[n]) this.hatch(context, i * size, j * size, size);
    }
    this.point(null);
    const port = this.program.reported[this.chosen()[2]];
    const [a, b] = this.chosen().map((n) => this.program.inputs[n]);
    this.scale(port, low, high, pale, dark);
    this.place.across.textContent = withUnit(a);
    this.place.up.textContent = withUnit(b);
    this.ticks(this.place.below, a, false);
    this.ticks(this.place.left, b, true);
  }

  /* The colours of the map from the least to the largest value. */
  scale(port, low, high, pale, dark) {
    const mixed = (share) => `rgb(${pale.map((c, k) => Math.round(c + (dark[k] - c) * share)).join(",")})`;
    this.place.ramp.style.background = `linear-gradient(to right, ${mixed(0.08)}, ${mixed(1)})`;
    this.place.low.textContent = low <= high ? short(low) : "";
    this.place.high.textContent = low <= high ? short(high) : "";
    this.place.scale.textContent = withUnit(port);
  }

  /* Five values of an input along a side of the map. */
  ticks(place, port, up) {
    const shares = [0, 0.25, 0.5, 0.75, 1], step = (port.high - port.low) / 4;
    place.replaceChildren(...(up ? shares.reverse() : shares).map((share) => {
      const text = make("span");
      text.textContent = short(this.value(port, share), Math.abs(step) < 1e-3 * Math.abs(port.high) ? 6 : 3);
      return text;
    }));
  }

  /* Of one input the steady state is a curve. */
  curve() {
    const [a, , o] = this.chosen(), port = this.program.inputs[a];
    const out = this.program.reported[o];
    const x = Array.from({ length: CELLS }, (_, i) => this.inputs(i, 0)[a]);
    const y = Array.from(this.values.slice(0, CELLS), (v) => (Number.isFinite(v) ? v : null));
    if (this.plot) this.plot.destroy();
    this.place.curve.hidden = false;
    this.plot = new uPlot({
      width: Math.max(Math.min(this.place.curve.clientWidth, 620), 200), height: 260,
      legend: { show: false }, cursor: { drag: { x: false, y: false } },
      scales: { x: { time: false } },
      axes: [{ ...axisLook(), size: 34, label: withUnit(port), labelSize: 20 },
        { ...axisLook(), size: 62, label: withUnit(out), labelSize: 18 }],
      series: [{}, { stroke: colour("blue"), width: 1.6, spanGaps: false }],
    }, [x, y], this.place.curve);
    const still = this.seen.slice(0, CELLS).filter((s, i) => s && !Number.isFinite(this.values[i])).length;
    this.place.told.textContent = still ? `Gaps: it does not come to rest at ${still} of ${CELLS} values.` : "";
    this.place.scale.textContent = "";
  }

  /* It does not come to rest there. */
  cross(context, x, y, size) {
    context.fillStyle = colour("line");
    context.fillRect(Math.floor(x), Math.floor(y), Math.ceil(size), Math.ceil(size));
    this.hatch(context, x, y, size, "soft");
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + size, y + size);
    context.stroke();
  }

  hatch(context, x, y, size, tone = "orange") {
    context.strokeStyle = colour(tone);
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
      + this.words(reported[o].name, n);
    if (take) this.bench.set(u);
  }

  words(name, n) {
    if (!this.seen[n]) return `${name} not computed yet`;
    const rest = Number.isFinite(this.values[n]) ? `${name} ${short(this.values[n])}`
      : `${name} does not come to rest`;
    return `${rest}${this.outside[n] ? ", outside of the domain" : ""}`;
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
