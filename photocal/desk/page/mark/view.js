// One picture of the point that is chosen: where the point should be, its mark, and the residual of the mark.

import { fixed } from "../look/colours.js";
import { h } from "../dom.js";
import { label, outlined, pictureViewer } from "../look/viewer.js";
import { keyOf } from "./level.js";

// Residuals are drawn so much longer.
const ENLARGED = 20;
// A point is shown this large, unless its ellipse is larger.
const START_SCALE = 3;
// Below this the picture does not show the point.
const UNLIKELY = 0.01;
const PREDICTED = "#5fc8ff";
const MARKED = "#ffe14d";
const COLOURS = { good: "#3fe0a8", warn: "#f0e442", bad: "#ff7a2e" };
const OTHERS = "#e4e8eb";
const RIM = "#000000a8";

/** A window on a picture; `chosen(view)` and `pressed(view, column, row)` are told what happens in it. */
export function markView(host, shared, { chosen, pressed }) {
  const { say, language, state, images, acts } = shared;
  const name = h("span.name", {});
  const about = h("span.said", {});
  const remove = h("button.small", { type: "button", "aria-label": say("mark.remove"), title: `${say("mark.remove")} (Delete)`, onclick: () => acts.remove(view.image.name) }, "✕");
  const readout = h("div.readout", { "aria-hidden": "true" });
  const viewer = pictureViewer({ tile: state.project.tile_px, paint, clicked, pressed: press, settings: { tabIndex: "", preserveImageSizeOnResize: true, gestureSettingsMouse: { clickToZoom: false, dblClickToZoom: false }, gestureSettingsTouch: { dblClickToZoom: true, flickEnabled: false } } });
  viewer.stage.addEventListener("pointermove", read);
  viewer.stage.addEventListener("pointerleave", () => (readout.textContent = ""));
  viewer.stage.addEventListener("pointerdown", () => chosen(view), true);
  const element = h("div.shot", {}, viewer.element, h("div.caption", {}, name, about, remove), readout);
  host.append(element);
  let point = "";
  let seen = null;
  const view = { element, viewer, image: null, show, render, home, turned, middle, scale: viewer.scale, zoom: viewer.zoom, whole: viewer.whole, turn: viewer.turn, leave: viewer.destroy };
  return view;

  /** Show one of the ranked pictures, or nothing. */
  function show(own, there) {
    element.hidden = !there;
    element.dataset.empty = !own;
    if (!own) {
      view.image = null;
      return;
    }
    const fresh = view.image?.name !== own.name;
    const other = point !== state.point;
    [point, seen] = [state.point, own];
    [element.dataset.image, element.dataset.point] = [own.name, point];
    if (fresh) {
      const image = (view.image = images.get(own.name));
      name.textContent = image.name;
      name.title = `${image.name}, ${image.width} × ${image.height} px${image.turn ? `; ${say("mark.turned", { angle: image.turn })}` : ""}`;
      viewer.element.setAttribute("role", "img");
      viewer.element.setAttribute("aria-label", say("mark.picture", { name: image.name }));
      viewer.open({ name: image.name, size_px: [image.width, image.height], turn: image.turn }, home);
    } else if (other) home();
  }

  /** Look at the mark, else where it should be, else at the whole picture. */
  function home() {
    if (!view.image) return;
    const mark = state.marks.get(keyOf(view.image.name, point));
    const { clientWidth: width, clientHeight: height } = viewer.element;
    if (mark) viewer.look([mark.x, mark.y], START_SCALE);
    else if (seen?.probability > UNLIKELY && seen.x !== null) {
      const reach = seen.ellipse?.major ?? 0.1 * Math.min(view.image.width, view.image.height);
      const inside = [[seen.x, view.image.width], [seen.y, view.image.height]].map(([at, size]) => Math.min(Math.max(at, 0), size - 1));
      viewer.look(inside, Math.min(START_SCALE, (0.4 * Math.min(width, height)) / Math.max(reach, 1)));
    } else viewer.whole();
  }

  function render(active) {
    if (!view.image) return;
    const key = keyOf(view.image.name, state.point);
    const mark = state.marks.get(key);
    element.dataset.active = active;
    remove.hidden = !mark;
    const { text, level } = described(mark, state.residuals.get(key));
    about.textContent = about.title = text;
    about.dataset.level = level;
    viewer.draw();
  }

  function described(mark, residual) {
    if (!mark) {
      if (seen?.probability === undefined) return { text: say("mark.none"), level: "" };
      if (seen.probability < UNLIKELY) return { text: say("mark.not-there"), level: "" };
      return { text: say("mark.likely", { share: Math.round(100 * seen.probability) }), level: "" };
    }
    const px = (value) => fixed(value, language, 2);
    const byHand = [mark.sx, mark.sy].every((sigma) => sigma === state.project.by_hand_px);
    const place = `${px(mark.x)}; ${px(mark.y)}`;
    const sigma = byHand ? say("mark.by-hand") : `± ${px(Math.hypot(mark.sx, mark.sy))} px`;
    if (!residual) return { text: `${place} · ${sigma}`, level: byHand ? "warn" : "good" };
    const tested = residual.in_sigmas === null ? say("mark.unchecked") : `${fixed(residual.in_sigmas, language, 1)} σ`;
    return { text: `${say("look.residual")} ${px(Math.hypot(residual.vx, residual.vy))} px, ${tested} · ${place} · ${sigma}`, level: residual.level };
  }

  function clicked(left, top, event) {
    // A finger marks by resting.
    if (event.pointerType !== "touch") press(left, top);
  }

  function press(left, top) {
    const [x, y] = viewer.inPicture(left, top);
    if (x < -0.5 || y < -0.5 || x > view.image.width - 0.5 || y > view.image.height - 0.5) return;
    pressed(view, x, y);
  }

  function middle() {
    if (viewer.ready) press(viewer.element.clientWidth / 2, viewer.element.clientHeight / 2);
  }

  function read(event) {
    if (!viewer.ready) return;
    const box = viewer.element.getBoundingClientRect();
    const place = viewer.inPicture(event.clientX - box.left, event.clientY - box.top);
    readout.textContent = `${place.map((value) => fixed(value, language, 1)).join("; ")} px`;
  }

  /** A step on the screen, in columns and rows. */
  function turned(dx, dy) {
    return rotated(dx, dy, -viewer.angle());
  }

  function paint(pen) {
    if (!view.image) return;
    if (seen && seen.x !== null && seen.x !== undefined) predicted(pen);
    for (const other of state.marks.values()) {
      if (other.image !== view.image.name || other.point === point) continue;
      const at = viewer.onScreen([other.x, other.y]);
      cross(pen, at, 3, 8, 1, OTHERS);
      label(pen, other.point, at[0] + 12, at[1] - 10, OTHERS, RIM);
    }
    const key = keyOf(view.image.name, point);
    const mark = state.marks.get(key);
    if (!mark) return;
    const residual = state.residuals.get(key);
    const colour = COLOURS[residual?.level] ?? MARKED;
    const at = viewer.onScreen([mark.x, mark.y]);
    cross(pen, at, 4, 18, 1.5, colour);
    outlined(pen, colour, 1, () => pen.arc(...at, 0.7, 0, 7), RIM);
    if (residual) {
      const [dx, dy] = rotated(residual.vx, residual.vy, viewer.angle()).map((v) => v * viewer.scale() * ENLARGED);
      outlined(pen, colour, residual.level === "bad" ? 4 : 2.5, () => (pen.moveTo(...at), pen.lineTo(at[0] + dx, at[1] + dy)), RIM);
    }
    label(pen, mark.point, at[0] + 12, at[1] - 12, colour, RIM);
  }

  function predicted(pen) {
    const at = viewer.onScreen([seen.x, seen.y]);
    if (!state.marks.has(keyOf(view.image.name, point))) cross(pen, at, 5, 14, 1.5, PREDICTED);
    if (!seen.ellipse) return;
    const [major, minor] = [seen.ellipse.major, seen.ellipse.minor].map((axis) => Math.min(axis * viewer.scale(), 1e5));
    pen.setLineDash([7, 5]);
    outlined(pen, PREDICTED, 1.5, () => pen.ellipse(...at, major, minor, seen.ellipse.direction + viewer.angle(), 0, 7), RIM);
    pen.setLineDash([]);
  }
}

function rotated(dx, dy, angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return [dx * cos - dy * sin, dx * sin + dy * cos];
}

function cross(pen, [x, y], inner, outer, width, colour) {
  const arms = [[1, 0], [-1, 0], [0, 1], [0, -1]];
  outlined(pen, colour, width, () => arms.forEach(([a, b]) => (pen.moveTo(x + a * inner, y + b * inner), pen.lineTo(x + a * outer, y + b * outer))), RIM);
}
