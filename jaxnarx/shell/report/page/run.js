/* The model at work: free runs, steady states, step responses.

   `program` is what the exported module offers: Model, HISTORY, SAMPLE_TIME, and with it
   `ports` (of all that is computed: low, high) and `flags`. Rows are arrays. */

/* A free run over rows of inputs, from rows of measured outputs up to sample `start`; without
   any it begins from the steady state at the first inputs. NaN before it begins. */
function freeRun(program, inputs, measured, start) {
  const length = inputs.length;
  const outputs = program.reported.map(() => new Float64Array(length).fill(NaN));
  const limited = program.reported.map(() => new Float64Array(length));
  const flags = Object.fromEntries(program.flags.map((f) => [f, new Float64Array(length)]));
  let model, first = 0, settled = true;
  if (measured) {
    model = new program.Model();
    model.begin(inputs[0], measured[0]);
    first = start;
    for (let t = 0; t < first; t++) model.observe(inputs[t], measured[t]);
  } else {
    const rest = settle(program, inputs[0]);
    model = rest.model;
    settled = rest.settled;
  }
  for (let t = first; t < length; t++) {
    const y = model.step(inputs[t]);
    for (let o = 0; o < y.length; o++) {
      outputs[o][t] = y[o];
      limited[o][t] = model.limited[o] > 0.5 ? 1 : 0;
    }
    for (const flag of program.flags) flags[flag][t] = model[flag];
  }
  return { outputs, limited, flags, first, settled };
}

/* The first sample behind a complete measured history. */
function firstStart(program, inputs, measured) {
  let complete = 0;
  for (let t = 0; t < inputs.length; t++) {
    if (complete >= program.HISTORY && measured[t].every(Number.isFinite)) return t;
    complete = measured[t].every(Number.isFinite) ? complete + 1 : 0;
  }
  return -1;
}

/* The model where its outputs no longer move while its inputs stay; `settled` is false
   where they still do after so many samples. */
function settle(program, u, guess, most = 4000) {
  const model = new program.Model();
  model.begin(u, guess || program.ports.map((p) => 0.5 * (p.low + p.high)));
  return settleOn(program, model, u, most);
}

function settleOn(program, model, u, most) {
  const near = program.reported.map((p) => 1e-7 * (p.high - p.low || 1));
  let calm = 0, steps = 0, y = model.step(u);
  while (calm < program.HISTORY + 20 && steps < most) {
    const next = model.step(u);
    const moves = next.some((v, o) => !(Math.abs(v - y[o]) <= near[o]));
    calm = moves ? 0 : calm + 1;
    y = next;
    steps += 1;
  }
  return { model, y, steps, settled: calm >= program.HISTORY + 20 };
}

/* A model with the same past. */
function cloned(model) {
  const other = Object.assign(Object.create(Object.getPrototypeOf(model)), model);
  for (const key of Object.keys(other)) {
    if (Array.isArray(other[key])) other[key] = other[key].slice();
  }
  return other;
}

/* Outputs from the steady state at `from` when inputs become `to` at sample 0; long enough
   that they settle, if they do within `most` samples. */
function stepResponse(program, from, to, most = 2000) {
  const rest = settle(program, from);
  const end = settleOn(program, cloned(rest.model), to, most);
  const length = Math.min(Math.max(Math.ceil(1.25 * (end.steps - program.HISTORY)), 20), most);
  const before = Math.max(Math.round(length / 10), 2);
  const time = new Float64Array(before + length);
  const outputs = program.reported.map(() => new Float64Array(before + length));
  const model = cloned(rest.model);
  for (let t = -before; t < length; t++) {
    const y = t < 0 ? rest.y : model.step(to);
    time[t + before] = t * program.SAMPLE_TIME;
    y.forEach((v, o) => { outputs[o][t + before] = v; });
  }
  return { time, outputs, from: rest, to: end };
}

/* How far a sample is from what the model knows: its index, or the switch that inputs leave
   their range. More than 1 is outside. */
function distance(program, flagOf) {
  if (program.flags.includes("index")) return flagOf("index");
  return program.flags.includes("extrapolated") ? 2 * flagOf("extrapolated") : 0;
}
