"use strict";

// The page shows what the feed says and nothing that it has made up itself, apart from being cut off.

const SILENCE_MS = 3000; // the feed speaks twice a second
const RETRY_MS = 1000;
const BEEP_EVERY_MS = 2500;

const $ = (id) => document.getElementById(id);

function make(tag, className, text) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  return element;
}

function word(state) {
  const element = make("span", "word", state.text);
  element.dataset.level = state.level;
  return element;
}

function facts(pairs) {
  const line = make("div", "facts");
  for (const [label, value] of pairs) {
    if (value === null || value === undefined) continue;
    const item = make("span");
    item.append(make("b", "", value), ` ${label}`);
    line.append(item);
  }
  return line;
}

// ---- figures in words -------------------------------------------------------------------------------------

function clock(nanoseconds) {
  return new Date(nanoseconds / 1e6).toISOString().slice(11, 19);
}

function duration(seconds) {
  const s = Math.max(0, Math.floor(seconds));
  const two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
}

function bytes(count) {
  if (count < 1e3) return `${Math.round(count)} B`;
  if (count < 1e6) return `${(count / 1e3).toFixed(1)} kB`;
  if (count < 1e9) return `${(count / 1e6).toFixed(1)} MB`;
  return `${(count / 1e9).toFixed(1)} GB`;
}

function metres(value) {
  if (value === null) return null;
  return value < 1 ? `${(value * 100).toFixed(1)} cm` : `${value.toFixed(1)} m`;
}

// ---- the figures ------------------------------------------------------------------------------------------

function card(name, state, lines) {
  const element = make("div", "card");
  const top = make("div", "top");
  top.append(make("span", "name", name), word(state));
  element.append(top, ...lines);
  return element;
}

function receiver(row) {
  const line = facts([["satellites", row.satellites], ["accuracy", metres(row.horizontal_m)]]);
  if (row.correction_age_s !== null) {
    const corrections = make("span", "", "corrections ");
    corrections.append(word(row.correction));
    line.append(corrections);
  }
  const shown = card(row.name, row.fix, [line]);
  shown.querySelector(".name").append(make("span", "since", ` for ${duration(row.for_s)}`));
  return shown;
}

function camera(row) {
  const counts = [["triggered", row.triggered], ["feedback", row.reported], ["missed", row.missed]];
  const told = row.triggered || row.reported ? counts : [];
  if (row.time_marks) told.push(["time marks", row.time_marks]);
  return card(row.link, row.state, [facts(told)]);
}

function link(row) {
  const element = make("div", "link");
  element.dataset.link = row.name;
  element.append(
    make("span", "name", row.name),
    make("span", "rate", `${row.frames_per_s.toFixed(1)} /s`),
    make("span", "rate", `${bytes(row.bytes_per_s)}/s`),
  );
  const line = facts([
    [row.gaps === 1 ? "gap" : "gaps", row.gaps],
    ["longest", `${row.longest_gap_s.toFixed(1)} s`],
    ["damaged", row.damage_bytes ? bytes(row.damage_bytes) : null],
  ]);
  line.prepend(word(row.state));
  element.append(line);
  return element;
}

function rest(picture) {
  const rows = [["disk", word(picture.disk.state)]];
  rows.push(["log", make("span", "", bytes(picture.bytes))]);
  for (const row of picture.clocks) rows.push([`clock, ${row.link}`, word(row.state)]);
  for (const row of picture.batteries) {
    const parts = [row.voltage_v === null ? null : `${row.voltage_v.toFixed(1)} V`];
    if (row.percent !== null) parts.push(`${row.percent} %`);
    rows.push([`battery, ${row.link}`, make("b", "", parts.filter(Boolean).join(", "))]);
  }
  return rows.flatMap(([label, value]) => {
    const shown = make("dd");
    shown.append(value);
    return [make("dt", "", label), shown];
  });
}

function alarmLine(alarm) {
  const item = make("li");
  item.append(make("time", "", clock(alarm.time_ns)), word({ text: sentence(alarm), level: alarm.level }));
  return item;
}

function sentence(alarm) {
  return alarm.link ? `${alarm.link}: ${alarm.text}` : alarm.text;
}

function fill(id, elements, otherwise) {
  $(id).replaceChildren(...(elements.length ? elements : [make("p", "empty", otherwise)]));
}

function show(picture) {
  const recording = $("recording");
  recording.textContent = picture.recording.text;
  recording.dataset.level = picture.recording.level;
  $("file").textContent = picture.file;
  $("duration").textContent = duration(picture.duration_s);
  fill("receivers", picture.receivers.map(receiver), "no receiver has spoken yet");
  fill("cameras", picture.cameras.map(camera), "no picture yet");
  fill("links", picture.links.map(link), "no link has spoken yet");
  $("rest").replaceChildren(...rest(picture));
  $("alarms").replaceChildren(...picture.alarms.slice().reverse().map(alarmLine));
  if (!picture.alarms.length) $("alarms").append(make("li", "empty", "none"));
}

// ---- alarms that are heard and seen -----------------------------------------------------------------------

const alarms = {
  flight: null,
  last: 0, // number of the last alarm that was told
  heard: 0, // number of the last one that a person has confirmed
  open: [],
  lost: "", // since when the connection is lost
  lastBeep: 0,

  take(picture) {
    if (this.flight !== picture.flight) {
      this.flight = picture.flight;
      const kept = JSON.parse(sessionStorage.getItem("heard") || "null");
      const newest = picture.alarms.at(-1)?.number ?? 0;
      // Who opens the page sees what was; who reloads it goes on.
      this.heard = kept?.flight === this.flight ? kept.number : newest;
      this.last = this.heard;
      this.keep();
    }
    this.open = picture.alarms.filter((a) => a.number > this.heard && a.level !== "note");
    const fresh = this.open.filter((a) => a.number > this.last);
    this.last = picture.alarms.at(-1)?.number ?? this.last;
    if (fresh.length) sound.beep(fresh.some((a) => a.level === "bad") ? "bad" : "warn");
    this.draw();
  },

  keep() {
    sessionStorage.setItem("heard", JSON.stringify({ flight: this.flight, number: this.heard }));
  },

  confirm() {
    this.heard = this.last;
    this.keep();
    this.open = [];
    this.draw();
  },

  draw() {
    const banner = $("banner");
    const lines = this.lost ? [this.lost] : this.open.slice(-3).reverse().map(sentence);
    banner.hidden = !lines.length;
    banner.dataset.level = this.lost || this.open.some((a) => a.level === "bad") ? "bad" : "warn";
    banner.dataset.lost = String(Boolean(this.lost));
    const more = this.lost ? 0 : this.open.length - lines.length;
    const shown = $("banner-list");
    const texts = more > 0 ? [...lines, `and ${more} before`] : lines;
    if (texts.join("\n") !== shown.dataset.texts) {
      shown.dataset.texts = texts.join("\n");
      shown.replaceChildren(...texts.map((text) => make("li", "", text)));
    }
  },

  // What is bad is heard again until a person confirms it.
  remind(now) {
    const urgent = this.lost || this.open.some((a) => a.level === "bad");
    const title = this.lost || (this.open.length ? sentence(this.open.at(-1)) : "");
    const flash = title && Math.floor(now / 1000) % 2 === 0;
    document.title = flash ? `\u26a0 ${title}` : $("recording").textContent + " \u2013 monitor";
    if (urgent && now - this.lastBeep > BEEP_EVERY_MS) sound.beep("bad");
  },
};

const TONES = { bad: [[880, 0], [660, 0.18], [880, 0.36]], warn: [[660, 0]] };

const sound = {
  context: null,
  on: false,

  // Browsers let a page sound only after a person has touched it.
  toggle() {
    this.on = !this.on;
    if (this.on) {
      this.context ??= new AudioContext();
      this.context.resume();
      this.beep("warn");
    }
    this.draw();
  },

  draw() {
    const button = $("sound");
    button.textContent = this.on ? "Sound on" : "Sound off";
    button.setAttribute("aria-pressed", String(this.on));
  },

  beep(kind) {
    alarms.lastBeep = Date.now();
    if (!this.on) return;
    for (const [frequency, at] of TONES[kind]) {
      const tone = this.context.createOscillator();
      const volume = this.context.createGain();
      const start = this.context.currentTime + at;
      tone.type = "square";
      tone.frequency.value = frequency;
      volume.gain.setValueAtTime(0.0001, start);
      volume.gain.exponentialRampToValueAtTime(0.25, start + 0.01);
      volume.gain.exponentialRampToValueAtTime(0.0001, start + 0.16);
      tone.connect(volume).connect(this.context.destination);
      tone.start(start);
      tone.stop(start + 0.17);
    }
  },
};

// ---- the map ----------------------------------------------------------------------------------------------

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
    const order = ["track", "picture", "station", "missed"];
    const sorted = [...this.layers.values()].sort((a, b) => order.indexOf(a.kind) - order.indexOf(b.kind));
    for (const layer of sorted) DRAW[layer.kind](pen, layer, at);
    // No line may cross a name.
    for (const layer of sorted) NAME[layer.kind]?.(pen, layer, at);
    if (this.origin) scaleBar(pen, height, step, step * this.scale);
    northArrow(pen, width);
    for (const item of document.querySelectorAll(".legend li")) {
      item.hidden = !sorted.some((layer) => layer.kind === item.dataset.kind);
    }
    document.querySelector(".legend").hidden = !sorted.length;
    canvas.setAttribute("aria-label", description(sorted));
  },

  grid(pen, width, height, step) {
    pen.strokeStyle = "#dfe4e7";
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
    layer.places.forEach((place, row) => beside(pen, layer.labels[row] ?? "", at(place), colour("bad")));
  },
  station(pen, layer, at) {
    beside(pen, layer.name, at(layer.places[0]), colour("good"));
  },
};

function beside(pen, text, [x, y], fill) {
  label(pen, text, x + 12, y, fill);
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
  const tracks = of("track").map((layer) => layer.name).join(", ") || "none";
  return `Map: tracks ${tracks}; ${count("picture")} pictures, ${count("missed")} missed`;
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

// ---- the feed ---------------------------------------------------------------------------------------------

const feed = {
  source: null,
  last: Date.now(), // when it spoke last
  tried: 0,

  connect() {
    this.tried = Date.now();
    this.source?.close();
    this.source = new EventSource("/feed");
    this.source.addEventListener("picture", (event) => this.take(() => {
      const picture = JSON.parse(event.data);
      show(picture);
      alarms.take(picture);
    }));
    this.source.addEventListener("chart", (event) => this.take(() => map.take(JSON.parse(event.data))));
    // A source that failed is closed: the watch below opens the next one.
    this.source.addEventListener("error", () => this.source.close());
  },

  take(work) {
    this.last = Date.now();
    if (alarms.lost) {
      alarms.lost = "";
      document.body.dataset.connection = "good";
    }
    work();
  },

  watch() {
    const now = Date.now();
    const closed = this.source.readyState === EventSource.CLOSED;
    if (!alarms.lost && now - this.last > (closed ? RETRY_MS : SILENCE_MS)) {
      alarms.lost = `No connection since ${clock(this.last * 1e6)} UTC, trying again`;
      document.body.dataset.connection = "lost";
      alarms.draw();
    }
    if ((closed || now - this.last > SILENCE_MS) && now - this.tried > RETRY_MS) this.connect();
    alarms.remind(now);
  },
};

$("sound").addEventListener("click", () => sound.toggle());
$("heard").addEventListener("click", () => alarms.confirm());
handleMap();
feed.connect();
setInterval(() => feed.watch(), 250);
