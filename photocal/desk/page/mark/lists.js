// Beside the pictures: all points, the pictures of the one that is chosen, and residuals, the worst first.

import { fixed } from "../look/colours.js";
import { fill, h } from "../dom.js";
import { crop, thumbnail } from "../look/tiles.js";
import { keyOf, level } from "./level.js";

const MOST_RESIDUALS = 12;
// A role that is the rule is not said.
const USUAL = "control";

export function markLists({ say, language, state, images, acts }) {
  const title = (text, id) => h("h2", {}, text, " ", h("span", { id }));
  const name = h("input", { id: "new-name", "aria-label": say("mark.new-name"), placeholder: say("mark.new-point"), maxlength: 100, autocomplete: "off" });
  const add = h("form.new", { id: "new-point", hidden: state.project.listed, onsubmit: added }, name, h("button.small", { type: "submit" }, say("mark.add")));
  const points = h("ol", { id: "points" });
  const pictures = h("ol", { id: "images" });
  const residuals = h("ol", { id: "residuals" });
  const leftOut = h("p.quiet", { id: "left-out" });
  const found = h("section", { id: "residuals-section", hidden: true }, title(say("mark.residuals"), "sigma0"), residuals, leftOut);
  const element = h("section.lists", { id: "panel", "aria-label": say("mark.lists") },
    h("section", {}, title(say("mark.points"), "points-count"), add, points),
    h("section", {}, title(say("mark.images-of"), "images-source"), pictures),
    found);
  // Small pictures are kept: each would be asked for anew.
  const thumbnails = new Map();
  const drawn = new Map();
  let drawnFor = "";
  return { element, render, follow };

  function added(event) {
    event.preventDefault();
    const given = name.value.trim();
    if (!given) return;
    name.value = "";
    name.blur();
    acts.addPoint(given);
  }

  function entry(text, more, press, { current = false, marked = false, how = "", small = null }) {
    const sign = { warn: "▲ ", bad: "✕ " }[how] ?? "";
    const item = h("li", { "aria-current": current ? "true" : null }, h("button", { type: "button", onclick: () => (press(), close()) }, small, h("span.name", { title: text }, marked && h("b", { "aria-label": say("mark.marked") }, "✓ "), text), h("span.more", {}, sign, more)));
    if (how) item.dataset.level = how;
    return item;
  }

  function close() {
    element.closest(".marking").removeAttribute("data-panel");
    document.getElementById("panel-button").setAttribute("aria-expanded", "false");
  }

  function render() {
    const all = [...state.residuals.values()];
    const counts = new Map();
    for (const { point } of state.marks.values()) counts.set(point, (counts.get(point) ?? 0) + 1);
    const text = (id, value) => (element.querySelector(`#${id}`).textContent = value);
    text("points-count", say("mark.n-marked", { marked: counts.size, all: state.points.length }));
    text("images-source", state.source && say(`mark.source.${state.source.replaceAll(" ", "-")}`));
    text("sigma0", state.sigma0 ? `σ0 ${fixed(state.sigma0, language, 2)}` : "");
    keep(points, state.points.map((own) => {
      const n = counts.get(own.name) ?? 0;
      const worst = all.reduce((most, r) => (r.point === own.name ? Math.max(most, r.in_sigmas ?? 0) : most), 0);
      const role = own.role && own.role !== USUAL ? `${say(`mark.role.${own.role}`)}, ` : "";
      return entry(own.name, `${role}${n ? `${n} ×` : "–"}`, () => acts.choosePoint(own.name), { current: own.name === state.point, marked: n > 0, how: n ? level(worst) : "" });
    }));
    if (drawnFor !== state.point) drawn.clear();
    drawnFor = state.point;
    keep(pictures, state.ranked.map(pictureEntry));
    found.hidden = !all.length && !state.leftOut.length;
    const order = all.toSorted((a, b) => (b.in_sigmas ?? 0) - (a.in_sigmas ?? 0)).slice(0, MOST_RESIDUALS);
    keep(residuals, order.map((r) => {
      const tested = r.in_sigmas === null ? say("mark.unchecked") : `${fixed(r.in_sigmas, language, 1)} σ`;
      return entry(say("mark.in", { point: r.point, image: r.image }), `${size(r)} px, ${tested}`, () => acts.choosePoint(r.point, r.image), { how: r.level });
    }));
    leftOut.textContent = state.leftOut.map((one) => say("mark.too-few", one)).join("; ");
  }

  function pictureEntry(own, k) {
    const key = keyOf(own.name, state.point);
    const residual = state.residuals.get(key);
    let more = own.probability === undefined ? "" : `${Math.round(100 * own.probability)} %`;
    if (residual) more = `${size(residual)} px`;
    const looks = { current: k === state.at, marked: state.marks.has(key), how: residual?.level ?? "", small: small(own, state.marks.get(key), residual) };
    return entry(own.name, more, () => acts.go(k), looks);
  }

  function size(residual) {
    return fixed(Math.hypot(residual.vx, residual.vy), language, 2);
  }

  /** The surroundings of the mark; without one the whole picture with the place where the point should be. */
  function small(own, mark, residual) {
    const image = images.get(own.name);
    const at = mark ?? (own.x === null || own.x === undefined ? null : own);
    const key = [own.name, at && `${at.x.toFixed(1)} ${at.y.toFixed(1)}`, Boolean(mark), residual?.vx].join("\n");
    if (!drawn.has(key)) drawn.set(key, h("span.small", {}, mark ? crop(own.name, [mark.x, mark.y], residual ? [residual.vx, residual.vy] : [null, null], state.project.tile_px) : whole(image, at)));
    return drawn.get(key);
  }

  function whole(image, at) {
    if (!thumbnails.has(image.name)) thumbnails.set(image.name, thumbnail(image.name, { coarsest: { [image.name]: image.coarsest } }));
    const made = [thumbnails.get(image.name)];
    if (!at || at.x < 0 || at.y < 0 || at.x > image.width || at.y > image.height) return made;
    const dot = h("i.dot", {});
    [dot.style.left, dot.style.top] = [`${(100 * (at.x + 0.5)) / image.width}%`, `${(100 * (at.y + 0.5)) / image.height}%`];
    return [...made, dot];
  }

  /** New entries in a list; the button that had the focus has it again. */
  function keep(list, entries) {
    const at = [...list.children].findIndex((item) => item.contains(document.activeElement));
    fill(list, entries);
    if (at >= 0) list.children[Math.min(at, entries.length - 1)]?.querySelector("button").focus({ preventScroll: true });
  }

  /** What is chosen is in sight. */
  function follow() {
    for (const list of [points, pictures]) list.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
  }
}
