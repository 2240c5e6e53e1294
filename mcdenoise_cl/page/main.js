// The page: which images, which exposure, and the controls for both.

const $ = (id) => document.getElementById(id);
const facts = JSON.parse($("facts").textContent);
const { width, height } = facts;
const planes = facts.planes.map((plane, index) => ({ ...plane, index }));
const named = (name) => planes.find((plane) => plane.name === name);
for (const name of facts.judged)
  planes.push({ name: `error of ${name}`, kind: "difference", of: name, range: [1e-4, 1], scale: 1 });

const lights = planes.filter((plane) => plane.kind === "light");
const result = lights.filter((plane) => plane.name !== facts.reference).at(-1);
const state = { left: lights[0].name, right: result.name, stops: 0 };
const pictures = new Map();
const view = new View($("canvas"), $("divider"), width, height, schedule, pointed);
$("view").style.setProperty("--ratio", `${width} / ${height}`);

async function load(plane) {
  if (plane.kind === "difference") {
    await Promise.all([load(named(plane.of)), load(named(facts.reference))]);
    plane.errors ??= errorsOf(named(plane.of), named(facts.reference), width * height);
    return;
  }
  plane.loading ??= decoded($(`plane-${plane.index}`).textContent, plane.channels, width, height).then((data) => {
    plane.data = data;
    $(`plane-${plane.index}`).remove();
  });
  await plane.loading;
}

// A picture of a plane as it is shown now; a few are kept.
function picture(plane) {
  if (!plane.data && !plane.errors) return null;
  const key = plane.kind === "light" ? `${state.stops} ${plane.name}` : plane.name;
  const found = pictures.get(key) || painted(plane, state.stops, width, height);
  pictures.delete(key);
  pictures.set(key, found);
  if (pictures.size > 8) pictures.delete(pictures.keys().next().value);
  return found;
}

let scheduled = false;
function schedule() {
  if (!scheduled) requestAnimationFrame(show);
  scheduled = true;
}

function show() {
  scheduled = false;
  view.images = [picture(named(state.left)), picture(named(state.right))];
  view.draw();
  const percent = Math.round(100 * view.split);
  $("divider").setAttribute("aria-valuenow", percent);
  $("divider").setAttribute("aria-valuetext", `${percent} % ${state.left}, ${100 - percent} % ${state.right}`);
  $("zoom").textContent = `${Math.round(100 * view.zoom)} %`;
  $("stops").textContent = `${state.stops > 0 ? "+" : ""}${state.stops} stops`.replace("-", "−");
  $("exposure").setAttribute("aria-valuetext", `${state.stops} stops`);
  $("exposure").value = state.stops;
  $("left").value = $("tag-left").textContent = state.left;
  $("right").value = $("tag-right").textContent = state.right;
  $("canvas").setAttribute("aria-label", `${state.left} on the left, ${state.right} on the right`);
  remember();
}

async function choose(side, name) {
  if (!named(name)) return;
  state[side] = name;
  showLegends($("legends"), [named(state.left), named(state.right)]);
  schedule();
  await load(named(name));
  schedule();
}

function swap() {
  const { left, right } = state;
  choose("left", right);
  choose("right", left);
}

function expose(stops) {
  state.stops = Math.min(Math.max(stops, -8), 8);
  if (view.probe) pointed(...view.probe);
  schedule();
}

function pointed(x, y) {
  showProbe($("probe"), planes, x, y, width, facts.marks, state.stops);
}

// The view in the address, a moment after the last change.
let timer = 0, written_hash = "";
function remember() {
  clearTimeout(timer);
  timer = setTimeout(() => {
    const parts = new URLSearchParams({ left: state.left, right: state.right, stops: state.stops });
    parts.set("split", view.split.toFixed(2));
    if (!view.fitted)
      for (const [key, digits] of [["zoom", 3], ["x", 1], ["y", 1]]) parts.set(key, view[key].toFixed(digits));
    written_hash = `#${parts}`;
    try {
      history.replaceState(null, "", written_hash);
    } catch { /* some browsers allow it no page from disk; then there is no address to share either */ }
  }, 250);
}

function recall() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const number = (key, otherwise) => (Number.isFinite(parseFloat(parts.get(key))) ? parseFloat(parts.get(key)) : otherwise);
  state.stops = Math.min(Math.max(number("stops", state.stops), -8), 8);
  view.split = Math.min(Math.max(number("split", view.split), 0), 1);
  if (parts.has("zoom")) {
    view.x = number("x", view.x);
    view.y = number("y", view.y);
    view.fitted = false;
    view.zoom = Math.min(Math.max(number("zoom", 1), 0.01), 64);
  }
  return Promise.all(["left", "right"].map((side) => choose(side, parts.get(side) || state[side])));
}

function fill(select) {
  const groups = [
    ["Images", (plane) => plane.kind === "light"],
    ["Errors", (plane) => plane.kind === "difference"],
    ["Maps", (plane) => plane.kind === "error" || plane.kind === "labels"],
    ["Features", (plane) => ["reflectance", "normal", "depth"].includes(plane.kind)],
  ];
  for (const [title, belongs] of groups) {
    const members = planes.filter(belongs);
    if (!members.length) continue;
    const group = made("optgroup", undefined, select);
    group.label = title;
    for (const plane of members) made("option", plane.name, group).value = plane.name;
  }
}

function next(way) {
  choose("right", planes[(planes.indexOf(named(state.right)) + way + planes.length) % planes.length].name);
}

const KEYS = {
  "+": () => view.magnify(view.zoom * Math.SQRT2), "=": () => view.magnify(view.zoom * Math.SQRT2),
  "-": () => view.magnify(view.zoom / Math.SQRT2), 0: () => view.fit(), 1: () => view.magnify(1),
  x: swap, X: swap, "[": () => next(-1), "]": () => next(1),
  ",": () => expose(state.stops - 0.25), ".": () => expose(state.stops + 0.25),
};
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function listen() {
  for (const side of ["left", "right"]) {
    fill($(side));
    $(side).addEventListener("change", (event) => choose(side, event.target.value));
  }
  $("swap").addEventListener("click", swap);
  $("exposure").addEventListener("input", (event) => expose(Number(event.target.value)));
  $("unexposed").addEventListener("click", () => expose(0));
  $("in").addEventListener("click", KEYS["+"]);
  $("out").addEventListener("click", KEYS["-"]);
  $("fit").addEventListener("click", KEYS[0]);
  $("one").addEventListener("click", KEYS[1]);
  $("view").addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const way = WAYS[event.key], key = KEYS[event.key];
    if (way && event.shiftKey) view.step(...way);
    else if (way) view.move((way[0] * view.canvas.width) / 10, (way[1] * view.canvas.height) / 10);
    else if (key) key();
    else return;
    event.preventDefault();
  });
  window.addEventListener("hashchange", () => {
    if (location.hash !== written_hash) recall();
  });
}

async function start() {
  listen();
  await recall();
  $("status").textContent = "";
  for (const plane of planes) {
    await load(plane);
    await new Promise((done) => setTimeout(done));  // the page answers in between
  }
  view.pointAt(Math.floor(width / 2), Math.floor(height / 2));
  document.documentElement.dataset.ready = "yes";
}

start().catch((error) => {
  const old = typeof DecompressionStream === "undefined";
  $("status").textContent = old
    ? "This browser is too old for the images of this page: it needs Chrome 80, Firefox 113, Safari 16.4, or newer."
    : `The images of this page cannot be read (${error.message || error}): the file is damaged, so make it again.`;
});
