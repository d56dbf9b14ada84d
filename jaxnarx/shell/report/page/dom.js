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
