/* The records over time: measured and simulated, residual and inputs on one axis. */

const HEIGHTS = { main: 300, residual: 120, inputs: 150 };
const INPUTS = "inputs, %";
const TRACES = ["orange", "green", "purple", "sky", "red"];

class View {
  constructor(place, report) {
    Object.assign(this, { place, report, output: 0, charts: [], hidden: new Set(report.others) });
    this.key = uPlot.sync("time");
    this.mark = null;
    this.extra = [];
    const redraw = () => this.shown && this.draw(true);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    new ResizeObserver(() => this.resize()).observe(place.charts);
  }

  /* Show a record (see shown.js), all of it or from sample time `range`. */
  show(shown, range = null, mark = null) {
    Object.assign(this, { shown, extra: [], mark });
    this.draw(false);
    if (range) this.zoom(...range);
  }

  /* Lines of the upper chart: [name, values, look]. */
  lines() {
    const { shown, output: o } = this;
    const found = [];
    if (shown.measured[o]) found.push(["measured", shown.measured[o], ["ink", 1.6]]);
    found.push(["free run", shown.simulated[o], ["blue", 1.4]]);
    [...shown.others, ...this.extra].forEach((other, n) => {
      found.push([other.name, other.runs[o], [TRACES[n % TRACES.length], 1.1]]);
    });
    return found;
  }

  draw(keep) {
    const { shown, output: o } = this;
    const range = keep && this.charts.length ? this.range() : null;
    this.charts.forEach((chart) => chart.destroy());
    const label = withUnit(this.report.outputs[o]);
    const lines = this.lines().filter(([name]) => !this.hidden.has(name));
    const half = this.hidden.has("interval") ? null : shown.half[o];
    const about = (middle, sign) => middle.map((y, t) => y + sign * half[t]);
    const zero = new Float64Array(shown.time.length);
    const band = (middle) => (half ? [["", about(middle, 1), null], ["", about(middle, -1), null]]
      : []);
    const upper = [...band(shown.simulated[o]), ...lines];
    const lower = [...band(zero), ["residual", shown.residual[o], ["blue", 1.1]]];
    const scaled = this.scaledInputs();
    const inner = [shown.measured[o], shown.simulated[o]].filter(Boolean);
    this.charts = [
      this.chart(this.place.main, upper, label, HEIGHTS.main, inner, half),
      this.chart(this.place.residual, lower, "residual", HEIGHTS.residual, [shown.residual[o]], half),
      this.chart(this.place.inputs, scaled, INPUTS, HEIGHTS.inputs,
        scaled.map((s) => s[1]), null),
    ];
    if (range) this.zoom(...range);
    this.legend(lines);
  }

  /* Inputs in percent of the range they were trained in. */
  scaledInputs() {
    return this.report.signals.slice(0, this.shown.inputs.length).map((signal, n) => {
      const low = signal.low, span = signal.high - signal.low || 1;
      const look = [["blue", "orange", "green", "purple", "red", "sky", "ink"][n % 7], 1.1];
      return [signal.name, this.shown.inputs[n].map((v) => 100 * (v - low) / span), look];
    });
  }

  chart(place, lines, label, height, inner, half) {
    const { time } = this.shown;
    const axis = axisLook();
    const bands = half ? [{ series: [1, 2], fill: `${colour("blue")}30` }] : [];
    const options = {
      width: Math.max(place.clientWidth, 200), height, legend: { show: false }, bands,
      cursor: { sync: { key: this.key.key, scales: ["x", null] }, drag: { x: true, y: false, setScale: true },
        focus: { prox: 1e9 }, bind: { dblclick: () => () => { this.reset(); return null; } } },
      scales: { x: { time: false }, y: { range: (u) => this.bounds(u, inner, label, half) } },
      axes: [{ ...axis, size: 34, label: place === this.place.inputs ? "time [s]" : undefined,
        labelSize: 20 },
        { ...axis, size: 62, label, labelSize: 18 }],
      series: [{}, ...lines.map(([name, , look]) => ({
        label: name, stroke: look ? colour(look[0]) : "transparent", width: look ? look[1] : 0,
        points: { show: false }, spanGaps: false,
      }))],
      hooks: {
        drawClear: [(u) => this.shade(u)],
        setScale: [(u, key) => key === "x" && this.link(u)],
        setCursor: [(u) => this.readOut(u)],
        draw: [(u) => this.line(u)],
      },
    };
    const chart = new uPlot(options, [time, ...lines.map(([, values]) => values)], place);
    this.gestures(chart);
    return chart;
  }

  /* The span of what is measured and simulated within the view; other models, and a run
     that leaves widely, may leave the frame. */
  bounds(chart, inner, label, half) {
    const [from, to] = chart.series[0].idxs || [0, this.shown.time.length - 1];
    let low = Infinity, high = -Infinity, base = [Infinity, -Infinity];
    inner.forEach((values, n) => {
      for (let t = from; t <= to; t++) {
        const v = values[t];
        if (!Number.isFinite(v)) continue;
        if (n === 0) base = [Math.min(base[0], v), Math.max(base[1], v)];
        low = Math.min(low, v);
        high = Math.max(high, v);
      }
    });
    if (!(high >= low)) return [0, 1];
    const room = base[1] - base[0] || Math.abs(high) || 1;
    if (Number.isFinite(base[0]) && inner.length > 1 && label !== INPUTS) {
      low = Math.max(low, base[0] - room);
      high = Math.min(high, base[1] + room);
    }
    /* The interval lies about the last of the inner lines, or about a residual of zero. */
    const ends = [low, high];
    const middle = inner.length > 1 ? inner[inner.length - 1] : null;
    for (let t = from; half && t <= to; t++) {
      const v = middle ? middle[t] : 0;
      if (!Number.isFinite(v) || !Number.isFinite(half[t])) continue;
      const kept = Math.max(low, Math.min(high, v));
      ends[0] = Math.min(ends[0], kept - half[t]);
      ends[1] = Math.max(ends[1], kept + half[t]);
    }
    /* One that widens at a few samples does not press all else flat. */
    low = Math.max(ends[0], low - room);
    high = Math.min(ends[1], high + room);
    const edge = 0.06 * (high - low || room);
    return [low - edge, high + edge];
  }

  /* What lies outside of the domain, and where the feedback bound acts. */
  shade(chart) {
    const { shown } = this;
    this.shadeRuns(chart, shown.outside, 1, `${colour("orange")}38`);
    this.shadeRuns(chart, shown.limited[this.output], 0.5, `${colour("red")}30`);
  }

  shadeRuns(chart, values, level, fill) {
    if (!values) return;
    const { ctx, bbox } = chart;
    const x = (t) => chart.valToPos(this.shown.time[t], "x", true);
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.fillStyle = fill;
    for (let t = 0; t < values.length; t++) {
      if (!(values[t] > level)) continue;
      const from = t;
      while (t + 1 < values.length && values[t + 1] > level) t += 1;
      const left = x(from), right = x(Math.min(t + 1, values.length - 1));
      ctx.fillRect(left, bbox.top, Math.max(right - left, 1), bbox.height);
    }
    ctx.restore();
  }

  line(chart) {
    if (this.mark === null) return;
    const { ctx, bbox } = chart;
    const x = chart.valToPos(this.mark, "x", true);
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    ctx.save();
    ctx.strokeStyle = colour("bad");
    ctx.setLineDash([6, 4]);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }

  link(from) {
    if (this.linking) return;
    this.linking = true;
    const { min, max } = from.scales.x;
    for (const chart of this.charts) {
      const own = chart.scales.x;
      if (chart !== from && (own.min !== min || own.max !== max)) chart.setScale("x", { min, max });
    }
    this.linking = false;
  }

  range() {
    const { min, max } = this.charts[0].scales.x;
    return [min, max];
  }

  ends() {
    const { time } = this.shown;
    return [time[0], time[time.length - 1]];
  }

  /* Never beyond the record, never below four samples. */
  zoom(min, max) {
    const [first, last] = this.ends();
    const least = Math.min(4 * (this.shown.time[1] - first || 1), last - first || 1);
    const width = Math.min(Math.max(max - min, least), last - first || 1);
    const from = Math.max(first, Math.min(min, last - width));
    this.linking = true;
    for (const chart of this.charts) chart.setScale("x", { min: from, max: from + width });
    this.linking = false;
  }

  reset() { this.zoom(...this.ends()); }

  /* Another width, about the same middle; or moved by a share of the width. */
  scale(factor) {
    const [min, max] = this.range(), middle = 0.5 * (min + max);
    this.zoom(middle - 0.5 * factor * (max - min), middle + 0.5 * factor * (max - min));
  }

  pan(share) {
    const [min, max] = this.range(), by = share * (max - min);
    const [first, last] = this.ends();
    const kept = Math.min(Math.max(by, first - min), last - max);
    this.zoom(min + kept, max + kept);
  }

  gestures(chart) {
    let held = null;
    const over = chart.over;
    over.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.shiftKey) return;
      event.preventDefault();
      if (event.shiftKey) this.pan(Math.sign(event.deltaY || event.deltaX) * 0.1);
      else this.scale(event.deltaY > 0 ? 1.25 : 0.8);
    }, { passive: false });
    over.addEventListener("mousedown", (event) => {
      if (!event.shiftKey) return;
      event.stopImmediatePropagation();
      event.preventDefault();
      held = event.clientX;
    }, true);
    const moved = (x) => {
      this.pan((held - x) / over.clientWidth);
      held = x;
    };
    over.addEventListener("mousemove", (event) => held !== null && moved(event.clientX));
    for (const end of ["mouseup", "mouseleave"]) over.addEventListener(end, () => { held = null; });
    over.addEventListener("touchstart", (event) => { held = event.touches[0].clientX; },
      { passive: true });
    over.addEventListener("touchmove", (event) => moved(event.touches[0].clientX),
      { passive: true });
    over.addEventListener("touchend", () => { held = null; });
  }

  keys(event) {
    const step = {
      ArrowLeft: () => this.pan(-0.2), ArrowRight: () => this.pan(0.2),
      "+": () => this.scale(0.6), "=": () => this.scale(0.6), "-": () => this.scale(1.6),
      0: () => this.reset(), Home: () => this.reset(),
    }[event.key];
    if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    step();
  }

  resize() {
    for (const chart of this.charts) {
      const width = Math.max(chart.root.parentElement.clientWidth, 200);
      if (width !== chart.width) chart.setSize({ width, height: chart.height });
    }
  }

  /* Switches of the lines, with the values under the cursor. */
  legend(lines) {
    const all = this.lines().map(([name, , look]) => [name, look[0]]);
    if (this.shown.half[this.output]) all.push(["interval", "blue"]);
    const places = this.place.legend;
    this.values = {};
    places.replaceChildren(...all.map(([name, tone]) => {
      const box = make("input", {
        type: "checkbox", checked: !this.hidden.has(name),
        on: { change: (event) => this.toggle(name, event.target.checked) },
      });
      const swatch = make("span", { class: name === "interval" ? "swatch wide-swatch" : "swatch" });
      swatch.style.background = colour(tone);
      const text = make("span");
      text.textContent = name === "interval" ? `${100 * this.report.level} % interval` : name;
      this.values[name] = make("b");
      return make("label", {}, box, swatch, text, this.values[name]);
    }));
    if (this.shown.outside) places.append(this.note("orange", "outside of the domain", true));
    if (this.shown.limited[this.output]?.some((v) => v > 0.5)) {
      places.append(this.note("red", "feedback limited", true));
    }
    const ends = (n) => {
      const { low, high, unit } = this.report.signals[n];
      const of = unit && unit !== "-" && unit !== "1" ? ` ${unit}` : "";
      return `${short(low, 3)} to ${short(high, 3)}${of}`;
    };
    const inputs = this.scaledInputs().map(([name, , look], n) => {
      const note = this.note(look[0], `${name}, 0 to 100 %: ${ends(n)}`);
      this.values[`input ${name}`] = note.appendChild(make("b"));
      return note;
    });
    this.place.inputLegend.replaceChildren(...inputs);
  }

  note(tone, text, wide = false) {
    const swatch = make("span", { class: wide ? "swatch wide-swatch" : "swatch" });
    swatch.style.background = colour(tone);
    const words = make("span");
    words.textContent = text;
    return make("span", { class: "key" }, swatch, words);
  }

  toggle(name, seen) {
    if (seen) this.hidden.delete(name);
    else this.hidden.add(name);
    this.draw(true);
  }

  readOut(chart) {
    const at = chart.cursor.idx;
    if (!this.values || at === null || at === undefined) return;
    const { shown, output: o } = this;
    for (const [name, values] of this.lines()) {
      if (this.values[name]) this.values[name].textContent = short(values[at]);
    }
    this.report.signals.slice(0, shown.inputs.length).forEach((signal, n) => {
      const place = this.values[`input ${signal.name}`];
      if (place) place.textContent = short(shown.inputs[n][at]);
    });
    const index = shown.outside ? `, index ${short(shown.outside[at], 3)}` : "";
    this.place.cursor.textContent = `${tickText(shown.time[at], this.report.sample_time)} s: residual `
      + `${short(shown.residual[o][at])}${index}`;
  }
}
