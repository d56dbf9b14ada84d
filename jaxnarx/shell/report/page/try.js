/* Inputs moved by sliders: steady state and step response of the model. */

class Bench {
  constructor(place, program, report) {
    Object.assign(this, { place, program, report, charts: [] });
    this.start = program.inputs.map((p, n) => report.middles[n]);
    this.now = this.start.slice();
    const first = program.inputs[0];
    if (first) {
      const inwards = this.now[0] < 0.5 * (first.low + first.high) ? 0.2 : -0.2;
      this.now[0] += inwards * (first.high - first.low);
    }
    this.sliders = program.inputs.map((port, n) => this.slider(port, n));
    place.sliders.replaceChildren(...this.sliders.map((s) => s.row));
    place.take.addEventListener("click", () => { this.start = this.now.slice(); this.update(); });
    place.back.addEventListener("click", () => this.set(this.start));
    new ResizeObserver(() => this.charts.forEach((c) => {
      c.setSize({ width: Math.max(place.charts.clientWidth, 200), height: c.height });
    })).observe(place.charts);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.update());
    this.changed = () => {};
    this.update();
  }

  /* A fifth beyond the trained range on both sides, which is marked. */
  slider(port, n) {
    const span = port.high - port.low || Math.abs(port.high) || 1;
    const low = port.low - 0.2 * span, high = port.high + 0.2 * span;
    const range = make("input", {
      type: "range", min: 0, max: 1000, step: 1, "aria-label": withUnit(port),
      on: { input: () => this.move(n, low + (high - low) * range.value / 1000) },
    });
    const exact = make("input", {
      type: "number", step: "any", "aria-label": `${withUnit(port)}, exact`,
      on: { change: () => Number.isFinite(exact.valueAsNumber) && this.move(n, exact.valueAsNumber) },
    });
    const name = make("span", { class: "name" }), ends = make("span", { class: "ends" });
    name.textContent = withUnit(port);
    ends.textContent = `trained ${short(port.low)} to ${short(port.high)}`;
    const row = make("div", { class: "slider" }, name, range, exact, ends);
    const show = (value) => {
      range.value = String(Math.round(1000 * (value - low) / (high - low)));
      exact.value = String(Number(value.toPrecision(5)));
      row.classList.toggle("beyond", value < port.low || value > port.high);
    };
    return { row, show };
  }

  move(n, value) {
    this.now[n] = value;
    this.later();
  }

  set(values) {
    this.now = values.slice();
    this.update();
  }

  later() {
    this.sliders.forEach((slider, n) => slider.show(this.now[n]));
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.update(); });
  }

  update() {
    this.sliders.forEach((slider, n) => slider.show(this.now[n]));
    this.found = stepResponse(this.program, this.start, this.now);
    this.table();
    this.draw();
    this.changed();
  }

  table() {
    const { from, to } = this.found;
    const cell = (tag, words) => {
      const element = make(tag);
      element.textContent = words;
      return element;
    };
    const rows = this.program.reported.map((port, o) => make("tr", {},
      cell("th", withUnit(port)), cell("td", short(from.y[o])), cell("td", short(to.y[o])),
      cell("td", short(to.y[o] - from.y[o]))));
    this.place.table.replaceChildren(
      make("thead", {}, make("tr", {}, ...["steady state", "start", "now", "change"]
        .map((words) => cell("th", words)))), make("tbody", {}, ...rows));
    const far = distance(this.program, (flag) => to.model[flag]);
    const told = [];
    if (!to.settled || !from.settled) told.push("It does not come to rest: the figures are those after a long while.");
    if (far > 1) {
      told.push(this.program.flags.includes("index")
        ? `Outside of what the model knows: index ${short(far, 3)}, one is the border.`
        : "Outside of the range it was trained for.");
    }
    this.place.told.textContent = told.join(" ");
  }

  draw() {
    this.charts.forEach((chart) => chart.destroy());
    const { time, outputs } = this.found;
    this.charts = this.program.reported.map((port, o) => {
      const axis = axisLook();
      const range = (u, low, high) => {
        const least = 1e-3 * (port.high - port.low || 1), room = Math.max(high - low, least);
        return [low - 0.08 * room, high + 0.08 * room];
      };
      return new uPlot({
        width: Math.max(this.place.charts.clientWidth, 200), height: 190, legend: { show: false },
        cursor: { drag: { x: false, y: false } }, scales: { x: { time: false }, y: { range } },
        axes: [{ ...axis, size: 34, label: "time after the step [s]", labelSize: 20 },
          { ...axis, size: 62, label: withUnit(port), labelSize: 18 }],
        series: [{}, { stroke: colour("blue"), width: 1.6, points: { show: false } }],
      }, [time, outputs[o]], this.place.charts);
    });
  }
}
