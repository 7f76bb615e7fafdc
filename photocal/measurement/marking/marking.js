// The page: points, the images of the point that is chosen, and marks, which the server keeps.
"use strict";

const POLL_MS = 4000;
const NUDGE_PX = 0.1;
// A click finds a target as near as this on the screen.
const REACH_SCREEN_PX = 22;
const REACH_PX = [4, 60];
const SUSPECT_SIGMAS = 2.5;
const WRONG_SIGMAS = 4;
// A point that is opened is shown this large, unless its ellipse is larger.
const START_SCALE = 3;

const $ = (id) => document.getElementById(id);
const state = {
  project: null,
  points: [],
  marks: new Map(), // "image\npoint" -> mark
  residuals: new Map(),
  point: "",
  ranked: [],
  at: 0,
  count: 1,
  snap: "any",
  lastSnap: "any",
};
const views = [];
let tiles = null;
let images = new Map();
let work = Promise.resolve();

const keyOf = (image, point) => `${image}\n${point}`;

async function ask(path, body) {
  const post = body === undefined ? {} : {
    method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body),
  };
  let answer;
  try {
    answer = await fetch(path, post);
  } catch {
    lost("The program that serves this page does not answer. Nothing is marked until it is back.");
    throw new Error("lost");
  }
  if (answer.status === 401) {
    lost("The program was started again: open the address that it printed.");
    throw new Error("lost");
  }
  lost("");
  const content = await answer.json();
  if (!answer.ok) {
    say(content.error, "bad");
    throw new Error(content.error);
  }
  return content;
}

function lost(text) {
  $("banner").textContent = text;
  $("banner").hidden = !text;
}

let noteTimer = 0;
function say(text, level = "") {
  $("note").textContent = text;
  $("note").dataset.level = level;
  $("note").hidden = !text;
  clearTimeout(noteTimer);
  noteTimer = setTimeout(() => { $("note").hidden = true; }, level === "bad" ? 9000 : 3500);
}

/** Changes one after the other: each sees the marks that the one before it left. */
function change(path, make, then) {
  work = work.then(async () => {
    const body = make();
    if (!body) return;
    const answer = await ask(path, body);
    take(answer);
    await then?.(answer);
  }).catch(() => {});
  return work;
}

function level(inSigmas) {
  if (inSigmas === null || inSigmas < SUSPECT_SIGMAS) return "good";
  return inSigmas < WRONG_SIGMAS ? "warn" : "bad";
}

function take(answer) {
  state.marks = new Map(answer.marks.map((m) => [keyOf(m.image, m.point), m]));
  state.residuals = new Map(answer.residuals.map((r) => [keyOf(r.image, r.point), { ...r, level: level(r.in_sigmas) }]));
  state.sigma0 = answer.sigma0;
  $("undo").disabled = !answer.undo;
  $("redo").disabled = !answer.redo;
  const known = new Set(state.points.map((p) => p.name));
  for (const mark of answer.marks) {
    if (!known.has(mark.point)) {
      known.add(mark.point);
      state.points.push({ name: mark.point, role: state.project.listed ? "not in the table" : "" });
    }
  }
  render();
}

function show() {
  state.ranked = state.ranked.filter((own) => images.has(own.name));
  const first = Math.floor(state.at / state.count) * state.count;
  $("views").dataset.count = String(state.count);
  while (views.length < state.count) {
    views.push(new View($("views"), tiles, { chosen, pressed, removed: (view) => remove(view.image.name) }));
  }
  views.forEach((view, k) => {
    const own = k < state.count ? state.ranked[first + k] : undefined;
    view.element.hidden = k >= state.count;
    view.element.dataset.empty = String(!own);
    if (!own) {
      view.image = null;
      return;
    }
    const fresh = view.image?.name !== own.name || view.point !== state.point;
    if (view.image?.name !== own.name) view.show(images.get(own.name));
    view.point = state.point;
    view.shown.prediction = own;
    if (fresh) requestAnimationFrame(() => home(view));
  });
  render();
  remember();
}

/** Look at the mark, else where it should be, else at the whole image. */
function home(view) {
  if (!view.image) return;
  const mark = state.marks.get(keyOf(view.image.name, state.point));
  const seen = view.shown.prediction;
  const size = Math.min(view.width, view.height);
  if (mark) view.centre(mark.x, mark.y, Math.max(START_SCALE, 1));
  else if (seen && seen.probability > 0.01 && seen.x !== null) {
    const reach = seen.ellipse ? seen.ellipse.major : 0.1 * Math.min(view.image.width, view.image.height);
    view.centre(seen.x, seen.y, Math.min(START_SCALE, 0.4 * size / Math.max(reach, 1)));
    view.keepInside();
  } else view.fit();
}

function render() {
  const first = Math.floor(state.at / state.count) * state.count;
  views.forEach((view, k) => {
    if (!view.image) return;
    const key = keyOf(view.image.name, state.point);
    const mark = state.marks.get(key);
    const residual = state.residuals.get(key);
    view.shown.mark = mark;
    view.shown.residual = residual;
    view.shown.others = [...state.marks.values()].filter((m) => m.image === view.image.name && m.point !== state.point);
    view.element.dataset.active = String(first + k === state.at && state.count > 1);
    view.remove.hidden = !mark;
    const said = describe(view, mark, residual);
    view.said.textContent = said.text;
    view.said.title = said.text;
    view.said.dataset.level = said.level;
    view.draw();
  });
  renderLists();
}

function describe(view, mark, residual) {
  if (!mark) {
    const seen = view.shown.prediction;
    if (seen?.probability === undefined) return { text: "not marked", level: "" };
    if (seen.probability < 0.01) return { text: "not in this image", level: "" };
    return { text: `not marked; in the image: ${Math.round(100 * seen.probability)} %`, level: "" };
  }
  const byHand = isByHand(mark);
  const sigma = byHand ? "by hand" : `\u00b1 ${Math.hypot(mark.sx, mark.sy).toFixed(2)} px`;
  const place = `${mark.x.toFixed(2)}, ${mark.y.toFixed(2)}`;
  if (!residual) return { text: `${place}  ${byHand ? sigma : `centre ${sigma}`}`, level: byHand ? "warn" : "good" };
  const size = Math.hypot(residual.vx, residual.vy).toFixed(2);
  const tested = residual.in_sigmas === null ? "not checked" : `${residual.in_sigmas.toFixed(1)} \u03c3`;
  return { text: `residual ${size} px, ${tested}; ${place} ${sigma}`, level: residual.level };
}

const isByHand = (mark) => mark.sx === state.project.by_hand_px && mark.sy === state.project.by_hand_px;

function entry(text, more, press) {
  const item = document.createElement("li");
  const button = document.createElement("button");
  button.type = "button";
  const [left, right] = [document.createElement("span"), document.createElement("span")];
  left.textContent = text;
  left.title = text;
  right.textContent = more;
  button.append(left, right);
  button.onclick = press;
  item.append(button);
  return item;
}

function worst(residuals) {
  return residuals.reduce((most, r) => Math.max(most, r.in_sigmas ?? 0), 0);
}

function renderLists() {
  const marked = [...state.marks.values()];
  const residuals = [...state.residuals.values()];
  const counts = new Map();
  for (const mark of marked) counts.set(mark.point, (counts.get(mark.point) ?? 0) + 1);
  $("point").textContent = state.point || "no point";
  $("point").title = state.point;
  $("place").textContent = state.ranked.length ? `${state.at + 1} / ${state.ranked.length}` : "";
  $("points-count").textContent = `${counts.size} of ${state.points.length} marked`;
  $("points").replaceChildren(...state.points.map((own) => {
    const n = counts.get(own.name) ?? 0;
    const item = entry(own.name, `${own.role && own.role !== "control" ? `${own.role}, ` : ""}${n ? `${n} \u00d7` : "\u2013"}`, () => {
      choosePoint(own.name);
      closePanel();
    });
    item.ariaCurrent = String(own.name === state.point);
    item.dataset.marked = String(n > 0);
    const most = worst(residuals.filter((r) => r.point === own.name));
    item.dataset.level = level(most);
    return item;
  }));
  $("images").replaceChildren(...state.ranked.map((own, k) => {
    const residual = state.residuals.get(keyOf(own.name, state.point));
    let more = own.probability === undefined ? "" : `${Math.round(100 * own.probability)} %`;
    if (residual) more = `${Math.hypot(residual.vx, residual.vy).toFixed(2)} px`;
    const item = entry(own.name, more, () => {
      go(k);
      closePanel();
    });
    item.ariaCurrent = String(k === state.at);
    item.dataset.marked = String(state.marks.has(keyOf(own.name, state.point)));
    if (residual) item.dataset.level = residual.level;
    return item;
  }));
  $("residuals-section").hidden = !residuals.length;
  $("sigma0").textContent = state.sigma0 ? `\u03c30 ${state.sigma0.toFixed(2)}` : "";
  const order = residuals.toSorted((a, b) => (b.in_sigmas ?? 0) - (a.in_sigmas ?? 0)).slice(0, 12);
  $("residuals").replaceChildren(...order.map((r) => {
    const said = r.in_sigmas === null ? "unchecked" : `${r.in_sigmas.toFixed(1)} \u03c3`;
    const item = entry(`${r.point} in ${r.image}`, `${Math.hypot(r.vx, r.vy).toFixed(2)} px, ${said}`, () => {
      choosePoint(r.point, r.image);
      closePanel();
    });
    item.dataset.level = r.level;
    return item;
  }));
}

async function choosePoint(name, image) {
  if (name !== state.point) {
    state.point = name;
    const answer = await ask(`/images?point=${encodeURIComponent(name)}`);
    if (answer.point !== state.point) return;
    state.ranked = answer.images;
    $("images-source").textContent = answer.source && `by ${answer.source}`;
    state.at = 0;
  }
  if (image !== undefined) state.at = Math.max(state.ranked.findIndex((own) => own.name === image), 0);
  show();
  document.querySelector("#points [aria-current=true]")?.scrollIntoView({ block: "nearest" });
}

function go(at) {
  if (!state.ranked.length) return;
  state.at = Math.min(Math.max(at, 0), state.ranked.length - 1);
  show();
  document.querySelector("#images [aria-current=true]")?.scrollIntoView({ block: "nearest" });
}

function stepPoint(by) {
  const k = state.points.findIndex((own) => own.name === state.point) + by;
  if (k >= 0 && k < state.points.length) choosePoint(state.points[k].name);
}

const active = () => views[state.at % state.count];

function chosen(view) {
  const first = Math.floor(state.at / state.count) * state.count;
  const at = first + views.indexOf(view);
  if (at !== state.at) go(at);
}

function pressed(view, x, y) {
  if (!state.point) {
    say("Choose or add a point first.", "bad");
    return;
  }
  const { image } = view;
  const point = state.point;
  const kinds = state.snap === "none" ? [] : state.snap === "any" ? state.project.kinds : [state.snap];
  const reach = Math.min(Math.max(REACH_SCREEN_PX / view.scale, REACH_PX[0]), REACH_PX[1]);
  change("/mark", () => ({ image: image.name, point, x, y, reach, kinds }), (answer) => {
    if (kinds.length && answer.snapped === null) say("No target found there: the mark stays where you put it, by hand.");
  });
}

function nudge(dx, dy) {
  const view = active();
  if (!view?.image) return;
  const [x, y] = view.turned(dx * NUDGE_PX, dy * NUDGE_PX, -view.turn);
  const image = view.image.name;
  const point = state.point;
  change("/mark", () => {
    const mark = state.marks.get(keyOf(image, point));
    return mark && { image, point, x: mark.x + x, y: mark.y + y, kinds: [] };
  });
}

function remove(image) {
  const point = state.point;
  change("/remove", () => state.marks.has(keyOf(image, point)) && { image, point });
}

function step(path) {
  change(path, () => ({}), async (answer) => {
    if (answer.at && images.has(answer.at.image)) await choosePoint(answer.at.point, answer.at.image);
  });
}

function adjust() {
  if ($("adjust").disabled) return;
  $("adjust").disabled = true;
  $("adjust").textContent = "Adjusting\u2026";
  change("/adjust", () => ({}), async (answer) => {
    $("left-out").textContent = answer.left_out.join("; ");
    const found = answer.residuals.length;
    const suspects = [...state.residuals.values()].filter((r) => r.level !== "good").length;
    say(suspects ? `${found} marks adjusted, ${suspects} suspect: correct the first of the list, then adjust again`
      : `${found} marks adjusted, none suspect`);
    const here = state.ranked[state.at]?.name;
    const ranked = await ask(`/images?point=${encodeURIComponent(state.point)}`);
    state.ranked = ranked.images;
    $("images-source").textContent = ranked.source && `by ${ranked.source}`;
    state.at = Math.max(state.ranked.findIndex((own) => own.name === here), 0);
    show();
    document.body.dataset.adjusted = String(Number(document.body.dataset.adjusted ?? 0) + 1);
  }).then(() => {
    $("adjust").textContent = "Adjust";
    $("adjust").disabled = !state.project.adjustable;
  });
}

function setSnap(kind) {
  if (kind !== "none") state.lastSnap = kind;
  state.snap = kind;
  $("snap").value = kind;
  localStorage.setItem("snap", kind);
}

function setCount(count) {
  state.count = count;
  localStorage.setItem("count", String(count));
  for (const button of document.querySelectorAll("[data-count][type=button]")) {
    button.ariaPressed = String(Number(button.dataset.count) === count);
  }
  show();
}

function remember() {
  const here = state.ranked[state.at]?.name ?? "";
  history.replaceState(null, "", `#${encodeURIComponent(state.point)}/${encodeURIComponent(here)}`);
}

function remembered() {
  return location.hash.slice(1).split("/").map((part) => {
    try {
      return decodeURIComponent(part);
    } catch {
      return "";
    }
  });
}

function closePanel() {
  document.body.dataset.panel = "";
  $("panel-button").ariaExpanded = "false";
}

const KEYS = {
  ArrowRight: () => go(state.at + 1),
  ArrowLeft: () => go(state.at - 1),
  ArrowDown: () => stepPoint(1),
  ArrowUp: () => stepPoint(-1),
  Delete: () => active()?.image && remove(active().image.name),
  Backspace: () => active()?.image && remove(active().image.name),
  "+": () => active()?.zoom(1.5),
  "=": () => active()?.zoom(1.5),
  "-": () => active()?.zoom(1 / 1.5),
  m: () => active()?.press([active().width / 2, active().height / 2]),
  s: () => setSnap(state.snap === "none" ? state.lastSnap : "none"),
  c: () => home(active()),
  f: () => active()?.fit(),
  r: () => {
    active().turn = (active().turn + 1) % 4;
    active().draw();
  },
  a: adjust,
  "?": () => $("help").showModal(),
  1: () => setCount(1),
  2: () => setCount(2),
  4: () => setCount(4),
  6: () => setCount(6),
};
const NUDGES = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowDown: [0, 1], ArrowUp: [0, -1] };

document.addEventListener("keydown", (event) => {
  if ($("help").open || event.target.matches("input, select") || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  let act = null;
  if (event.ctrlKey || event.metaKey) {
    if (key === "z") act = () => step(event.shiftKey ? "/redo" : "/undo");
    else if (key === "y") act = () => step("/redo");
  } else if (event.shiftKey && NUDGES[key]) act = () => nudge(...NUDGES[key]);
  else act = KEYS[key];
  if (!act) return;
  event.preventDefault();
  act();
});

function listen() {
  $("undo").onclick = () => step("/undo");
  $("redo").onclick = () => step("/redo");
  $("adjust").onclick = adjust;
  $("point-before").onclick = () => stepPoint(-1);
  $("point-after").onclick = () => stepPoint(1);
  $("image-before").onclick = () => go(state.at - state.count);
  $("image-after").onclick = () => go(state.at + state.count);
  $("snap").onchange = (event) => {
    setSnap(event.target.value);
    event.target.blur();
  };
  $("help-button").onclick = () => $("help").showModal();
  $("panel-button").onclick = () => {
    const open = document.body.dataset.panel !== "open";
    document.body.dataset.panel = open ? "open" : "";
    $("panel-button").ariaExpanded = String(open);
  };
  for (const button of document.querySelectorAll("[data-count][type=button]")) {
    button.onclick = () => setCount(Number(button.dataset.count));
  }
  $("new-point").onsubmit = (event) => {
    event.preventDefault();
    const name = $("new-name").value.trim();
    if (!name) return;
    if (!state.points.some((own) => own.name === name)) state.points.push({ name, role: "" });
    $("new-name").value = "";
    $("new-name").blur();
    choosePoint(name);
  };
}

async function poll() {
  if (document.hidden) return;
  await work;
  try {
    take(await ask("/state"));
  } catch {
    // What is wrong was said.
  }
}

async function begin() {
  listen();
  state.project = await ask("/project");
  document.title = `${state.project.name} \u2013 marking`;
  images = new Map(state.project.images.filter((own) => !own.reason).map((own) => [own.name, own]));
  tiles = new Tiles(state.project.tile_px, (image) => {
    for (const view of views) if (view.image?.name === image) view.draw();
  });
  state.points = state.project.points;
  $("new-point").hidden = state.project.listed;
  $("adjust").disabled = !state.project.adjustable;
  $("adjust").title = state.project.adjustable ? $("adjust").title
    : "needs a camera and control points: a project, or --run and --points";
  setSnap(localStorage.getItem("snap") ?? "any");
  const wide = window.innerWidth > 900;
  state.count = Number(localStorage.getItem("count")) || (wide ? 4 : 1);
  take(await ask("/state"));
  const [point, image] = remembered();
  const start = state.points.find((own) => own.name === point) ?? state.points[0];
  await choosePoint(start?.name ?? "", start && image ? image : undefined).catch(() => {});
  if (!start) {
    state.ranked = (await ask("/images?point=")).images;
  }
  setCount(state.count);
  setInterval(poll, POLL_MS);
  document.body.dataset.ready = "true";
}

begin().catch((failure) => say(failure.message, "bad"));
