// The window: rail of steps, routes in the hash, texts in two languages, and the command line of each action.

import { fill, h, said, sign } from "./dom.js";

// Each step is a module with mount(element, context); it may return { leave() } and { route(parts) }.
const STEPS = ["folder", "check", "run", "look", "certificate"];
const BESIDE = { mark: "✛", record: "●" };
const PLACES = [...STEPS, ...Object.keys(BESIDE)];
const MODULES = Object.fromEntries(PLACES.map((name) => [name, `./steps/${name}.js`]));
for (const name of ["look", "mark"]) MODULES[name] = `./${name}/${name}.js`;
const LANGUAGES = ["en", "pt-BR"];
// What concerns no folder, or opens one.
const ANYWHERE = new Set(["/api/open", "/api/language"]);

const texts = {};
let language = chosenLanguage();
let state = { steps: {} };
let shown = { name: "", mounted: null };
// Whether this window has asked for another folder, until it knows how that stands.
let opening = false;

function chosenLanguage() {
  const kept = localStorage.getItem("language");
  const wanted = kept ?? navigator.language ?? "en";
  return wanted.toLowerCase().startsWith("pt") ? "pt-BR" : "en";
}

/** Text of the catalogue with its values put in; a key that is not there shows itself. */
export function say(key, values = {}) {
  const text = texts[key]?.[LANGUAGES.indexOf(language)] ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name) => values[name] ?? whole);
}

/** A refusal of the server, in the words of the command line; `gone` where it cannot be asked any more. */
export class Refusal extends Error {
  constructor(message, gone = false) {
    super(message);
    this.gone = gone;
  }
}

// What no step has caught stands where the command line stands; that nobody answers is told by the window.
addEventListener("unhandledrejection", (event) => {
  if (!(event.reason instanceof Refusal)) return;
  event.preventDefault();
  fill(document.getElementById("command"), h("span", { role: "alert" }, event.reason.message));
});

// The connection may end before an answer begins, and in the middle of it.
async function reached(asked, read) {
  try {
    const answer = await asked;
    const value = await read(answer);
    offline(false);
    return [answer, value];
  } catch {
    offline(true);
    throw new Refusal(say("desk.gone"), true);
  }
}

async function answered(asked) {
  const json = (answer) => ((answer.headers.get("content-type") ?? "").startsWith("application/json") ? answer.json() : {});
  const [answer, value] = await reached(asked, json);
  if (answer.status === 401) throw new Refusal(say("desk.token"), true);
  if (!answer.ok) throw new Refusal(value.error ?? `${answer.status}`);
  return value;
}

// The window asks for itself; each place asks through a context of its own, which ends when one leaves it.
const context = contextOf(() => true);

/** What a place is given; `here` tells whether it is still the one that is shown. */
function contextOf(here) {
  // What comes after one has left goes nowhere: neither drawn into another place nor told as its error.
  const kept = (asked) => new Promise((done, failed) => asked.then((value) => here() && done(value), (failure) => here() && failed(failure)));
  return {
    say,
    /** Ask the server; the answer as JSON. Throws Refusal. */
    get: (path) => kept(answered(fetch(path))),
    /** Ask the server for an array of bytes. Throws Refusal. */
    bytes: (path) => kept(bytesOf(path)),
    /** Have the server do something; the answer as JSON. Throws Refusal. */
    post(path, value = {}) {
      // What is meant for one folder is never done in another, which a second window may have opened.
      const meant = ANYWHERE.has(path) || !state.folder ? {} : { "photocal-folder": encodeURIComponent(state.folder) };
      opening ||= path === "/api/open";
      const asked = answered(fetch(path, { method: "POST", headers: { "content-type": "application/json", ...meant }, body: JSON.stringify(value) }));
      // What was begun before one left changes how the steps stand all the same.
      asked.finally(() => here() || renew()).catch(() => {});
      return kept(asked);
    },
    /** Go to another place, as "#/look/point/P1". */
    go(hash) {
      location.hash = hash;
    },
    /** Show the command line that does the same. */
    command(line) {
      if (!here()) return;
      fill(
        document.getElementById("command"),
        h("span.label", {}, say("desk.command")),
        // It may be longer than the bar: keys move it, too.
        h("code", { tabindex: 0 }, line),
        h("button.small", { type: "button", onclick: () => copy(line) }, say("desk.copy")),
      );
    },
    /** Tell readers of the screen. */
    announce(text) {
      document.getElementById("announced").textContent = text;
    },
    /** Ask anew how the steps stand. */
    renew: () => kept(renew()),
    get language() {
      return language;
    },
    get state() {
      return state;
    },
  };
}

async function renew() {
  const before = state.folder;
  state = await answered(fetch("/api/desk"));
  rail();
  // Another folder is open, here or by a second window: what is shown belongs to the one before.
  if (shown.name && before !== state.folder) {
    const told = opening ? [] : [said("warn", h("p", { role: "alert" }, say("desk.other", { name: state.title ?? "" })))];
    route(true).then(() => document.getElementById("step").prepend(...told)).catch(() => {});
  }
  opening = false;
  return state;
}

async function bytesOf(path) {
  const [answer, bytes] = await reached(fetch(path), (answer) => answer.arrayBuffer());
  if (!answer.ok) throw new Refusal(`${answer.status}`);
  return bytes;
}

async function copy(line) {
  try {
    await navigator.clipboard.writeText(line);
    context.announce(say("desk.copied"));
  } catch {
    const range = document.createRange();
    range.selectNodeContents(document.querySelector("#command code"));
    getSelection().removeAllRanges();
    getSelection().addRange(range);
  }
}

function offline(gone) {
  document.body.classList.toggle("gone", gone);
}

function rail() {
  const here = place().name;
  document.documentElement.lang = language;
  document.title = state.folder ? `${state.title ?? ""} · photocal` : "photocal";
  document.getElementById("skip").textContent = say("desk.skip");
  const link = (name, number) => {
    const stands = state.steps?.[name] ?? { state: "none", word: "" };
    return h(
      "a.step",
      { href: `#/${name}`, "aria-current": name === here ? "step" : null },
      h("span.number", { "aria-hidden": "true" }, number),
      h("span.name", {}, say(`step.${name}`)),
      // What is no step has nothing to come.
      (stands.word || !BESIDE[name]) && sign(stands.state, stands.word ? say(stands.word) : ""),
    );
  };
  const rail = document.getElementById("rail");
  // Who goes by keys stays where they are: the link that had the focus is another one afterwards.
  const focused = rail.contains(document.activeElement) ? document.activeElement.getAttribute("href") : undefined;
  rail.setAttribute("aria-label", say("desk.steps"));
  fill(
    rail,
    h("div.title", {}, h("b", {}, "photocal"), h("span", { title: state.root }, state.title ?? "")),
    STEPS.filter(open).map((name, k) => link(name, `${k + 1}`)),
    h("div.rest", {}, Object.keys(BESIDE).filter(open).map((name) => link(name, BESIDE[name]))),
    h(
      "button.small.language",
      { type: "button", lang: language === "en" ? "pt-BR" : "en", onclick: otherLanguage },
      language === "en" ? "Português" : "English",
    ),
  );
  // On a telephone the rail is a row that is longer than the screen.
  rail.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "center" });
  if (focused !== undefined) rail.querySelector(focused ? `a[href="${focused}"]` : "button.language").focus();
}

async function otherLanguage() {
  language = language === "en" ? "pt-BR" : "en";
  localStorage.setItem("language", language);
  rail();
  await context.post("/api/language", { language });
  route(true);
}

function place() {
  const [name, ...parts] = location.hash.replace(/^#\//, "").split("/").map(decodeURIComponent);
  return { name: PLACES.includes(name) && open(name) ? name : "", parts };
}

// Pictures without a project have the place Mark alone.
function open(name) {
  return name in state.steps;
}

async function route(anew = false) {
  const { name, parts } = place();
  if (!name) {
    location.replace(`#/${state.next ?? "folder"}`);
    return;
  }
  if (!anew && name === shown.name && shown.mounted?.route) {
    shown.mounted.route(parts);
    return;
  }
  shown.mounted?.leave?.();
  rail();
  fill(document.getElementById("command"));
  const element = document.getElementById("step");
  element.className = name;
  fill(element);
  shown = { name, mounted: null };
  const mine = shown;
  const module = await import(MODULES[name]);
  if (shown !== mine) return;
  const mounted = (await module.mount(element, Object.assign(contextOf(() => shown === mine), { parts }))) ?? null;
  if (shown === mine) mine.mounted = mounted;
  else mounted?.leave?.();
}

async function start() {
  const catalogues = ["/texts.json", "/look/texts.json", "/mark/texts.json"].map((path) => context.get(path));
  Object.assign(texts, ...(await Promise.all(catalogues)));
  await context.post("/api/language", { language });
  await context.renew();
  await reopen();
  addEventListener("hashchange", () => route());
  document.getElementById("skip").addEventListener("click", (event) => {
    event.preventDefault();
    document.getElementById("step").focus();
  });
  await route();
}

// A program that was started again is shown the folder that was open.
async function reopen() {
  const kept = localStorage.getItem(`folder ${state.root}`);
  if (!kept || state.folder !== "." || kept === "." || state.next === "mark") return;
  await context.post("/api/open", { path: kept }).catch(() => localStorage.removeItem(`folder ${state.root}`));
  await context.renew();
}

start();
