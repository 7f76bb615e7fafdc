"use strict";

// The map: who is where, drawn anew for each chart.

const STYLE = getComputedStyle(document.documentElement);
const colour = (name) => STYLE.getPropertyValue(`--${name}`).trim();

const map = {
  layers: new Map(),
  origin: null, // latitude and longitude of the first point, degrees
  perDegree: [0, 0],
  scale: 1, // pixels per metre
  centre: [0, 0], // east and north of the origin, metres
  fitted: true,

  take(news) {
    const named = new Set();
    for (const layer of news) {
      const key = `${layer.kind} ${layer.name}`;
      named.add(key);
      const kept = layer.from ? this.layers.get(key).places.slice(0, layer.from) : [];
      const places = kept.concat(layer.points.map((point) => this.place(point)));
      this.layers.set(key, { kind: layer.kind, name: layer.name, labels: layer.labels, places });
    }
    for (const key of this.layers.keys()) if (!named.has(key)) this.layers.delete(key);
    this.draw();
  },

  // Metres east and north of the first point, with the radii of WGS 84 there: exact to a millimetre per
  // metre over any flight of a day, and a map of the field needs no more.
  place([latitude, longitude]) {
    if (!this.origin) {
      this.origin = [latitude, longitude];
      const sine = Math.sin((latitude * Math.PI) / 180);
      const e2 = 0.00669437999014;
      const w = Math.sqrt(1 - e2 * sine * sine);
      const meridian = (6378137 * (1 - e2)) / w ** 3;
      const parallel = (6378137 / w) * Math.sqrt(1 - sine * sine);
      this.perDegree = [(parallel * Math.PI) / 180, (meridian * Math.PI) / 180];
    }
    const east = ((longitude - this.origin[1] + 540) % 360) - 180;
    return [east * this.perDegree[0], (latitude - this.origin[0]) * this.perDegree[1]];
  },

  fit(width, height) {
    const shown = [...this.layers.values()].filter((layer) => layer.kind !== "station");
    let places = shown.flatMap((layer) => layer.places);
    if (!places.length) places = [...this.layers.values()].flatMap((layer) => layer.places);
    if (!places.length) return;
    let [west, south, east, north] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const [x, y] of places) {
      west = Math.min(west, x); east = Math.max(east, x);
      south = Math.min(south, y); north = Math.max(north, y);
    }
    this.centre = [(west + east) / 2, (south + north) / 2];
    const room = [Math.max(width - 130, 80), Math.max(height - 110, 80)];
    this.scale = Math.min(room[0] / Math.max(east - west, 20), room[1] / Math.max(north - south, 20));
  },

  draw() {
    const canvas = $("map");
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    if (this.fitted) this.fit(width, height);
    const step = roundStep(110 / this.scale);
    if (this.origin) this.grid(pen, width, height, step);
    const at = ([east, north]) => [
      width / 2 + (east - this.centre[0]) * this.scale,
      height / 2 - (north - this.centre[1]) * this.scale,
    ];
    const order = ["coverage", "plan", "track", "picture", "station", "missed"];
    const sorted = [...this.layers.values()].sort((a, b) => order.indexOf(a.kind) - order.indexOf(b.kind));
    for (const layer of sorted) DRAW[layer.kind](pen, layer, at);
    if (this.origin) scaleBar(pen, height, step, step * this.scale);
    northArrow(pen, width);
    // No line may cross a name, and no name another one, the edge or what lies over the map.
    names.begin(canvas, width, height, this.origin ? step * this.scale : 0);
    for (const layer of sorted.reverse()) NAME[layer.kind]?.(pen, layer, at);
    for (const item of document.querySelectorAll(".legend li")) {
      item.hidden = !sorted.some((layer) => layer.kind === item.dataset.kind);
    }
    document.querySelector(".legend").hidden = !sorted.length;
    canvas.setAttribute("aria-label", description(sorted));
  },

  grid(pen, width, height, step) {
    pen.strokeStyle = colour("grid");
    pen.lineWidth = 1;
    pen.beginPath();
    const west = this.centre[0] - width / 2 / this.scale;
    const south = this.centre[1] - height / 2 / this.scale;
    for (let x = Math.ceil(west / step) * step; (x - west) * this.scale < width; x += step) {
      const column = Math.round((x - west) * this.scale) + 0.5;
      pen.moveTo(column, 0);
      pen.lineTo(column, height);
    }
    for (let y = Math.ceil(south / step) * step; (y - south) * this.scale < height; y += step) {
      const row = Math.round(height - (y - south) * this.scale) + 0.5;
      pen.moveTo(0, row);
      pen.lineTo(width, row);
    }
    pen.stroke();
  },

  zoom(factor, x, y) {
    const canvas = $("map");
    const dx = (x ?? canvas.clientWidth / 2) - canvas.clientWidth / 2;
    const dy = (y ?? canvas.clientHeight / 2) - canvas.clientHeight / 2;
    const scale = Math.min(Math.max(this.scale * factor, 1e-4), 500);
    // The place under the pointer stays there.
    this.centre = [
      this.centre[0] + dx / this.scale - dx / scale,
      this.centre[1] - dy / this.scale + dy / scale,
    ];
    this.scale = scale;
    this.release();
  },

  pan(dx, dy) {
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.release();
  },

  release() {
    this.fitted = false;
    this.tell();
  },

  fitAll() {
    this.fitted = true;
    this.tell();
  },

  tell() {
    $("fit").setAttribute("aria-pressed", String(this.fitted));
    this.draw();
  },
};

const DRAW = {
  // Where pictures overlap it is darker: four corners each.
  coverage(pen, layer, at) {
    pen.fillStyle = colour("cover");
    for (let row = 0; row + 3 < layer.places.length; row += 4) {
      pen.beginPath();
      for (let k = row; k < row + 4; k++) pen[k === row ? "moveTo" : "lineTo"](...at(layer.places[k]));
      pen.fill();
    }
  },

  // What was to be flown: beneath all that is.
  plan(pen, layer, at) {
    pen.strokeStyle = colour("quiet");
    pen.lineWidth = 1.5;
    pen.setLineDash([7, 5]);
    pen.beginPath();
    layer.places.forEach((place, row) => pen[row ? "lineTo" : "moveTo"](...at(place)));
    pen.stroke();
    pen.setLineDash([]);
  },

  track(pen, layer, at) {
    pen.strokeStyle = colour("track");
    pen.lineWidth = 2.5;
    pen.lineJoin = "round";
    pen.beginPath();
    layer.places.forEach((place, row) => pen[row ? "lineTo" : "moveTo"](...at(place)));
    pen.stroke();
    if (!layer.places.length) return;
    const [x, y] = at(layer.places.at(-1));
    pen.fillStyle = colour("track");
    pen.strokeStyle = colour("paper");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(x, y, 7, 0, 2 * Math.PI);
    pen.fill();
    pen.stroke();
  },

  picture(pen, layer, at) {
    pen.fillStyle = colour("ink");
    pen.beginPath();
    for (const place of layer.places) {
      const [x, y] = at(place);
      pen.moveTo(x + 3.5, y);
      pen.arc(x, y, 3.5, 0, 2 * Math.PI);
    }
    pen.fill();
  },

  missed(pen, layer, at) {
    layer.places.forEach((place) => {
      const [x, y] = at(place);
      for (const [width, stroke] of [[7, colour("paper")], [3.5, colour("bad")]]) {
        pen.lineWidth = width;
        pen.strokeStyle = stroke;
        pen.beginPath();
        pen.moveTo(x - 6, y - 6);
        pen.lineTo(x + 6, y + 6);
        pen.moveTo(x + 6, y - 6);
        pen.lineTo(x - 6, y + 6);
        pen.stroke();
      }
    });
  },

  station(pen, layer, at) {
    const [x, y] = at(layer.places[0]);
    pen.fillStyle = colour("good");
    pen.strokeStyle = colour("paper");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, y - 9);
    pen.lineTo(x + 9, y + 7);
    pen.lineTo(x - 9, y + 7);
    pen.closePath();
    pen.fill();
    pen.stroke();
  },
};

const NAME = {
  track(pen, layer, at) {
    if (layer.places.length) beside(pen, layer.name, at(layer.places.at(-1)), colour("track"));
  },
  missed(pen, layer, at) {
    layer.places.forEach((place, row) => beside(pen, layer.labels[row] ?? "", at(place), colour("bad-ink")));
  },
  station(pen, layer, at) {
    beside(pen, layer.name, at(layer.places[0]), colour("good"));
  },
};

// Where names are: each finds a free place around its point, or is left to the lists beside the map.
const names = {
  taken: [], // left, top, right, bottom, pixels

  begin(canvas, width, height, bar) {
    this.room = [2, 2, width - 2, height - 2];
    this.taken = [[8, height - 44, 24 + Math.max(bar, 60), height], [width - 44, 0, width, 60]];
    const own = canvas.getBoundingClientRect();
    for (const over of document.querySelectorAll(".zoom, .legend:not([hidden])")) {
      const box = over.getBoundingClientRect();
      this.taken.push([box.left - own.left, box.top - own.top, box.right - own.left, box.bottom - own.top]);
    }
  },

  find([x, y], width) {
    const high = 10;
    const places = [];
    for (const far of [12, 26, 44]) {
      places.push([x + far, y], [x - far - width, y], [x - width / 2, y - far - 4], [x - width / 2, y + far + 4]);
      places.push([x + far, y - far], [x + far, y + far], [x - far - width, y - far], [x - far - width, y + far]);
    }
    for (const [left, middle] of places) {
      const box = [left - 3, middle - high, left + width + 3, middle + high];
      const inside = box[0] >= this.room[0] && box[1] >= this.room[1] && box[2] <= this.room[2] && box[3] <= this.room[3];
      if (inside && !this.taken.some((b) => box[0] < b[2] && b[0] < box[2] && box[1] < b[3] && b[1] < box[3])) {
        this.taken.push(box);
        return [left, middle];
      }
    }
    return null;
  },
};

function beside(pen, text, point, fill) {
  pen.font = "700 14px system-ui, sans-serif";
  const place = text && names.find(point, pen.measureText(text).width);
  if (place) label(pen, text, place[0], place[1], fill);
}

function label(pen, text, x, y, fill) {
  pen.font = "700 14px system-ui, sans-serif";
  pen.textBaseline = "middle";
  pen.textAlign = "left";
  pen.lineWidth = 4;
  pen.lineJoin = "round";
  pen.strokeStyle = colour("paper");
  pen.strokeText(text, x, y);
  pen.fillStyle = fill;
  pen.fillText(text, x, y);
}

// The greatest of 1, 2, 5, 10, 20... that is not above a value.
function roundStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].find((factor) => factor * power <= value * 1.0000001) * power;
}

function scaleBar(pen, height, step, pixels) {
  const [x, y] = [16, height - 18];
  const text = step >= 1000 ? `${step / 1000} km` : `${Number(step.toPrecision(1))} m`;
  for (const [width, stroke] of [[7, colour("paper")], [3, colour("ink")]]) {
    pen.lineWidth = width;
    pen.strokeStyle = stroke;
    pen.lineJoin = "miter";
    pen.beginPath();
    pen.moveTo(x, y - 7);
    pen.lineTo(x, y);
    pen.lineTo(x + pixels, y);
    pen.lineTo(x + pixels, y - 7);
    pen.stroke();
  }
  label(pen, text, x + 6, y - 14, colour("ink"));
}

function northArrow(pen, width) {
  const [x, y] = [width - 26, 18];
  pen.fillStyle = colour("ink");
  pen.beginPath();
  pen.moveTo(x, y - 6);
  pen.lineTo(x + 8, y + 18);
  pen.lineTo(x, y + 12);
  pen.lineTo(x - 8, y + 18);
  pen.closePath();
  pen.fill();
  label(pen, "N", x - 5, y + 29, colour("ink"));
}

function description(sorted) {
  const of = (kind) => sorted.filter((layer) => layer.kind === kind);
  const count = (kind) => of(kind).reduce((sum, layer) => sum + layer.places.length, 0);
  const tracks = of("track").map((layer) => layer.name).sort().join(", ") || say("none");
  return say("map-shows", { tracks, pictures: count("picture"), missed: count("missed"), covered: count("coverage") / 4 });
}

function handleMap() {
  const canvas = $("map");
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.offsetX, event.offsetY];
    if (fingers.size === 2) {
      const was = spread();
      fingers.set(event.pointerId, now);
      const [a, b] = [...fingers.values()];
      map.zoom(spread() / Math.max(was, 1), (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
    } else {
      fingers.set(event.pointerId, now);
      map.pan(now[0] - before[0], now[1] - before[1]);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    map.zoom(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("dblclick", () => map.fitAll());
  canvas.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] };
    if (moves[event.key]) map.pan(...moves[event.key]);
    else if (event.key === "+") map.zoom(1.5);
    else if (event.key === "-") map.zoom(1 / 1.5);
    else if (event.key === "0") map.fitAll();
    else return;
    event.preventDefault();
  });
  $("closer").addEventListener("click", () => map.zoom(1.5));
  $("farther").addEventListener("click", () => map.zoom(1 / 1.5));
  $("fit").addEventListener("click", () => map.fitAll());
  new ResizeObserver(() => map.draw()).observe(canvas);
}
