// What stands beside the images: the values of the pixel that is pointed at, and what the colours of a map mean.

const SMALL = 1e-3, LARGE = 1e6;

function made(tag, text, parent) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}

function written(value) {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size < SMALL || size >= LARGE) return value.toExponential(2);
  return size >= 100 ? String(Math.round(value)) : value.toPrecision(3);
}

// The values of a plane at pixel number i as texts: in the units of the file.
function valuesAt(plane, i, marks) {
  if (plane.kind === "difference") return plane.errors ? [written(plane.errors[i])] : ["…"];
  if (!plane.data) return ["…"];
  const mark = plane.data.marks ? plane.data.marks[i] : 0;
  if (mark) return [marks[mark]];
  const numbers = plane.data.channels.map((channel) => channel[i]);
  if (plane.kind === "labels") return [plane.labels[numbers[0]]];
  return numbers.map((number) => written(valueOf(plane, number) / plane.scale));
}

function showProbe(element, planes, x, y, width, marks, stops) {
  const table = document.createElement("table"), i = y * width + x;
  const judged = planes.filter((plane) => plane.kind === "difference");
  if (judged.length) {
    const head = made("tr", undefined, table);
    made("td", undefined, head).colSpan = 5;
    made("th", "error", head).scope = "col";
  }
  for (const plane of planes.filter((plane) => plane.kind !== "difference")) {
    const row = made("tr", undefined, table), name = made("th", plane.name, row);
    name.scope = "row";
    const values = valuesAt(plane, i, marks);
    for (const value of values) made("td", value, row).colSpan = values.length === 1 ? 3 : 1;
    const swatch = made("td", undefined, row);
    if (plane.kind === "light" && plane.data) {
      const linear = plane.data.channels.map((channel) => encoded(valueOf(plane, channel[i]) * 2 ** stops));
      made("i", undefined, swatch).style.background = `rgb(${linear.join(" ")})`;
    }
    const error = judged.find((other) => other.of === plane.name);
    if (judged.length) made("td", error ? valuesAt(error, i, marks)[0] : "", row);
  }
  const title = document.createElement("h3");
  title.textContent = `Pixel ${x}, ${y}`;
  element.replaceChildren(title, table);
}

function strip(parent, color) {
  const canvas = made("canvas", undefined, parent), context = canvas.getContext("2d");
  canvas.width = 256;
  canvas.height = 1;
  for (let x = 0; x < 256; x++) {
    context.fillStyle = `rgb(${color(x / 255).join(" ")})`;
    context.fillRect(x, 0, 1, 1);
  }
  canvas.setAttribute("aria-hidden", "true");
}

function ticks(parent, texts) {
  const line = made("div", undefined, parent);
  line.className = "ticks";
  for (const text of texts) made("span", text, line);
}

const LEGENDS = {
  error: errorLegend,
  difference: errorLegend,
  labels(plane, parent) {
    const list = made("ul", undefined, parent);
    plane.labels.forEach((label, k) => {
      const line = made("li", undefined, list), canvas = made("canvas", undefined, line);
      const context = canvas.getContext("2d");
      canvas.width = 16;
      canvas.height = 9;
      for (let y = 0; y < 9; y++)
        for (let x = 0; x < 16; x++) {
          context.fillStyle = `rgb(${labelColor(plane, k, x, y).join(" ")})`;
          context.fillRect(x, y, 1, 1);
        }
      canvas.style.imageRendering = "pixelated";
      canvas.setAttribute("aria-hidden", "true");
      const share = plane.shares && plane.shares[k];
      made("span", share == null ? label : `${label}, ${Math.round(100 * share)} % of the result`, line);
    });
    made("div", "Which candidate does most, pixel by pixel.", parent);
  },
  depth(plane, parent) {
    strip(parent, (t) => Array(3).fill(255 - 215 * t));
    ticks(parent, [`near, ${written(plane.range[0])}`, `far, ${written(plane.range[1])}`]);
  },
  normal(plane, parent) {
    made("div", "x, y, z from −1 to 1 as red, green, blue from 0 to 255.", parent);
  },
};

function errorLegend(plane, parent) {
  strip(parent, ramp);
  const [least, most] = plane.range, decades = Math.round(Math.log10(most / least));
  ticks(parent, Array.from({ length: decades + 1 }, (_, i) => String(Number((least * 10 ** i).toPrecision(1)))));
  made("div", plane.kind === "error" ? "Relative squared error as the method estimates it." :
    "Squared error over the squared reference + 0.01.", parent);
}

// The legends of both sides, one of each kind.
function showLegends(element, planes) {
  element.replaceChildren();
  const told = new Set();
  for (const plane of planes) {
    const key = plane.kind === "difference" || plane.kind === "error" ? plane.kind : plane.name;
    if (!LEGENDS[plane.kind] || told.has(key)) continue;
    told.add(key);
    const part = made("div", undefined, element);
    part.className = "legend";
    made("h3", plane.name, part);
    LEGENDS[plane.kind](plane, part);
  }
}
