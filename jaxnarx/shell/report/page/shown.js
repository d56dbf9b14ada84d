/* What the view shows of a record: one object, whether it stands in the page or was dropped.

   `time` [s] and, by output, `measured`, `simulated`, `residual`, `half` (half width of the
   interval) and `limited`; `outside` is the index of the domain or null; `inputs` by input;
   `others` are free runs of other models: {name, runs}. */

async function shownRecord(report, number, stretch) {
  const record = report.records[number];
  const reduced = record.bins > 0 && !stretch;
  const length = reduced ? 2 * record.bins : stretch ? record.length : record.samples;
  const block = stretch ? record.stretch : record.data;
  const series = await unpacked(block, length);
  const first = stretch ? record.first : 0;
  const width = reduced ? (record.samples - 1) / (length - 1 || 1) : 1;
  const time = Float64Array.from({ length },
    (_, t) => (first + t * width) * report.sample_time);
  const signals = report.signals.map((_, s) => series[`u${s}`]);
  const of = (name) => report.outputs.map((_, o) => series[name + o] || null);
  const measured = signals.slice(signals.length - report.outputs.length);
  const simulated = of("y"), scored = of("s");
  const residual = report.outputs.map((_, o) => (reduced ? series[`r${o}`]
    : measured[o].map((y, t) => (scored[o][t] > 0.5 ? y - simulated[o][t] : NaN))));
  const others = report.others
    .map((name, n) => ({ name, runs: report.outputs.map((_, o) => series[`o${n}.${o}`]) }))
    .filter((other) => other.runs[0]);
  return {
    number, record, reduced, time, signals, measured, simulated, residual, others,
    inputs: signals.slice(0, signals.length - report.outputs.length),
    half: of("h"), limited: of("l"), outside: series.i || null, whole: !reduced && !stretch,
    first, sampled: !reduced,
  };
}

/* The same record run here, as another trace; null where it is not there at the whole rate. */
function runHere(program, report, shown) {
  const { record } = shown;
  if (!program || !shown.whole || !record.begin || record.start >= record.samples) return null;
  const at = program.inputs.map((p) => report.signals.findIndex((s) => s.name === p.name));
  if (at.includes(-1) || record.begin.some((row) => row.some((v) => v === null))) return null;
  const rows = Array.from(shown.time, (_, t) => at.map((s) => shown.signals[s][t]));
  return freeRun(program, rows, record.begin, record.start);
}

/* A dropped file. */
function shownFile(program, report, file) {
  const { run } = file;
  const length = file.length;
  const signal = report.signals.slice(0, report.signals.length - report.outputs.length);
  const outside = program.flags.length
    ? Float64Array.from({ length }, (_, t) => distance(program, (f) => run.flags[f][t])) : null;
  const half = report.outputs.map((port) => halfWidth(program, run, port.name));
  return {
    number: -1, reduced: false, whole: true, sampled: true, first: 0, others: [],
    record: { part: "your file", name: file.name, samples: length, errors: [] },
    time: Float64Array.from({ length }, (_, t) => t * program.SAMPLE_TIME),
    measured: file.measured, simulated: run.outputs, limited: run.limited,
    residual: run.outputs.map((y, o) => (file.measured[o]
      ? y.map((v, t) => file.measured[o][t] - v) : y.map(() => NaN))),
    inputs: signal.map((s) => {
      const n = program.inputs.findIndex((p) => p.name === s.name);
      return n < 0 ? new Float64Array(length).fill(NaN) : file.inputs[n];
    }),
    outside, half,
  };
}

/* Half the width of an output's interval, where the program tells it. */
function halfWidth(program, run, name) {
  const flag = program.halves[name];
  return flag && run.flags[flag] ? run.flags[flag] : null;
}
