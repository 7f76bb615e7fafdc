// A window on an image: zoom, pan, turn, and what is known of the point in it. Coordinates are columns and
// rows of the stored pixels; the centre of the upper-left one is (0, 0).
"use strict";

const DRAG_PX = 6;
const LONG_PRESS_MS = 450;
const DOUBLE_TAP_MS = 300;
const MAGNIFIED = 20; // residuals
const LARGEST_SCALE = 64;

class View {
  constructor(host, tiles, events) {
    this.tiles = tiles;
    this.events = events; // chosen(view), pressed(view, x, y), removed(view)
    this.image = null;
    this.shown = {}; // prediction, mark, residual, others
    this.scale = 1;
    this.x = this.y = 0;
    this.turn = 0;
    this.pointers = new Map();
    this.pressing = null;

    this.element = document.createElement("div");
    this.element.className = "view";
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    const caption = document.createElement("div");
    caption.className = "caption";
    this.name = document.createElement("span");
    this.name.className = "name";
    this.said = document.createElement("span");
    this.said.className = "said";
    this.remove = document.createElement("button");
    this.remove.type = "button";
    this.remove.textContent = "\u2715";
    this.remove.setAttribute("aria-label", "remove the mark");
    this.remove.title = "remove the mark (Delete)";
    this.remove.onclick = () => this.events.removed(this);
    caption.append(this.name, this.said, this.remove);
    this.readout = document.createElement("div");
    this.readout.className = "readout";
    this.element.append(this.canvas, caption, this.readout);
    host.append(this.element);
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.element);
  }

  get width() { return this.canvas.clientWidth; }
  get height() { return this.canvas.clientHeight; }

  show(image) {
    this.image = image;
    this.turn = image.turn / 90;
    this.element.dataset.image = image.name;
    this.name.textContent = image.name;
    this.name.title = `${image.name}, ${image.width} x ${image.height} px` +
      (image.turn ? `; shown turned by ${image.turn}\u00b0 (EXIF), columns and rows are the stored ones` : "");
    this.canvas.setAttribute("aria-label", `image ${image.name}`);
  }

  fit() {
    const sideways = this.turn % 2 === 1;
    const [w, h] = sideways ? [this.image.height, this.image.width] : [this.image.width, this.image.height];
    this.scale = Math.min(this.width / w, this.height / h) || 1;
    this.x = (this.image.width - 1) / 2;
    this.y = (this.image.height - 1) / 2;
    this.draw();
  }

  centre(x, y, scale) {
    this.x = x;
    this.y = y;
    this.scale = scale;
    this.draw();
  }

  turned(dx, dy, quarters) {
    for (let k = 0; k < ((quarters % 4) + 4) % 4; k += 1) [dx, dy] = [-dy, dx];
    return [dx, dy];
  }

  toScreen(x, y) {
    const [dx, dy] = this.turned((x - this.x) * this.scale, (y - this.y) * this.scale, this.turn);
    return [this.width / 2 + dx, this.height / 2 + dy];
  }

  toImage(left, top) {
    const [dx, dy] = this.turned(left - this.width / 2, top - this.height / 2, -this.turn);
    return [this.x + dx / this.scale, this.y + dy / this.scale];
  }

  zoom(factor, left = this.width / 2, top = this.height / 2) {
    const [x, y] = this.toImage(left, top);
    const least = 0.5 * Math.min(this.width, this.height) / Math.max(this.image.width, this.image.height);
    this.scale = Math.min(Math.max(this.scale * factor, least), LARGEST_SCALE);
    const [now, down] = this.toImage(left, top);
    this.x += x - now;
    this.y += y - down;
    this.keepInside();
    this.draw();
  }

  pan(dx, dy) {
    const [x, y] = this.turned(dx, dy, -this.turn);
    this.x -= x / this.scale;
    this.y -= y / this.scale;
    this.keepInside();
    this.draw();
  }

  keepInside() {
    this.x = Math.min(Math.max(this.x, 0), this.image.width - 1);
    this.y = Math.min(Math.max(this.y, 0), this.image.height - 1);
  }

  draw() {
    if (!this.pending) {
      this.pending = true;
      requestAnimationFrame(() => {
        this.pending = false;
        this.paint();
      });
    }
  }

  paint() {
    if (!this.image || !this.width) return;
    const fine = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(this.width * fine), Math.round(this.height * fine)];
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
    const pen = this.canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = "#262b2e";
    pen.fillRect(0, 0, w, h);
    this.paintTiles(pen, fine);
    pen.setTransform(fine, 0, 0, fine, 0, 0);
    this.paintPrediction(pen);
    this.paintMarks(pen);
    this.paintPress(pen);
  }

  paintTiles(pen, fine) {
    const { image, tiles } = this;
    const corners = [[0, 0], [this.width, 0], [0, this.height], [this.width, this.height]].map((c) => this.toImage(...c));
    const [left, right] = [Math.min(...corners.map((c) => c[0])), Math.max(...corners.map((c) => c[0]))];
    const [top, bottom] = [Math.min(...corners.map((c) => c[1])), Math.max(...corners.map((c) => c[1]))];
    const coarsest = tiles.coarsest(image.width, image.height);
    const level = Math.min(Math.max(Math.floor(Math.log2(1 / (this.scale * fine)) + 0.3), 0), coarsest);
    pen.setTransform(fine, 0, 0, fine, fine * this.width / 2, fine * this.height / 2);
    pen.rotate(this.turn * Math.PI / 2);
    pen.scale(this.scale, this.scale);
    pen.translate(-this.x, -this.y);
    pen.save();
    pen.beginPath();
    pen.rect(-0.5, -0.5, image.width, image.height);
    pen.clip();
    let waiting = 0;
    for (let k = coarsest; k >= level; k -= 1) {
      const side = tiles.size * 2 ** k;
      pen.imageSmoothingEnabled = this.scale * 2 ** k < 3;
      const last = [Math.ceil(image.width / side) - 1, Math.ceil(image.height / side) - 1];
      const from = [Math.max(Math.floor((left + 0.5) / side), 0), Math.max(Math.floor((top + 0.5) / side), 0)];
      const to = [Math.min(Math.floor((right + 0.5) / side), last[0]), Math.min(Math.floor((bottom + 0.5) / side), last[1])];
      for (let row = from[1]; row <= to[1]; row += 1) {
        for (let column = from[0]; column <= to[0]; column += 1) {
          const wanted = k === level || k === coarsest;
          const tile = tiles.get(image.name, k, column, row, wanted);
          if (tile) {
            const [x, y] = [column * side - 0.5, row * side - 0.5];
            pen.drawImage(tile, x, y, tile.naturalWidth * 2 ** k, tile.naturalHeight * 2 ** k);
          } else if (k === level) waiting += 1;
        }
      }
    }
    pen.restore();
    this.element.dataset.waiting = String(waiting);
  }

  stroke(pen, width, colour) {
    // Dark below light: seen on any ground.
    pen.lineWidth = width + 2;
    pen.strokeStyle = "rgb(0 0 0 / 60%)";
    pen.stroke();
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }

  cross(pen, [x, y], inner, outer, width, colour) {
    pen.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      pen.moveTo(x + dx * inner, y + dy * inner);
      pen.lineTo(x + dx * outer, y + dy * outer);
    }
    this.stroke(pen, width, colour);
  }

  paintPrediction(pen) {
    const seen = this.shown.prediction;
    if (!seen || seen.x === null || seen.x === undefined) return;
    const place = this.toScreen(seen.x, seen.y);
    const colour = "#5fc8ff";
    if (!this.shown.mark) this.cross(pen, place, 5, 14, 1.5, colour);
    if (!seen.ellipse) return;
    pen.beginPath();
    pen.setLineDash([7, 5]);
    const axes = [seen.ellipse.major, seen.ellipse.minor].map((a) => Math.min(a * this.scale, 1e5));
    pen.ellipse(...place, axes[0], axes[1], seen.ellipse.direction + this.turn * Math.PI / 2, 0, 2 * Math.PI);
    this.stroke(pen, 1.5, colour);
    pen.setLineDash([]);
  }

  paintMarks(pen) {
    pen.font = "600 13px system-ui, sans-serif";
    pen.textBaseline = "middle";
    for (const other of this.shown.others ?? []) {
      const place = this.toScreen(other.x, other.y);
      this.cross(pen, place, 3, 8, 1, "#d7dde1");
      this.label(pen, other.point, place, "#d7dde1");
    }
    const { mark, residual } = this.shown;
    if (!mark) return;
    const place = this.toScreen(mark.x, mark.y);
    const colour = residual ? { good: "#62e08a", warn: "#ffd033", bad: "#ff5a64" }[residual.level] : "#ffe14d";
    this.cross(pen, place, 4, 18, 1.5, colour);
    pen.beginPath();
    pen.arc(...place, 1.2, 0, 2 * Math.PI);
    pen.fillStyle = colour;
    pen.fill();
    if (residual) {
      const [dx, dy] = this.turned(residual.vx * this.scale * MAGNIFIED, residual.vy * this.scale * MAGNIFIED, this.turn);
      pen.beginPath();
      pen.moveTo(...place);
      pen.lineTo(place[0] + dx, place[1] + dy);
      this.stroke(pen, 2.5, colour);
    }
    this.label(pen, mark.point, place, colour);
  }

  label(pen, text, [x, y], colour) {
    pen.lineWidth = 3;
    pen.strokeStyle = "rgb(0 0 0 / 70%)";
    pen.strokeText(text, x + 12, y - 14);
    pen.fillStyle = colour;
    pen.fillText(text, x + 12, y - 14);
  }

  paintPress(pen) {
    if (!this.pressing) return;
    const part = Math.min((performance.now() - this.pressing.since) / LONG_PRESS_MS, 1);
    pen.beginPath();
    pen.arc(...this.pressing.at, 34, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * part);
    this.stroke(pen, 4, "#ffe14d");
    this.draw();
  }

  listen() {
    const { canvas } = this;
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.zoom(Math.exp(-event.deltaY * lines * 0.002), ...place(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.events.chosen(this);
      const at = place(event);
      this.pointers.set(event.pointerId, { at, start: at, moved: false });
      this.endPress();
      if (this.pointers.size > 1) for (const one of this.pointers.values()) one.moved = true;
      else if (event.pointerType !== "mouse") this.beginPress(at);
    });
    canvas.addEventListener("pointermove", (event) => {
      const at = place(event);
      this.read(at);
      const one = this.pointers.get(event.pointerId);
      if (!one) return;
      const from = one.at;
      if (!one.moved && Math.hypot(at[0] - one.start[0], at[1] - one.start[1]) < DRAG_PX) return;
      one.moved = true;
      this.endPress();
      const other = [...this.pointers.entries()].find(([id]) => id !== event.pointerId)?.[1];
      one.at = at;
      if (!other) this.pan(at[0] - from[0], at[1] - from[1]);
      else this.pinch(from, at, other.at);
    });
    const end = (event) => {
      const one = this.pointers.get(event.pointerId);
      this.pointers.delete(event.pointerId);
      this.endPress();
      if (!one || one.moved || event.type !== "pointerup") return;
      if (event.pointerType === "mouse") {
        if (event.button === 0) this.press(one.start);
      } else if (event.timeStamp - (this.tapped ?? -1e9) < DOUBLE_TAP_MS) {
        this.zoom(2.5, ...one.start);
        this.tapped = undefined;
      } else this.tapped = event.timeStamp;
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => { this.readout.textContent = ""; });
  }

  pinch(from, at, other) {
    const before = Math.hypot(from[0] - other[0], from[1] - other[1]);
    const after = Math.hypot(at[0] - other[0], at[1] - other[1]);
    this.pan((at[0] - from[0]) / 2, (at[1] - from[1]) / 2);
    if (before > 1) this.zoom(after / before, (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
  }

  beginPress(at) {
    this.pressing = { at, since: performance.now() };
    this.pressing.timer = setTimeout(() => {
      this.endPress();
      for (const one of this.pointers.values()) one.moved = true;
      navigator.vibrate?.(20);
      this.press(at);
    }, LONG_PRESS_MS);
    this.draw();
  }

  endPress() {
    if (!this.pressing) return;
    clearTimeout(this.pressing.timer);
    this.pressing = null;
    this.draw();
  }

  press(at) {
    const [x, y] = this.toImage(...at);
    if (x < -0.5 || y < -0.5 || x > this.image.width - 0.5 || y > this.image.height - 0.5) return;
    this.events.pressed(this, x, y);
  }

  read(at) {
    const [x, y] = this.toImage(...at);
    this.readout.textContent = `${x.toFixed(1)}, ${y.toFixed(1)} px`;
  }
}
