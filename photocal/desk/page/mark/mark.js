// Place Mark: points, the pictures of the point that is chosen, and marks, which the server keeps.

import { Refusal } from "../desk.js";
import { fill, h, said, styles } from "../dom.js";
import { markBar, markHelp } from "./bar.js";
import { keyOf, level } from "./level.js";
import { markLists } from "./lists.js";
import { markView } from "./view.js";

const POLL_MS = 4000;
const NUDGE_PX = 0.1;
// A click finds a target as near as this on the screen; in the picture between these.
const REACH_SCREEN_PX = 22;
const REACH_PX = [4, 60];
const NOTE_MS = { "": 3500, bad: 9000 };

export async function mount(element, context) {
  const { say } = context;
  await Promise.all([styles("/look/viewer.css"), styles("/mark/mark.css")]);
  try {
    return await show(element, context, await context.get("/api/mark/project"));
  } catch (refusal) {
    if (!(refusal instanceof Refusal)) throw refusal;
    const mend = context.state.steps.folder && h("a.button", { href: "#/folder" }, say("step.folder"));
    fill(element, h("div.empty", {}, h("h1", {}, say("mark.title")), said("warn", refusal.message), mend));
    return null;
  }
}

async function show(element, context, project) {
  const { say } = context;
  const state = { project, points: [...project.points], marks: new Map(), residuals: new Map(), sigma0: null, leftOut: [], point: "", ranked: [], source: "", at: 0, count: 1, snap: "any", lastSnap: "any" };
  const images = new Map(project.images.filter((own) => !own.reason).map((own) => [own.name, own]));
  const views = [];
  let work = Promise.resolve();
  let told = "";
  let noteTimer = 0;
  const acts = { adjust, addPoint, choosePoint: (...wanted) => choosePoint(...wanted).catch(ignore), go, remove, setCount, setSnap, step, stepImages: (by) => go(state.at + by * state.count), stepPoint };
  const shared = { ...context, state, images, acts };
  const help = markHelp(say);
  const bar = markBar(shared, help);
  const lists = markLists(shared);
  const banner = h("p.banner", { role: "alert", hidden: true });
  const host = h("div.views", { id: "views", role: "group", "aria-label": say("look.pictures") });
  const note = h("output.note", { hidden: true });
  const table = h("div.marking", {}, bar.element, banner, h("div.table", {}, lists.element, host), note, help);
  table.marking = { state, views };
  fill(element, h("h1.unseen", {}, say("mark.title")), table);
  if (project.line) context.command(project.line);
  setSnap(localStorage.getItem("snap") ?? "any");
  state.count = Number(localStorage.getItem("count")) || (innerWidth > 900 ? 4 : 1);
  await begin(context.parts ?? []);
  addEventListener("keydown", keys);
  const timer = setInterval(poll, POLL_MS);
  table.dataset.ready = "true";
  return { leave, route: ([point, image]) => known(point) && acts.choosePoint(point, image) };

  async function begin([point, image]) {
    take(await context.get("/api/mark/state"));
    const start = known(point) ?? state.points[0];
    if (start) await acts.choosePoint(start.name, start.name === point ? image : undefined);
    else state.ranked = (await context.get("/api/mark/images?point=")).images;
    setCount(state.count);
  }

  function known(name) {
    return state.points.find((own) => own.name === name);
  }

  function leave() {
    clearInterval(timer);
    removeEventListener("keydown", keys);
    for (const view of views) view.leave();
  }

  /** Ask the server; who cannot be reached is told in a banner, a refusal in a note. */
  async function ask(path, body) {
    try {
      const answer = await (body === undefined ? context.get(path) : context.post(path, body));
      lost("");
      return answer;
    } catch (refusal) {
      if (refusal.gone) lost(refusal.message === say("desk.gone") ? say("mark.gone") : refusal.message);
      else if (refusal instanceof Refusal) tell(refusal.message, "bad");
      throw refusal;
    }
  }

  function lost(text) {
    banner.textContent = text;
    banner.hidden = !text;
  }

  function tell(text, level = "") {
    note.textContent = text;
    note.dataset.level = level;
    note.hidden = !text;
    clearTimeout(noteTimer);
    noteTimer = setTimeout(() => (note.hidden = true), NOTE_MS[level]);
  }

  /** Changes one after the other: each sees the marks that the one before it left. */
  function change(path, make, then) {
    work = work
      .then(async () => {
        const body = make();
        if (!body) return;
        const answer = await ask(path, body);
        take(answer);
        await then?.(answer);
      })
      .catch(ignore);
    return work;
  }

  function take(answer) {
    const same = JSON.stringify(answer);
    if (same === told) return;
    told = same;
    state.marks = new Map(answer.marks.map((m) => [keyOf(m.image, m.point), m]));
    state.residuals = new Map(answer.residuals.map((r) => [keyOf(r.image, r.point), { ...r, level: level(r.in_sigmas) }]));
    state.sigma0 = answer.sigma0;
    bar.history(answer);
    const names = new Set(state.points.map((own) => own.name));
    for (const { point } of answer.marks) {
      if (names.has(point)) continue;
      names.add(point);
      state.points.push({ name: point, role: project.listed ? "unlisted" : "" });
    }
    render();
  }

  function show() {
    state.ranked = state.ranked.filter((own) => images.has(own.name));
    const first = Math.floor(state.at / state.count) * state.count;
    host.dataset.count = state.count;
    while (views.length < state.count) views.push(markView(host, shared, { chosen, pressed }));
    views.forEach((view, k) => view.show(k < state.count ? state.ranked[first + k] : undefined, k < state.count));
    render();
    const here = state.ranked[state.at]?.name ?? "";
    history.replaceState(null, "", `#/mark/${encodeURIComponent(state.point)}/${encodeURIComponent(here)}`);
  }

  function render() {
    const first = Math.floor(state.at / state.count) * state.count;
    views.forEach((view, k) => view.render(first + k === state.at && state.count > 1));
    bar.render();
    lists.render();
  }

  async function rank() {
    const answer = await ask(`/api/mark/images?point=${encodeURIComponent(state.point)}`);
    if (answer.point !== state.point) return false;
    [state.ranked, state.source] = [answer.images, answer.source];
    return true;
  }

  async function choosePoint(name, image) {
    if (name !== state.point) {
      state.point = name;
      if (!(await rank())) return;
      state.at = 0;
    }
    if (image) state.at = Math.max(state.ranked.findIndex((own) => own.name === image), 0);
    show();
    lists.follow();
    context.announce(say("look.chosen.point", { name }));
  }

  function go(at) {
    if (!state.ranked.length) return;
    state.at = Math.min(Math.max(at, 0), state.ranked.length - 1);
    show();
    lists.follow();
  }

  function stepPoint(by) {
    const next = state.points[state.points.findIndex((own) => own.name === state.point) + by];
    if (next) acts.choosePoint(next.name);
  }

  function active() {
    const view = views[state.at % state.count];
    return view?.image ? view : null;
  }

  function chosen(view) {
    const at = Math.floor(state.at / state.count) * state.count + views.indexOf(view);
    if (at !== state.at) go(at);
  }

  function pressed(view, x, y) {
    const { point, project, snap } = state;
    if (!point) return tell(say("mark.no-point"), "bad");
    const image = view.image.name;
    const kinds = snap === "none" ? [] : snap === "any" ? project.kinds : [snap];
    const reach = Math.min(Math.max(REACH_SCREEN_PX / view.scale(), REACH_PX[0]), REACH_PX[1]);
    change("/api/mark/mark", () => ({ image, point, x, y, reach, kinds }), (answer) => {
      if (kinds.length && answer.snapped === null) tell(say("mark.by-hand-there"));
    });
  }

  function nudge(dx, dy) {
    const view = active();
    if (!view) return;
    const [x, y] = view.turned(dx * NUDGE_PX, dy * NUDGE_PX);
    const image = view.image.name;
    const { point } = state;
    change("/api/mark/mark", () => {
      const mark = state.marks.get(keyOf(image, point));
      return mark && { image, point, x: mark.x + x, y: mark.y + y, kinds: [] };
    });
  }

  function remove(image) {
    const { point } = state;
    change("/api/mark/remove", () => state.marks.has(keyOf(image, point)) && { image, point });
  }

  function step(which) {
    change(`/api/mark/${which}`, () => ({}), async (answer) => {
      if (answer.at && images.has(answer.at.image)) await choosePoint(answer.at.point, answer.at.image);
    });
  }

  function addPoint(name) {
    if (!known(name)) state.points.push({ name, role: "" });
    acts.choosePoint(name);
  }

  function adjust() {
    if (!bar.adjusting(true)) return;
    change("/api/mark/adjust", () => ({}), async (answer) => {
      state.leftOut = answer.left_out;
      const n = answer.residuals.length;
      const suspects = [...state.residuals.values()].filter((r) => r.level !== "good").length;
      tell(suspects ? say("mark.adjusted-suspect", { n, suspects }) : say("mark.adjusted", { n }));
      const here = state.ranked[state.at]?.name;
      await rank();
      state.at = Math.max(state.ranked.findIndex((own) => own.name === here), 0);
      show();
      table.dataset.adjusted = Number(table.dataset.adjusted ?? 0) + 1;
    }).then(() => bar.adjusting(false));
  }

  function setSnap(kind) {
    if (kind !== "none") state.lastSnap = kind;
    state.snap = kind;
    localStorage.setItem("snap", kind);
    bar.render();
  }

  function setCount(count) {
    state.count = count;
    localStorage.setItem("count", count);
    show();
  }

  function keys(event) {
    if (help.open || event.altKey || event.target.closest?.("input, select, textarea")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const act = event.ctrlKey || event.metaKey ? past(key, event.shiftKey) : event.shiftKey && NUDGES[key] ? () => nudge(...NUDGES[key]) : KEYS[key];
    if (!act) return;
    event.preventDefault();
    act({ acts, active, help, state });
  }

  function past(key, back) {
    if (key === "z") return () => step(back ? "redo" : "undo");
    return key === "y" ? () => step("redo") : null;
  }

  async function poll() {
    if (document.hidden) return;
    await work;
    await ask("/api/mark/state").then(take, ignore);
  }
}

// What is wrong was said.
function ignore(failure) {
  if (!(failure instanceof Refusal)) throw failure;
}

const KEYS = {
  ArrowRight: ({ acts, state }) => acts.go(state.at + 1),
  ArrowLeft: ({ acts, state }) => acts.go(state.at - 1),
  ArrowDown: ({ acts }) => acts.stepPoint(1),
  ArrowUp: ({ acts }) => acts.stepPoint(-1),
  Delete: ({ acts, active }) => active() && acts.remove(active().image.name),
  "+": ({ active }) => active()?.zoom(1.5),
  "-": ({ active }) => active()?.zoom(1 / 1.5),
  m: ({ active }) => active()?.middle(),
  s: ({ acts, state }) => acts.setSnap(state.snap === "none" ? state.lastSnap : "none"),
  c: ({ active }) => active()?.home(),
  f: ({ active }) => active()?.whole(),
  r: ({ active }) => active()?.turn(),
  a: ({ acts }) => acts.adjust(),
  "?": ({ help }) => help.showModal(),
  1: ({ acts }) => acts.setCount(1),
  2: ({ acts }) => acts.setCount(2),
  4: ({ acts }) => acts.setCount(4),
  6: ({ acts }) => acts.setCount(6),
};
KEYS.Backspace = KEYS.Delete;
KEYS["="] = KEYS["+"];
const NUDGES = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowDown: [0, 1], ArrowUp: [0, -1] };
