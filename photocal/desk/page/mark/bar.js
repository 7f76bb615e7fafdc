// Above the pictures: point, snapping, history, pictures side by side and the adjustment; and the help on keys.

import { fill, h } from "../dom.js";

const SNAPS = ["any", "cross", "hourglass", "circle", "ring", "code", "none"];
const COUNTS = [1, 2, 4, 6];
// Keys, and what they do.
const HELP = {
  images: ["→", "←"],
  points: ["↓", "↑"],
  middle: ["M"],
  nudge: ["Shift →"],
  remove: ["Delete"],
  history: ["Ctrl Z", "Ctrl Shift Z"],
  snap: ["S"],
  zoom: ["+", "−"],
  home: ["C", "F"],
  turn: ["R"],
  counts: ["1", "2", "4", "6"],
  adjust: ["A"],
};

export function markBar({ say, state, acts }, help) {
  const button = (id, text, title, onclick, more = {}) => h("button.small", { type: "button", id, title, onclick, ...more }, text);
  const named = (id, text, key, title, onclick) => button(id, text, `${say(key)} (${title})`, onclick, { "aria-label": say(key) });
  const point = h("strong", { id: "point" });
  const place = h("span.place", { id: "place" });
  const snap = h("select", { id: "snap", title: `${say("mark.snap")} (S)`, onchange: () => (acts.setSnap(snap.value), snap.blur()) }, SNAPS.map((kind) => h("option", { value: kind }, say(`mark.snap.${kind}`))));
  const undo = button("undo", say("look.undo"), `${say("look.undo")} (Ctrl Z)`, () => acts.step("undo"));
  const redo = button("redo", say("mark.redo"), `${say("mark.redo")} (Ctrl Shift Z)`, () => acts.step("redo"));
  const counts = COUNTS.map((n) => button(`count-${n}`, n, `${say("mark.count", { n })} (${n})`, () => acts.setCount(n), { "aria-label": say("mark.count", { n }) }));
  const adjust = button("adjust", say("mark.adjust"), say(state.project.adjustable ? "mark.adjust-title" : "mark.adjust-needs"), acts.adjust);
  const lists = button("panel-button", say("mark.lists"), say("mark.lists"), toggle, { "aria-expanded": "false", "aria-controls": "panel" });
  const element = h("div.bar", {}, lists,
    h("div.group", { role: "group", "aria-label": say("mark.point") }, named("point-before", "‹", "mark.point-before", "↑", () => acts.stepPoint(-1)), point, named("point-after", "›", "mark.point-after", "↓", () => acts.stepPoint(1))),
    h("label.snap", { for: "snap" }, h("span", {}, say("mark.snap")), snap),
    h("div.group", { role: "group", "aria-label": say("mark.history") }, undo, redo),
    h("div.group.layout", { role: "group", "aria-label": say("mark.layout") }, counts),
    h("div.group", { role: "group", "aria-label": say("look.pictures") }, named("image-before", "‹", "look.before", "←", () => acts.stepImages(-1)), place, named("image-after", "›", "look.after", "→", () => acts.stepImages(1))),
    adjust, named("help-button", "?", "mark.help", "?", () => help.showModal()));
  adjusting(false);
  return { element, render, history, adjusting };

  /** On a small screen the lists lie over the pictures. */
  function toggle() {
    const open = element.parentElement.toggleAttribute("data-panel");
    lists.setAttribute("aria-expanded", open);
  }

  function render() {
    point.textContent = point.title = state.point || say("mark.no-points");
    place.textContent = state.ranked.length ? `${state.at + 1} / ${state.ranked.length}` : "";
    snap.value = state.snap;
    counts.forEach((one, k) => one.setAttribute("aria-pressed", COUNTS[k] === state.count));
  }

  function history(can) {
    [undo.disabled, redo.disabled] = [!can.undo, !can.redo];
  }

  /** Begin or end an adjustment; false where none can begin. */
  function adjusting(now) {
    if (now && adjust.disabled) return false;
    adjust.disabled = now || !state.project.adjustable;
    adjust.textContent = say(now ? "mark.adjusting" : "mark.adjust");
    return true;
  }
}

export function markHelp(say) {
  const help = h("dialog.help", { id: "help", "aria-labelledby": "help-title" });
  return fill(help,
    h("h2", { id: "help-title" }, say("mark.title")),
    h("p", {}, say("mark.help-lead")),
    h("dl", {}, Object.entries(HELP).map(([act, keys]) => [h("dt", {}, keys.map((key) => [h("kbd", {}, key), " "])), h("dd", {}, say(`mark.help.${act}`))])),
    h("form", { method: "dialog" }, h("button", {}, say("mark.close"))));
}
