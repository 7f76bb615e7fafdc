// Pictures, by OpenSeadragon on tiles: observations and residual vectors above, all pictures of a point beside.

import { fill, h } from "../dom.js";
import { CHOSEN, KINDS, metres, number, quantile, round } from "./colours.js";
import { crop, thumbnail } from "./tiles.js";
import { label, outlined, pictureViewer } from "./viewer.js";

const ENLARGED = [1, 10, 20, 50, 100, 200, 500, 1000];
// A vector of usual length is drawn so long, px of the screen.
const USUAL_PX = 28;
// Beyond so many standard deviations an observation is drawn as one to be looked at.
const FAR = 3;
const MARK_PX = 90;
// Pictures without a mark are offered that so surely show the point, and so many of them.
const LIKELY = 0.5;
const MOST_OPEN = 12;

/** The lower pane: a strip of pictures and the viewer. */
export function picturePane(shared) {
  const { say, block, selection, language } = shared;
  const names = block.images.names.concat(Object.keys(block.pictures).filter((name) => !selection.images.has(name)));
  let told = null;
  let asked = "";
  let factor = 100;
  let zoomTo = null;
  let shown = null;
  let last = null;
  let drawnStrip = null;
  const chooser = h("select", { id: "picture-name", "aria-label": say("look.picture"), onchange: () => selection.image(chooser.value) }, h("option", { value: "" }, say("look.no-picture")), names.map((name) => h("option", { value: name }, name)));
  const enlarge = h("select", { id: "picture-factor", onchange: () => ((factor = Number(enlarge.value)), viewer.draw()) }, ENLARGED.map((n) => h("option", { value: n, selected: n === factor }, `× ${n}`)));
  const facts = h("span.facts", {});
  const leave = h("button.small", { type: "button", title: `${say("look.leave-out")} (l)`, disabled: true, onclick: () => shared.leaving.ask(selection.current()) }, say("look.leave-out"));
  const mark = h("button.small", { type: "button", disabled: true, hidden: !block.marking, onclick: () => shared.go(toMark(selection.now.points[0], told.name)) }, say("look.mark"));
  const bar = h("div.bar", {}, h("button.small", { type: "button", onclick: () => step(-1), "aria-label": say("look.before"), title: `${say("look.before")} (,)` }, "‹"), chooser, h("button.small", { type: "button", onclick: () => step(1), "aria-label": say("look.after"), title: `${say("look.after")} (.)` }, "›"), facts, h("label.factor", { for: "picture-factor" }, say("look.vectors"), enlarge), mark, leave);
  const viewer = pictureViewer({ tile: block.tile_px, paint: draw, clicked });
  const message = h("p.message", { role: "status" }, say("look.choose-picture"));
  const strip = h("div.strip", { role: "list", "aria-label": say("look.pictures-of") });
  const element = h("div.picture", {}, bar, h("div.both", {}, strip, viewer.element));
  viewer.element.append(message);
  const unlisten = selection.listen(changed);
  // What was left out just now is told at its crop.
  shared.leaving.listen(() => strip.dataset.kind?.startsWith("point ") && drawnStrip?.());
  overviewStrip();
  return { element, bar, step, leave: leavePane };

  function step(by) {
    const here = names.indexOf(chooser.value);
    const next = names[(here + by + names.length) % names.length];
    if (next) selection.image(next);
  }

  async function changed(now) {
    leave.disabled = !selection.current();
    viewer.draw();
    // Pictures of a point that became known are no other selection.
    if (now === last) return;
    last = now;
    const point = now.points[0];
    if (now.kind === "image" || !point) {
      const some = now.kind === "finding" && now.images.length ? now.images : names;
      overviewStrip(some);
      const first = now.kind === "image" ? now.name : now.kind === "finding" ? now.images[0] : null;
      if (first) await open(first);
    } else {
      await showPoint(point, now);
    }
  }

  /** All pictures of a point, the worst first: crops around its marks; the worst, or the chosen one, is opened. */
  async function showPoint(name, now) {
    const point = shown?.name === name ? shown : await pointOf(name);
    const more = block.marking && point.of_role !== "tie" ? await unmarked(name, point.images) : [];
    if (selection.now !== now) return;
    // Another point may have been asked for meanwhile: what its answer shows is not taken for this one.
    shown = point;
    fillStrip(name, now, more);
    selection.seen(shown.images, shown.at);
    const wanted = now.observations.find(([, other]) => other === name)?.[0] ?? shown.images[0];
    const k = shown.images.indexOf(wanted);
    if (wanted) await goTo(wanted, k < 0 ? null : shown.place[k]);
  }

  async function pointOf(name) {
    try {
      return await shared.get(`/api/look/point?name=${encodeURIComponent(name)}`);
    } catch (refusal) {
      return { name, images: [], place: [], residual_px: [], in_sigmas: [], at: null, refusal: refusal.message };
    }
  }

  function fillStrip(name, now, more) {
    const several = now.points.length > 1 && h("div.several", {}, now.points.map((other) => h("button.small", { type: "button", "aria-pressed": other === name, onclick: () => showPoint(other, now) }, other)));
    const role = shown.refusal ? "" : ` ${say(`look.role.${shown.of_role ?? "tie"}`)}, ${say("look.n-images", { n: shown.images.length })}`;
    strip.dataset.kind = `point ${name}`;
    fill(strip, several, h("div.head", {}, h("b", {}, name), role), shown.refusal && h("p.quiet", {}, shown.refusal), h("div.crops", {}, shown.images.map((image, k) => cropOf(shown, image, k))), more.length > 0 && h("div.head", {}, say("look.predicted", { n: more.length })), more.length > 0 && h("div.crops", {}, more.map((one) => openOf(name, one))));
    drawnStrip = () => fillStrip(name, now, more);
  }

  /** Pictures that should show a surveyed point but have no mark of it, the most useful first. */
  async function unmarked(name, marked) {
    try {
      const { images } = await shared.get(`/api/mark/images?point=${encodeURIComponent(name)}`);
      return images.filter((one) => one.probability > LIKELY && one.x !== null && !marked.includes(one.name)).slice(0, MOST_OPEN);
    } catch {
      return [];
    }
  }

  function openOf(point, one) {
    const look = () => shared.go(toMark(point, one.name));
    return h("div.crop.open-mark", { role: "listitem" }, h("button.open", { type: "button", onclick: look }, crop(one.name, [one.x, one.y], [null, null], block.tile_px), h("span.name", {}, one.name)), h("button.small", { type: "button", "aria-label": say("look.mark-in", { point, image: one.name }), onclick: look }, say("look.mark")));
  }

  function cropOf(point, image, k) {
    const place = point.place[k];
    const off = point.in_sigmas[k];
    const away = point.residual_px[k];
    const out = shared.leaving.has(image, point.name);
    const drawn = block.pictures[image] ? crop(image, place, away, block.tile_px) : h("span.no-picture", {}, say("look.no-picture-there"));
    const title = `${image}: ${say("look.residual")} ${number(Math.hypot(...away), language)} px, ${number(off, language)} σ`;
    return h(
      "div.crop",
      { role: "listitem", class: off > FAR ? "crop far" : "crop" },
      h("button.open", { type: "button", title, onclick: () => selection.observation(image, point.name) }, drawn, h("span.name", {}, image), h("span.size", {}, away[0] === null ? say("look.unused") : `${number(Math.hypot(...away), language)} px · ${number(off, language)} σ`)),
      out ? h("span.out", {}, say("look.is-out")) : h("button.small", { type: "button", "aria-label": say("look.leave.mark", { point: point.name, image }), onclick: () => shared.leaving.ask({ image, point: point.name }) }, say("look.leave-out")),
    );
  }

  /** Thumbnails of pictures, each loaded when it comes into sight. */
  function overviewStrip(some = names) {
    const current = selection.now.kind === "image" ? selection.now.name : "";
    const kind = some === names ? "all" : some.join(" ");
    if (strip.dataset.kind !== kind) {
      strip.dataset.kind = kind;
      fill(strip, h("div.head", {}, say("look.n-images", { n: some.length })), h("div.thumbs", {}, some.map(thumb)));
    }
    for (const one of strip.querySelectorAll(".thumb")) one.setAttribute("aria-pressed", one.dataset.name === current);
    strip.querySelector(".thumb[aria-pressed=true]")?.scrollIntoView({ block: "nearest" });
  }

  function thumb(name) {
    const made = h("button.thumb", { type: "button", title: name, onclick: () => selection.image(name) }, block.pictures[name] ? thumbnail(name, block) : null, h("span.name", {}, name));
    made.dataset.name = name;
    return h("div", { role: "listitem" }, made);
  }

  async function goTo(image, place) {
    zoomTo = place;
    if (asked === image && told) zoom();
    else await open(image);
  }

  async function open(name) {
    if (asked === name) return;
    asked = name;
    chooser.value = name;
    try {
      const answer = await shared.get(`/api/look/picture?name=${encodeURIComponent(name)}`);
      if (asked !== name) return;
      told = answer;
    } catch (refusal) {
      told = null;
      tell(refusal.message);
      return;
    }
    tellFacts();
    suitFactor();
    mark.disabled = Boolean(told.reason);
    // Without a picture the frame of it: observations are seen all the same.
    message.classList.toggle("above", Boolean(told.reason));
    tell(told.reason === "is not in the folder of pictures" ? say("look.no-picture-there") : told.reason);
    await viewer.open(told, zoom, Boolean(told.reason));
    viewer.draw();
  }

  function tell(text) {
    message.textContent = text;
    message.hidden = !text;
  }

  function zoom() {
    if (!zoomTo || !viewer.ready) return;
    viewer.goTo(zoomTo, MARK_PX);
    zoomTo = null;
  }

  function tellFacts() {
    facts.title = "";
    if (!told.station) return fill(facts, say("look.takes-no-part"));
    const lengths = told.residual_px.map((v) => (v[0] === null ? NaN : Math.hypot(...v))).filter(Number.isFinite);
    const rms = Math.sqrt(lengths.reduce((sum, v) => sum + v * v, 0) / (lengths.length || 1));
    // It may be longer than its place in the bar.
    facts.title = `${say("look.n-rays", { n: lengths.length })} · ${say("look.rms")} ${number(rms, language)} px · σ ${told.station_sigma_m.map((s) => metres(s, language)).join(", ")}`;
    fill(facts, facts.title);
  }

  /** Pixels of the screen for one of the picture seen whole: vectors stay as long when one zooms. */
  function shrunk() {
    const { clientWidth: width, clientHeight: height } = viewer.element;
    return Math.max(Math.min(width / told.size_px[0], height / told.size_px[1]), 0.1);
  }

  /** The enlargement with which usual residuals are seen. */
  function suitFactor() {
    const usual = quantile((told.residual_px ?? []).map((v) => (v[0] === null ? NaN : Math.hypot(...v))), 0.7);
    const wanted = usual > 0 ? USUAL_PX / usual / shrunk() : 100;
    factor = ENLARGED.filter((n) => n <= wanted).at(-1) ?? 1;
    enlarge.value = factor;
  }

  function draw(pen, width, height) {
    if (!told?.place) return;
    const scale = factor * shrunk();
    const chosen = new Set(selection.now.points);
    edge(pen);
    // Surveyed and chosen points are drawn last: their names lie above the vectors of the others.
    const above = (k) => told.role[k] !== "tie" || chosen.has(told.points[k]);
    const order = [...told.place.keys()].sort((one, other) => above(one) - above(other));
    for (const k of order) {
      const [x, y] = viewer.onScreen(told.place[k]);
      if (x < -60 || y < -60 || x > width + 60 || y > height + 60) continue;
      ray(pen, [x, y], told.residual_px[k], scale, { role: told.role[k], far: told.in_sigmas[k] > FAR, name: told.points[k], chosen: chosen.has(told.points[k]) });
    }
    for (const { point, place } of told.predicted ?? []) predicted(pen, viewer.onScreen(place), point, chosen.has(point));
    scaleBar(pen, scale, height);
  }

  /** The edge of the picture, which is seen where its file is not there. */
  function edge(pen) {
    const [right, low] = [told.size_px[0] - 0.5, told.size_px[1] - 0.5];
    pen.strokeStyle = "#7a868e";
    pen.lineWidth = 1;
    pen.beginPath();
    [[-0.5, -0.5], [right, -0.5], [right, low], [-0.5, low]].forEach((corner, k) => (k ? pen.lineTo(...viewer.onScreen(corner)) : pen.moveTo(...viewer.onScreen(corner))));
    pen.closePath();
    pen.stroke();
  }

  function ray(pen, [x, y], residual, scale, { role, far, name, chosen }) {
    const colour = chosen ? CHOSEN : role === "tie" ? (far ? "#d55e00" : "#0b5cad") : KINDS[role] ?? KINDS.tie;
    if (residual[0] === null) {
      outlined(pen, "#7a868e", 1.5, () => (pen.moveTo(x - 4, y - 4), pen.lineTo(x + 4, y + 4), pen.moveTo(x + 4, y - 4), pen.lineTo(x - 4, y + 4)));
    } else {
      const angle = viewer.angle();
      const [u, v] = [residual[0] * Math.cos(angle) - residual[1] * Math.sin(angle), residual[0] * Math.sin(angle) + residual[1] * Math.cos(angle)];
      outlined(pen, colour, far || role !== "tie" ? 2 : 1.25, () => (pen.moveTo(x, y), pen.lineTo(x + u * scale, y + v * scale)));
    }
    if (role === "tie" && !chosen) {
      pen.fillStyle = colour;
      pen.fillRect(x - 1.5, y - 1.5, 3, 3);
      return;
    }
    outlined(pen, colour, 2, () => (role === "check" ? pen.rect(x - 8, y - 8, 16, 16) : pen.arc(x, y, chosen ? 11 : 8, 0, 7)));
    label(pen, name, x + 13, y - 9, colour);
  }

  function predicted(pen, [x, y], name, chosen) {
    pen.setLineDash([4, 3]);
    outlined(pen, chosen ? CHOSEN : INKY, 1.5, () => pen.arc(x, y, 11, 0, 7));
    pen.setLineDash([]);
    label(pen, `${name}?`, x + 13, y - 9, INKY);
  }

  function clicked(left, top) {
    if (!told) return;
    let best = 14;
    let found = null;
    told.place.forEach((place, k) => {
      const [x, y] = viewer.onScreen(place);
      const away = Math.hypot(x - left, y - top) - (told.role[k] === "tie" ? 0 : 4);
      if (away < best) [best, found] = [away, told.points[k]];
    });
    for (const { point, place } of told.predicted ?? []) {
      const [x, y] = viewer.onScreen(place);
      if (Math.hypot(x - left, y - top) < best) found = point;
    }
    if (found) selection.observation(told.name, found);
  }

  function scaleBar(pen, scale, height) {
    const px = round(110 / scale);
    const y = height - 16;
    pen.fillStyle = "#ffffffe0";
    pen.fillRect(8, y - 16, Math.max(px * scale, 120) + 16, 26);
    pen.lineWidth = 2;
    pen.strokeStyle = pen.fillStyle = "#14202a";
    pen.beginPath();
    pen.moveTo(16, y);
    pen.lineTo(16 + px * scale, y);
    pen.moveTo(16, y - 4);
    pen.lineTo(16, y + 4);
    pen.moveTo(16 + px * scale, y - 4);
    pen.lineTo(16 + px * scale, y + 4);
    pen.stroke();
    pen.font = "600 11px system-ui, sans-serif";
    pen.fillText(say("look.vector-scale", { px: number(px, language) }), 20, y - 5);
  }

  function leavePane() {
    unlisten();
    viewer.destroy();
  }
}

const INKY = "#14202a";

/** The place Mark at a point in a picture. */
function toMark(point, image) {
  return `#/mark/${encodeURIComponent(point ?? "")}/${encodeURIComponent(image)}`;
}
