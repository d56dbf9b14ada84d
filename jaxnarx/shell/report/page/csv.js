/* Measurements from the text of a CSV file. */

/* The separator that most lines have in like number. */
function separatorOf(lines) {
  const some = lines.slice(0, 20);
  let best = ",", most = 0;
  for (const mark of [";", "\t", ","]) {
    const counts = some.map((line) => line.split(mark).length - 1);
    const least = Math.min(...counts);
    if (least > most) [best, most] = [mark, least];
  }
  return best;
}

/* Cells of a line; quoted ones may hold the separator. */
function cellsOf(line, mark) {
  if (!line.includes('"')) return line.split(mark).map((c) => c.trim());
  const cells = [];
  let cell = "", quoted = false;
  for (let i = 0; i < line.length; i++) {
    const c = line[i];
    if (c === '"' && quoted && line[i + 1] === '"') { cell += c; i += 1; }
    else if (c === '"') quoted = !quoted;
    else if (c === mark && !quoted) { cells.push(cell.trim()); cell = ""; }
    else cell += c;
  }
  return [...cells, cell.trim()];
}

/* Columns by name: [{name, values}]; a line of units behind the names is passed over. */
function parseCsv(text) {
  const lines = text.replace(/^\uFEFF/, "").split(/\r\n|\n|\r/)
    .filter((line) => line.trim() && !line.startsWith("#"));
  if (lines.length < 2) throw new Error("the file has fewer than two lines");
  const mark = separatorOf(lines);
  const comma = mark !== ",";
  const number = (cell) => {
    const plain = comma ? cell.replace(",", ".") : cell;
    return plain === "" ? NaN : Number(plain);
  };
  const names = cellsOf(lines[0], mark);
  if (names.every((n) => Number.isFinite(number(n)))) {
    throw new Error("the first line holds numbers; it has to name the columns");
  }
  const rows = lines.slice(1).map((line) => cellsOf(line, mark).map(number));
  if (rows.length > 1 && !rows[0].some(Number.isFinite)) rows.shift();
  return names.map((name, c) => ({
    name,
    values: Float64Array.from(rows, (row) => (c < row.length ? row[c] : NaN)),
  }));
}

/* "speed [rpm]", "Speed (rpm)" and "speed" are one name. */
function plainName(name) {
  return name.replace(/\s*[[(][^\])]*[\])]\s*$/, "").trim().toLowerCase();
}

function columnOf(columns, name) {
  const wanted = plainName(name);
  return columns.find((c) => c.name === name)
    || columns.find((c) => plainName(c.name) === wanted);
}

/* Distance of samples in seconds, where a column tells the time; else null. */
function sampleTimeOf(columns) {
  const time = columns.find((c) => ["time", "t", "zeit"].includes(plainName(c.name)));
  if (!time || time.values.length < 2) return null;
  const unit = /[[(]\s*ms\s*[\])]/.test(time.name) ? 1e-3 : 1;
  const steps = Array.from(time.values.slice(1), (v, i) => v - time.values[i])
    .filter((d) => d > 0).sort((a, b) => a - b);
  return steps.length ? unit * steps[Math.floor(steps.length / 2)] : null;
}

/* Values at another distance of samples, in straight lines between them. */
function resampled(values, ratio) {
  const length = Math.floor((values.length - 1) / ratio + 1e-9) + 1;
  return Float64Array.from({ length }, (_, t) => {
    const at = Math.min(t * ratio, values.length - 1), low = Math.floor(at + 1e-9);
    const share = at - low;
    return share < 1e-9 ? values[low] : values[low] * (1 - share) + values[low + 1] * share;
  });
}

/* Gaps filled with the value before (at the beginning, the first), and how many. */
function filled(values) {
  let last = values.find(Number.isFinite), count = 0;
  const found = values.map((v) => {
    if (Number.isFinite(v)) { last = v; return v; }
    count += 1;
    return last;
  });
  if (last === undefined) throw new Error("a column holds no number");
  return [found, count];
}

/* The free run of the model over a file: what the view shows, and remarks. */
function runOfFile(program, name, text) {
  const remarks = [];
  let columns = parseCsv(text);
  const missing = program.inputs.filter((p) => !columnOf(columns, p.name));
  if (missing.length) {
    throw new Error(`the file has no column ${missing.map((p) => p.name).join(", ")}; `
      + `it has ${columns.map((c) => c.name).slice(0, 12).join(", ")}`);
  }
  const dt = sampleTimeOf(columns);
  const ratio = dt ? program.SAMPLE_TIME / dt : 1;
  if (Math.abs(ratio - 1) > 1e-3) {
    columns = columns.map((c) => ({ name: c.name, values: resampled(c.values, ratio) }));
    remarks.push(`resampled from ${short(dt)} s to the model's ${short(program.SAMPLE_TIME)} s`);
  } else if (!dt) {
    remarks.push(`no column of time: a sample every ${short(program.SAMPLE_TIME)} s is assumed`);
  }
  const inputs = program.inputs.map((p) => {
    const [values, count] = filled(columnOf(columns, p.name).values);
    if (count) remarks.push(`${p.name}: ${count} gaps, the value before holds`);
    return values;
  });
  const length = inputs.length ? inputs[0].length : columns[0].values.length;
  const rows = Array.from({ length }, (_, t) => inputs.map((v) => v[t]));
  const measured = program.reported.map((p) => {
    const found = columnOf(columns, p.name);
    return found ? found.values : null;
  });
  const known = measured.every(Boolean) && program.ports.length === program.reported.length;
  let begin = null, start = -1;
  if (known) {
    begin = rows.map((_, t) => measured.map((v) => v[t]));
    start = firstStart(program, rows, begin);
    const held = measured.map((v) => (v.some(Number.isFinite) ? filled(v)[0] : v));
    begin = rows.map((_, t) => held.map((v) => v[t]));
  }
  const run = freeRun(program, rows, start >= 0 ? begin : null, start);
  remarks.push(start >= 0 ? "begins from the measured outputs"
    : run.settled ? "begins from the steady state at the first inputs"
      : "the model does not come to rest at the first inputs; it begins from the middle of its range");
  return { name, inputs, measured, run, length, remarks };
}
