// From numbers to values and to pictures. A plane here is an entry of facts.planes with its decoded `data`.

const LOST = [255, 0, 255];

// What a number of a plane stands for, in the units of the display for light; planes.py says the same the other way.
function valueOf(plane, number) {
  if (plane.dark === 0) return number * plane.step;
  return Math.sign(number) * Math.expm1(Math.abs(number) * plane.step) * plane.dark;
}

// {at: values of all numbers that occur, low: the least of them}: index with number - low.
function valuesOf(plane) {
  if (plane.table) return plane.table;
  let low = 0, high = 0;
  for (const channel of plane.data.channels)
    for (const number of channel) {
      if (number < low) low = number;
      else if (number > high) high = number;
    }
  const at = new Float64Array(high - low + 1);
  for (let i = 0; i < at.length; i++) at[i] = valueOf(plane, i + low);
  return (plane.table = { at, low });
}

// IEC 61966-2-1, as pictures.py has it.
function encoded(linear) {
  const x = Math.min(Math.max(linear, 0), 1);
  return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
}

// A scale of even steps in lightness from dark blue to light yellow, made in OKLab (Ottosson 2020): those who see no
// colours, or not all, see the same order.
function ramp(t) {
  const x = Math.min(Math.max(t, 0), 1);
  const L = 0.16 + 0.8 * x, a = -0.02 * Math.sin(Math.PI * x), b = -0.09 + 0.23 * x;
  const l = (L + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (L - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (L - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    encoded(4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s),
    encoded(-1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s),
    encoded(-0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s),
  ];
}
const RAMP = Array.from({ length: 256 }, (_, i) => ramp(i / 255));

// Where a value stands between the two ends of a logarithmic scale, 0 to 1.
function position(value, [least, most]) {
  return value > least ? Math.min(Math.log(value / least) / Math.log(most / least), 1) : 0;
}

function nearness(value, [near, far]) {
  return value > 0 ? 40 + 215 * Math.min(Math.max((far - value) / Math.max(far - near, 1e-30), 0), 1) : 0;
}

// The colour of one label at a place: a pattern on top tells labels apart without their colours.
const PATTERNS = [
  () => false,
  (x, y) => (x + y) % 6 < 1,
  (x, y) => y % 5 < 1,
  (x, y) => x % 4 < 1 && y % 4 < 1,
  (x, y) => (x - y + 6e6) % 8 < 1,
  (x) => x % 5 < 1,
];
function labelColor(plane, label, x, y) {
  const color = plane.colors[label % plane.colors.length];
  if (!PATTERNS[label % PATTERNS.length](x, y)) return color;
  const bright = color[0] + 2 * color[1] + color[2] > 420;
  return color.map((v) => (bright ? 0.6 * v : v + 0.45 * (255 - v)));
}

// Squared error over the squared reference + 0.01, as metrics.relmse_map has it, of every pixel.
function errorsOf(image, reference, count) {
  const errors = new Float32Array(count), mine = valuesOf(image), theirs = valuesOf(reference);
  for (let i = 0; i < count; i++) {
    let error = 0, power = 0;
    for (let c = 0; c < 3; c++) {
      const x = mine.at[image.data.channels[c][i] - mine.low];
      const r = theirs.at[reference.data.channels[c][i] - theirs.low];
      error += (x - r) ** 2;
      power += r * r;
    }
    errors[i] = error / 3 / (power / 3 + 0.01);
  }
  for (const plane of [image, reference])
    if (plane.data.marks) plane.data.marks.forEach((mark, i) => { if (mark) errors[i] = NaN; });
  return errors;
}

// For each number of a plane the bytes that show it: one table for colours, three for what has a colour scale.
function shades(plane, stops) {
  const { at } = valuesOf(plane);
  const gain = plane.kind === "light" ? 2 ** stops : 1;
  const shade = {
    light: (v) => encoded(v * gain),
    reflectance: (v) => encoded(v),
    normal: (v) => Math.round(127.5 * (v + 1)),
    depth: (v) => nearness(v / plane.scale, plane.range),
  }[plane.kind];
  if (shade) return [Uint8Array.from(at, shade)];
  const colors = Array.from(at, (v) => RAMP[Math.round(255 * position(v, plane.range))]);
  return [0, 1, 2].map((c) => Uint8Array.from(colors, (color) => color[c]));
}

// A canvas of the plane's size that shows it, `stops` brighter than it is where it is light.
function painted(plane, stops, width, height) {
  const picture = new ImageData(width, height), pixels = picture.data, count = width * height;
  if (plane.kind === "difference") {
    for (let i = 0; i < count; i++) {
      const value = plane.errors[i];
      const color = value === value ? RAMP[Math.round(255 * position(value, plane.range))] : LOST;
      for (let c = 0; c < 3; c++) pixels[4 * i + c] = color[c];
    }
  } else if (plane.kind === "labels") {
    for (let y = 0, i = 0; y < height; y++)
      for (let x = 0; x < width; x++, i++) {
        const color = labelColor(plane, plane.data.channels[0][i], x, y);
        for (let c = 0; c < 3; c++) pixels[4 * i + c] = color[c];
      }
  } else {
    const tables = shades(plane, stops), channels = plane.data.channels, low = valuesOf(plane).low;
    for (let c = 0; c < 3; c++) {
      const table = tables[c % tables.length], channel = channels[c % channels.length];
      for (let i = 0, at = c; i < count; i++, at += 4) pixels[at] = table[channel[i] - low];
    }
  }
  for (let i = 3; i < 4 * count; i += 4) pixels[i] = 255;
  markLost(plane, pixels, width);
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  canvas.getContext("2d").putImageData(picture, 0, 0);
  return canvas;
}

// What is no number is checked magenta and black; a depth without end is black, as nothing is there.
function markLost(plane, pixels, width) {
  if (!plane.data || !plane.data.marks) return;
  plane.data.marks.forEach((mark, i) => {
    if (!mark) return;
    const shown = (i + Math.floor(i / width)) % 2 && !(plane.kind === "depth" && mark === 2);
    for (let c = 0; c < 3; c++) pixels[4 * i + c] = shown ? LOST[c] : 0;
  });
}
