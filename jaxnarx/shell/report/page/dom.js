/* Elements and numbers. Text from data only ever becomes text. */

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "on") {
      for (const [event, call] of Object.entries(value)) element.addEventListener(event, call);
    } else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

const byId = (id) => document.getElementById(id);

function short(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  return String(Number(value.toPrecision(digits))).replace("-", "−");
}

/* Decimals that tell values apart that are a step apart: 0.0005 needs four. */
function decimals(step) {
  for (let d = 0; d <= 15; d++) {
    const scaled = Math.abs(step) * 10 ** d;
    if (scaled > 0.5 && Math.abs(scaled - Math.round(scaled)) < 1e-4 * scaled) return d;
  }
  return 15;
}

/* A value on an axis whose ticks are a step apart; powers of ten where zeros would fill it. */
function tickText(value, step) {
  if (value === null || value === undefined || !Number.isFinite(value)) return short(value);
  const size = Math.max(Math.abs(value), Math.abs(step));
  if (!(step > 0)) return short(value);
  if (size >= 1e-5 && size < 1e7) return minus(value.toFixed(decimals(step)));
  const digits = Math.ceil(Math.log10(size / step) - 1e-9) + 2;
  return short(value, Math.min(Math.max(digits, 1), 15));
}

const minus = (text) => (Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−"));

/* What every chart's axes have in common. */
const axisLook = () => ({
  stroke: colour("soft"), font: "12px system-ui", labelFont: "12px system-ui",
  grid: { stroke: colour("grid"), width: 0.5 }, ticks: { stroke: colour("grid"), width: 0.5 },
  values: (chart, splits, axis, space, step) => splits.map((v) => tickText(v, step)),
});

const withUnit = (port) => (port.unit && port.unit !== "-" && port.unit !== "1"
  ? `${port.name} [${port.unit}]` : port.name);

/* A colour of the page's style, which follows light and dark. */
function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function options(select, names, chosen) {
  select.replaceChildren(...names.map((name, n) => {
    const option = make("option", { value: n });
    option.textContent = name;
    return option;
  }));
  select.value = String(chosen);
}

/* Root mean square of what is finite. */
function rootMeanSquare(values) {
  let sum = 0, count = 0;
  for (const v of values) if (Number.isFinite(v)) { sum += v * v; count += 1; }
  return count ? Math.sqrt(sum / count) : NaN;
}
