// Step Look: what the run has found, linked: findings, map, pictures, plots and 3-D view of one selection.

import { Refusal } from "../desk.js";
import { fill, h, said, script, styles } from "../dom.js";
import { findingsList } from "./findings.js";
import { leaving } from "./leaving.js";
import { blockMap } from "./map.js";
import { picturePane } from "./picture.js";
import { plotsPane } from "./plots.js";
import { makeSelection } from "./selection.js";
import { spaceView } from "./space.js";

const STYLES = ["/look/look.css", "/look/viewer.css", "/vendor/ol.css", "/vendor/uplot.css"];
const VIEWS = { map: blockMap, space: spaceView, plots: plotsPane };

export async function mount(element, context) {
  // The map's library comes while the server reads the project; the map tells if it does not.
  script("/vendor/ol.js").catch(() => {});
  let here = await read(element, context, again);
  return { leave: () => here.leave?.(), route: (parts) => here.route?.(parts) };

  /** Read everything anew, after a run. */
  async function again() {
    here.leave?.();
    context.parts = [];
    await context.renew();
    here = await read(element, context, again);
  }
}

async function read(element, context, again) {
  const { say } = context;
  fill(element, h("p.loading", { role: "status" }, say("look.loading")));
  try {
    const [overview, findings] = await Promise.all([
      context.get("/api/look"),
      context.get(`/api/look/findings?language=${context.language}`),
      // A map that is drawn before its styles are there has no height.
      ...STYLES.map(styles),
    ]);
    return show(element, context, { ...overview, findings }, again);
  } catch (refusal) {
    if (!(refusal instanceof Refusal)) throw refusal;
    fill(element, h("div.empty", {}, h("h1", {}, say("step.look")), said("warn", refusal.message), h("a.button", { href: "#/run" }, say("look.to-run"))));
    return {};
  }
}

function show(element, context, block, again) {
  const { say } = context;
  const selection = makeSelection(block);
  const shared = { ...context, block, selection, again };
  shared.leaving = leaving(shared);
  const views = {};
  const panes = Object.fromEntries(
    Object.keys(VIEWS).map((name) => [name, h(`div.view.${name}`, { id: `view-${name}`, role: "tabpanel", tabindex: 0, "aria-labelledby": `tab-${name}`, hidden: true })]),
  );
  const tabs = Object.keys(VIEWS).map((name, k) =>
    h("button.tab", { type: "button", role: "tab", id: `tab-${name}`, "aria-controls": `view-${name}`, title: `${say(`look.view.${name}`)} (${k + 1})`, onclick: () => open(name) }, say(`look.view.${name}`)),
  );
  const bar = h("div.tabs", { role: "tablist", "aria-label": say("look.views"), onkeydown: turn }, tabs);
  const picture = picturePane(shared);
  const upper = h("section.upper", { "aria-label": say("look.views") }, h("div.bar", {}, bar, larger("upper")), Object.values(panes));
  const lower = h("section.lower", { "aria-label": say("look.pictures") }, picture.element);
  picture.bar.append(larger("lower"));
  fill(element, h("h1.unseen", {}, say("step.look")), h("div.look", {}, findingsList(shared), h("div.panes", {}, upper, lower)));
  const unlisten = selection.listen(() => {
    const hash = selection.hash();
    if (hash !== location.hash) history.replaceState(null, "", hash);
    context.announce(selection.said(say));
  });
  addEventListener("keydown", keys);
  open("map");
  route(context.parts ?? []);
  return { leave, route };

  /** One of the views above: made when it is opened first. */
  function open(name) {
    for (const [other, pane] of Object.entries(panes)) pane.hidden = other !== name;
    for (const tab of tabs) {
      const here = tab.id === `tab-${name}`;
      tab.setAttribute("aria-selected", here);
      tab.tabIndex = here ? 0 : -1;
    }
    views[name] ??= VIEWS[name](panes[name], shared);
    Promise.resolve(views[name]).then((view) => view.shown?.());
  }

  function turn(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const here = tabs.findIndex((tab) => tab.getAttribute("aria-selected") === "true");
    const next = tabs[(here + step + tabs.length) % tabs.length];
    open(next.id.slice(4));
    next.focus();
  }

  /** A button that gives one pane all the room, or takes it back. */
  function larger(which) {
    const button = h("button.small.larger", { type: "button", "aria-pressed": "false", title: `${say("look.larger")} (${which === "upper" ? "m" : "v"})`, "aria-label": say("look.larger"), onclick: () => enlarge(which) }, "⤢");
    button.dataset.pane = which;
    return button;
  }

  function enlarge(which) {
    const panes = element.querySelector(".panes");
    const now = panes.dataset.only === which ? "" : which;
    panes.dataset.only = now;
    for (const button of element.querySelectorAll(".larger")) button.setAttribute("aria-pressed", button.dataset.pane === now);
    dispatchEvent(new Event("resize"));
  }

  function keys(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("input, select, textarea, dialog")) return;
    const name = Object.keys(VIEWS)[Number(event.key) - 1];
    if (name) open(name);
    else if (event.key === "m") enlarge("upper");
    else if (event.key === "v") enlarge("lower");
    else if (event.key === "Escape") selection.clear();
    else if (event.key === "," || event.key === ".") picture.step(event.key === "." ? 1 : -1);
    else if (event.key === "l") shared.leaving.ask(selection.current());
    else return;
    event.preventDefault();
  }

  function route(parts) {
    const [kind, ...rest] = parts;
    const name = rest.join("/");
    if (kind === "finding") selection.finding(Number(name));
    else if (kind === "point") selection.point(name);
    else if (kind === "image") selection.image(name);
    else if (kind === "view" && VIEWS[name]) open(name);
  }

  function leave() {
    unlisten();
    removeEventListener("keydown", keys);
    for (const view of Object.values(views)) Promise.resolve(view).then((made) => made.leave?.());
    picture.leave();
  }
}
