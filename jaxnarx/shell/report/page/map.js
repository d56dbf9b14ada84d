/* The error over the operating range: cells that lead to where it is largest. */

const QUANTITIES = { RMSE: "rms", bias: "bias", spread: "spread", samples: "samples" };

/* A shade between pale and dark blue; of a bias from blue to red. */
function shade(share, signed) {
  if (!signed) return `color-mix(in oklab, var(--blue) ${Math.round(12 + 88 * share)}%, var(--panel))`;
  const tone = share < 0 ? "var(--red)" : "var(--blue)";
  return `color-mix(in oklab, ${tone} ${Math.round(8 + 92 * Math.abs(share))}%, var(--panel))`;
}

/* Rows of buttons; `jump(record, sample)` is called with what a cell leads to. */
function drawMap(place, map, quantity, jump) {
  const key = QUANTITIES[quantity], values = map[key];
  const known = values.flat().filter((v) => v !== null && Number.isFinite(v));
  const most = Math.max(...known.map(Math.abs), 0) || 1;
  const [xs, ys] = map.edges;
  const across = xs.length - 1, up = ys.length - 1;
  const unit = quantity === "samples" ? "" : map.unit && ` ${map.unit}`;
  const cells = [];
  for (let j = up - 1; j >= 0; j--) {
    const row = make("div", { role: "row", class: "row" });
    for (let i = 0; i < across; i++) {
      const count = map.samples[i][j], v = values[i][j];
      const where = `${map.variables[0]} ${short(xs[i], 3)} to ${short(xs[i + 1], 3)}, `
        + `${map.variables[1]} ${short(ys[j], 3)} to ${short(ys[j + 1], 3)}`;
      const told = count ? `${where}: ${quantity} ${short(v, 3)}${unit}, ${count} samples`
        : `${where}: no sample`;
      const cell = make("button", {
        type: "button", role: "gridcell", tabindex: "-1", title: told, "aria-label": told,
        class: count === 0 ? "empty" : count < map.thin ? "thin" : "", "aria-disabled": count === 0,
        on: { click: () => count && jump(map.places[i][j]) },
      });
      if (count) cell.style.backgroundColor = shade(v / most, key === "bias");
      cells.push(cell);
      row.append(cell);
    }
    place.append(row);
  }
  cells[0].tabIndex = 0;
  place.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -across, ArrowDown: across }[event.key];
    const at = cells.indexOf(document.activeElement);
    if (by === undefined || at < 0) return;
    event.preventDefault();
    const next = cells[at + by];
    if (!next || (Math.abs(by) === 1 && Math.floor((at + by) / across) !== Math.floor(at / across))) return;
    cells[at].tabIndex = -1;
    next.tabIndex = 0;
    next.focus();
  });
  return [key === "bias" ? -most : 0, most];
}

/* The map of an output with its axes and scale. */
function mapOf(map, quantity, jump) {
  const grid = make("div", { role: "grid", class: "cells", "aria-label": `${quantity} of ${map.output}` });
  const [low, high] = drawMap(grid, map, quantity, jump);
  const [xs, ys] = map.edges;
  const text = (name, words) => {
    const span = make("span", { class: name });
    span.textContent = words;
    return span;
  };
  const scale = make("div", { class: "scale" });
  const bar = make("span", { class: "ramp" });
  const signed = quantity === "bias";
  const stops = [0, 0.25, 0.5, 0.75, 1].map((s) => shade(signed ? 2 * s - 1 : s, signed));
  bar.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  const unit = quantity === "samples" || !map.unit ? "" : ` ${map.unit}`;
  scale.append(text("", short(low, 3)), bar, text("", `${short(high, 3)}${unit}`));
  return make("div", { class: "map" },
    text("y-name", map.variables[1]),
    text("y-high", short(ys[ys.length - 1], 3)), text("y-low", short(ys[0], 3)), grid,
    text("x-low", short(xs[0], 3)), text("x-name", map.variables[0]),
    text("x-high", short(xs[xs.length - 1], 3)), scale);
}
