/* The page at work: what its controls do. Without this file it shows its static figures. */

class Page {
  constructor(report, program) {
    Object.assign(this, { report, program, number: 0, files: [] });
    this.view = new View({
      charts: byId("charts"), main: byId("chart-main"), residual: byId("chart-residual"),
      inputs: byId("chart-inputs"), legend: byId("legend"), inputLegend: byId("input-legend"),
      cursor: byId("cursor"),
    }, report);
    this.kept = new Map();
    this.controls();
  }

  controls() {
    const { report, view } = this;
    const on = (id, event, call) => byId(id).addEventListener(event, call);
    options(byId("choose-output"), report.outputs.map(withUnit), 0);
    this.listRecords();
    on("choose-output", "change", (event) => this.choose(Number(event.target.value)));
    on("choose-record", "change", (event) => this.open(Number(event.target.value)));
    on("previous", "click", () => this.step(-1));
    on("next", "click", () => this.step(1));
    on("zoom-in", "click", () => view.scale(0.6));
    on("zoom-out", "click", () => view.scale(1.6));
    on("pan-left", "click", () => view.pan(-0.3));
    on("pan-right", "click", () => view.pan(0.3));
    on("zoom-all", "click", () => view.reset());
    on("stretch", "click", () => this.open(this.number, { stretch: true }));
    on("charts", "keydown", (event) => view.keys(event));
    on("map-quantity", "change", () => this.map());
    byId("compute-here").hidden = !this.program;
    on("compute-here", "click", () => this.here());
    document.querySelectorAll("[data-jump]").forEach((button) => {
      const [record, from, to, output] = button.dataset.jump.split(" ").map(Number);
      button.hidden = false;
      button.addEventListener("click", () => this.jump(record, from, to, output));
    });
  }

  listRecords() {
    const { report } = this;
    const name = (r, n) => {
      const error = r.errors[this.view.output];
      const told = error === null || error === undefined ? "" : ` (RMSE ${short(error, 3)})`;
      return `${r.part}: ${r.name}${told}${n === worst ? ", worst" : ""}`;
    };
    const worst = this.worst();
    const names = [...report.records, ...this.files.map((f) => f.record)].map(name);
    options(byId("choose-record"), names, this.number);
  }

  /* The record of the first part with the largest error of the output. */
  worst() {
    const { records } = this.report;
    const error = (r) => (r.errors[this.view.output] ?? Infinity) * (r.start < r.samples);
    return records.reduce((best, r, n) => (
      r.part === records[0].part && error(r) > error(records[best]) ? n : best), 0);
  }

  count() { return this.report.records.length + this.files.length; }

  step(by) { return this.open((this.number + by + this.count()) % this.count()); }

  /* A record by its number; files that were dropped come behind. */
  async open(number, { stretch = false, range = null, mark = null } = {}) {
    const { report } = this, job = Symbol("open");
    this.job = job;
    const own = number >= report.records.length;
    const shown = own ? this.files[number - report.records.length]
      : await this.load(number, stretch);
    if (this.job !== job) return;
    this.number = number;
    byId("choose-record").value = String(number);
    byId("stretch").hidden = own || !report.records[number].stretch || stretch;
    this.view.show(shown, range, mark);
    this.told(shown, stretch);
  }

  async load(number, stretch) {
    const key = `${number}${stretch ? "s" : ""}`;
    if (!this.kept.has(key)) this.kept.set(key, await shownRecord(this.report, number, stretch));
    return this.kept.get(key);
  }

  told(shown, stretch) {
    const error = rootMeanSquare(shown.sampled ? shown.residual[this.view.output] : []);
    const unit = this.report.outputs[this.view.output].unit;
    const counted = (number) => `${number} sample${number === 1 ? "" : "s"}`;
    const words = [counted(shown.record.samples)];
    const scored = shown.sampled ? shown.residual[this.view.output].filter(Number.isFinite).length
      : shown.record.samples;
    if (scored && scored !== shown.record.samples) words.push(`${counted(scored)} scored`);
    if (Number.isFinite(error)) words.push(`RMSE ${short(error)}${unit ? ` ${unit}` : ""}`);
    if (shown.outside && shown.sampled) {
      const share = shown.outside.filter((v) => v > 1).length / shown.outside.length;
      words.push(`${short(100 * share, 3)} % outside of the domain`);
    }
    if (shown.reduced) words.push("reduced to its envelope; the worst stretch is there in full");
    if (stretch) words.push("the stretch with the largest error, every sample");
    byId("record-told").textContent = words.join(" · ");
  }

  choose(output) {
    this.view.output = output;
    byId("choose-output").value = String(output);
    this.listRecords();
    this.view.draw(true);
    this.told(this.view.shown, false);
    this.map();
  }

  /* A stretch of a record, in samples; as wide as that it can be seen. */
  async jump(number, from, to, output) {
    if (output !== this.view.output) this.choose(output);
    const record = this.report.records[number], dt = this.report.sample_time;
    const inside = record.stretch && from >= record.first && to < record.first + record.length;
    const wide = Math.max(3 * (to - from), 0.03 * record.samples, 60);
    const middle = 0.5 * (from + to);
    const range = [(middle - 0.5 * wide) * dt, (middle + 0.5 * wide) * dt];
    await this.open(number, { stretch: Boolean(inside), range, mark: middle * dt });
    byId("view").scrollIntoView({ block: "start" });
    byId("charts").focus({ preventScroll: true });
  }

  map() {
    const place = byId("map"), report = this.report;
    const map = report.maps.find((m) => m.output === report.outputs[this.view.output].name);
    byId("map-tools").hidden = !map;
    place.replaceChildren();
    if (!map) return;
    const quantity = byId("map-quantity").value;
    const jump = ([record, sample]) => this.jump(record, sample, sample, this.view.output);
    place.append(mapOf(map, quantity, jump));
  }

  /* The model run in this page beside what was computed before. */
  here() {
    const { view, program, report } = this;
    const run = runHere(program, report, view.shown);
    if (!run) {
      byId("cursor").textContent = "This record cannot be run here: it is not there at the "
        + "whole rate, or its beginning is not complete.";
      return;
    }
    view.extra = [{ name: "computed in this page", runs: run.outputs }];
    view.draw(true);
    const o = view.output, y = view.shown.simulated[o];
    let most = 0, low = Infinity, high = -Infinity;
    for (let t = run.first; t < y.length; t++) {
      const off = Math.abs(run.outputs[o][t] - y[t]);
      if (off > most) most = off;
      if (y[t] < low) low = y[t];
      if (y[t] > high) high = y[t];
    }
    byId("cursor").textContent = `Computed here from the rounded inputs: at most `
      + `${short(100 * most / (high - low || 1), 2)} % of the run's range away.`;
  }

  /* A file that was dropped or chosen: its free run in the view. */
  async take(file) {
    const place = byId("file-told");
    try {
      const found = runOfFile(this.program, file.name, await file.text());
      const shown = shownFile(this.program, this.report, found);
      shown.record.errors = shown.residual.map((r) => {
        const error = rootMeanSquare(r);
        return Number.isFinite(error) ? error : null;
      });
      this.files.push(shown);
      this.number = this.count() - 1;
      this.listRecords();
      await this.open(this.number);
      place.textContent = `${file.name}: ${found.length} samples; ${found.remarks.join("; ")}.`;
      place.className = "soft";
      byId("view").scrollIntoView({ block: "start" });
    } catch (error) {
      place.textContent = `${file.name}: ${error.message}`;
      place.className = "bad";
    }
  }

  bench() {
    const { program, report } = this;
    byId("try").hidden = false;
    const bench = new Bench({
      sliders: byId("sliders"), take: byId("take"), back: byId("back"), table: byId("steady"),
      told: byId("bench-told"), charts: byId("step-charts"),
    }, program, report);
    const surface = new Surface({
      first: byId("surface-first"), second: byId("surface-second"), output: byId("surface-output"),
      canvas: byId("surface"), told: byId("surface-told"), scale: byId("surface-scale"),
      across: byId("surface-across"), up: byId("surface-up"), left: byId("surface-left"),
      below: byId("surface-below"), low: byId("surface-low"), high: byId("surface-high"),
      ramp: byId("surface-ramp"), map: byId("surface-map"), curve: byId("surface-curve"),
    }, program, bench);
    byId("surface-box").hidden = program.inputs.length < 1;
    let waiting = null;
    bench.changed = () => { clearTimeout(waiting); waiting = setTimeout(() => surface.start(), 300); };
    Object.assign(this, { tried: bench, surface });
    const seen = new IntersectionObserver((entries) => {
      if (!entries.some((e) => e.isIntersecting)) return;
      seen.disconnect();
      surface.start();
    });
    seen.observe(byId("surface"));
    this.drops();
  }

  drops() {
    const zone = byId("drop"), chooser = byId("file");
    byId("file-button").addEventListener("click", () => chooser.click());
    chooser.addEventListener("change", () => chooser.files[0] && this.take(chooser.files[0]));
    const stop = (event) => event.preventDefault();
    for (const name of ["dragover", "drop"]) document.addEventListener(name, stop);
    document.addEventListener("dragover", () => zone.classList.add("over"));
    document.addEventListener("dragleave", () => zone.classList.remove("over"));
    document.addEventListener("drop", (event) => {
      zone.classList.remove("over");
      const file = event.dataTransfer.files[0];
      if (file) this.take(file);
    });
  }
}

/* The exported model with what the page knows of it; null where there is none. */
function programOf(report) {
  if (typeof MODEL === "undefined" || !report.program) return null;
  return { ...MODEL, ...report.program };
}

async function begin() {
  const report = JSON.parse(byId("report-data").textContent);
  const program = programOf(report);
  const page = new Page(report, program);
  window.jaxnarx = { page, program, report, freeRun, settle, stepResponse, parseCsv, runOfFile, tickText };
  document.documentElement.classList.add("running");
  byId("view").hidden = false;
  await page.open(page.worst());
  page.map();
  performance.mark("first-figure");
  if (program) setTimeout(() => page.bench());
}

/* What cannot run leaves the static figures. */
begin().catch((error) => {
  document.documentElement.classList.remove("running");
  for (const id of ["view", "try"]) byId(id).hidden = true;
  byId("broken").hidden = false;
  byId("broken").textContent = `The running part of this page does not work here (${error.message}); `
    + "the figures below were drawn beforehand.";
  throw error;
});
