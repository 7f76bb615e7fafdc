// One picture in a frame, by OpenSeadragon on tiles: what is drawn above it, and places on the screen and in the picture.

import { h, script } from "../dom.js";
import { tileSource } from "./tiles.js";

const LONG_PRESS_MS = 450;
// A finger that rests may tremble so far, px of the screen.
const TREMBLE_PX = 6;

/** Load the viewer's library. It would write a style into the page, which the policy forbids: it finds one there. */
async function library() {
  const known = "data-openseadragon-mobile-css";
  if (!document.querySelector(`style[${known}]`)) {
    const inert = document.createElementNS(null, "style");
    inert.setAttribute(known, "true");
    document.head.append(inert);
  }
  await script("/vendor/openseadragon.js");
  return window.OpenSeadragon;
}

/**
 * A viewer of one picture at a time. `paint(pen, width, height)` draws above it; `clicked(x, y, event)` and, of a
 * finger that rests, `pressed(x, y)` are told places of the screen; `settings` are OpenSeadragon's.
 */
export function pictureViewer({ tile, paint, clicked, pressed, settings = {} }) {
  const stage = h("div.stage", {});
  const canvas = h("canvas.marks", { "aria-hidden": "true" });
  const element = h("div.frame", {}, stage, canvas);
  let viewer = null;
  let told = null;
  let home = null;
  let pending = false;
  let resting = null;
  let gone = false;
  const fingers = new Set();
  const seen = new ResizeObserver(() => draw());
  seen.observe(element);
  if (pressed) for (const [kind, listener] of Object.entries({ pointerdown: rest, pointermove: tremble, pointerup: lift, pointercancel: lift })) stage.addEventListener(kind, listener, true);
  const view = { element, stage, open, close: () => viewer?.close(), draw, goTo, look, whole, zoom, turn, onScreen, inPicture, scale, angle, destroy, get ready() { return Boolean(viewer?.world.getItemCount()); } };
  element.viewer = view;
  return view;

  /** Show a picture, or, without its file, the frame of it; `then` is called when it is there. */
  async function open(picture, then, empty = false) {
    [told, home] = [picture, then];
    element.dataset.loaded = "false";
    const made = await library();
    if (gone) return;
    viewer ??= make(made);
    viewer.open(empty ? { width: told.size_px[0], height: told.size_px[1], tileSize: 4096, getTileUrl: () => "/icon.svg", tileExists: () => false } : tileSource(told, tile));
  }

  function make(OpenSeadragon) {
    const made = OpenSeadragon({
      element: stage,
      drawer: "canvas",
      showNavigationControl: false,
      animationTime: 0.25,
      springStiffness: 12,
      maxZoomPixelRatio: 40,
      minZoomImageRatio: 0.8,
      imageSmoothingEnabled: false,
      maxImageCacheCount: 24,
      gestureSettingsMouse: { clickToZoom: false, dblClickToZoom: true },
      placeholderFillStyle: "#e4e8eb",
      ...settings,
    });
    made.addHandler("open", () => {
      made.viewport.setRotation(told.turn ?? 0, true);
      const item = made.world.getItemAt(0);
      item.addHandler("fully-loaded-change", (event) => (element.dataset.loaded = event.fullyLoaded));
      home?.();
      draw();
    });
    for (const event of ["update-viewport", "animation", "resize"]) made.addHandler(event, draw);
    made.addHandler("canvas-click", (event) => event.quick && view.ready && clicked(event.position.x, event.position.y, event.originalEvent));
    return made;
  }

  function rest(event) {
    if (event.pointerType === "mouse") return;
    stop();
    fingers.add(event.pointerId);
    // A second finger zooms.
    if (fingers.size > 1) return;
    const at = [event.clientX, event.clientY];
    resting = { at, timer: setTimeout(() => {
      resting = null;
      const box = stage.getBoundingClientRect();
      navigator.vibrate?.(20);
      if (view.ready) pressed(at[0] - box.left, at[1] - box.top);
    }, LONG_PRESS_MS) };
  }

  function tremble(event) {
    if (resting && Math.hypot(event.clientX - resting.at[0], event.clientY - resting.at[1]) > TREMBLE_PX) stop();
  }

  function lift(event) {
    fingers.delete(event.pointerId);
    stop();
  }

  function stop() {
    clearTimeout(resting?.timer);
    resting = null;
  }

  /** Pixels of the screen for one of the picture. */
  function scale() {
    return viewer.world.getItemAt(0).viewportToImageZoom(viewer.viewport.getZoom(true));
  }

  /** How far the picture is turned clockwise, radians. */
  function angle() {
    return (viewer.viewport.getRotation(true) * Math.PI) / 180;
  }

  /** Show a place so large that so many pixels about it are seen each way. */
  function goTo([x, y], half) {
    if (!view.ready) return;
    viewer.viewport.fitBounds(viewer.viewport.imageToViewportRectangle(x + 0.5 - half, y + 0.5 - half, 2 * half, 2 * half), true);
  }

  /** Show a place at a scale. */
  function look([x, y], scale) {
    if (!view.ready) return;
    const item = viewer.world.getItemAt(0);
    viewer.viewport.resize(new window.OpenSeadragon.Point(stage.clientWidth, stage.clientHeight), true);
    viewer.viewport.zoomTo(item.imageToViewportZoom(scale), null, true);
    viewer.viewport.panTo(item.imageToViewportCoordinates(x + 0.5, y + 0.5), true);
  }

  function whole() {
    viewer?.viewport.goHome(true);
  }

  function zoom(factor) {
    viewer?.viewport.zoomBy(factor);
    viewer?.viewport.applyConstraints();
  }

  /** Turn the view by a quarter; columns and rows stay. */
  function turn() {
    viewer?.viewport.rotateBy(90, true);
    draw();
  }

  /** From the picture's columns and rows (the middle of the first pixel is 0, 0) to the screen. */
  function onScreen([x, y]) {
    const at = viewer.world.getItemAt(0).imageToViewerElementCoordinates(new window.OpenSeadragon.Point(x + 0.5, y + 0.5));
    return [at.x, at.y];
  }

  /** From the screen to columns and rows. */
  function inPicture(x, y) {
    const at = viewer.world.getItemAt(0).viewerElementToImageCoordinates(new window.OpenSeadragon.Point(x, y));
    return [at.x - 0.5, at.y - 0.5];
  }

  function draw() {
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => {
      pending = false;
      const { clientWidth: width, clientHeight: height } = canvas;
      const ratio = devicePixelRatio || 1;
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d");
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, height);
      if (view.ready) paint(pen, width, height);
    });
  }

  function destroy() {
    gone = true;
    stop();
    seen.disconnect();
    viewer?.destroy();
  }
}

/** A line with a rim: seen on dark and on light ground. */
export function outlined(pen, colour, width, path, rim = "#ffffffc0") {
  for (const [style, wide] of [[rim, width + 2.5], [colour, width]]) {
    pen.beginPath();
    path();
    pen.strokeStyle = style;
    pen.lineWidth = wide;
    pen.stroke();
  }
}

/** A name beside a place. */
export function label(pen, text, x, y, colour, rim = "#fff") {
  pen.font = "600 12px system-ui, sans-serif";
  pen.lineWidth = 3.5;
  pen.strokeStyle = rim;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}
