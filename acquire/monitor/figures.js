"use strict";

// The figures of a view as elements of the page.

const $ = (id) => document.getElementById(id);

function make(tag, className, text) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  return element;
}

function word(state) {
  return worded(told(state.text), state.level);
}

function worded(text, level) {
  const element = make("span", "word", text);
  element.dataset.level = level;
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
  if (count < 1e6) return `${fixed(count / 1e3, 1)} kB`;
  if (count < 1e9) return `${fixed(count / 1e6, 1)} MB`;
  return `${fixed(count / 1e9, 1)} GB`;
}

function metres(value) {
  if (value === null) return null;
  return value < 1 ? `${fixed(value * 100, 1)} cm` : `${fixed(value, 1)} m`;
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
  const line = facts([[say("satellites"), row.satellites], [say("accuracy"), metres(row.horizontal_m)]]);
  if (row.correction_age_s !== null) {
    const corrections = make("span", "", `${say("corrections")} `);
    corrections.append(word(row.correction));
    line.append(corrections);
  }
  const shown = card(row.name, row.fix, [line]);
  shown.querySelector(".name").append(make("span", "since", ` ${say("for", { time: duration(row.for_s) })}`));
  return shown;
}

function camera(row) {
  const counts = [[say("triggered"), row.triggered], [say("feedback"), row.reported], [say("missed"), row.missed]];
  const shown = row.triggered || row.reported ? counts : [];
  if (row.time_marks) shown.push([say("time-marks"), row.time_marks]);
  return card(row.link, row.state, [facts(shown)]);
}

function link(row) {
  const element = make("div", "link");
  element.dataset.link = row.name;
  element.append(
    make("span", "name", row.name),
    make("span", "rate", `${fixed(row.frames_per_s, 1)} /s`),
    make("span", "rate", `${bytes(row.bytes_per_s)}/s`),
  );
  const line = facts([
    [say(row.gaps === 1 ? "gap" : "gaps"), row.gaps],
    [say("longest"), `${fixed(row.longest_gap_s, 1)} s`],
    [say("damaged"), row.damage_bytes ? bytes(row.damage_bytes) : null],
  ]);
  line.prepend(word(row.state));
  element.append(line);
  return element;
}

function rest(view) {
  const rows = [[say("disk"), word(view.disk.state)]];
  rows.push([say("log"), make("span", "", bytes(view.bytes))]);
  for (const row of view.clocks) rows.push([say("clock", { link: row.link }), word(row.state)]);
  return rows.flatMap(([label, value]) => {
    const shown = make("dd");
    shown.append(value);
    return [make("dt", "", label), shown];
  });
}

// ---- what a pilot looks for -------------------------------------------------------------------------------

const SHOWN_ALARMS = 3;
const ORDER = ["bad", "warn", "good", "off"];

// The worst of some words: of several receivers or cameras the one that needs a person.
function worst(words) {
  return words.slice().sort((a, b) => ORDER.indexOf(a.level) - ORDER.indexOf(b.level))[0];
}

function moving(vehicle, level) {
  const speed = vehicle?.speed_m_s ?? null;
  if (speed === null) return null;
  const heading = vehicle.heading_deg === null ? "" : `, ${vehicle.heading_deg.toFixed(0)}\u00b0`;
  return { text: `${fixed(speed, 1)} m/s${heading}`, level };
}

function tiles(view) {
  const [vehicle] = view.vehicles;
  const unknown = { text: "\u2013", level: "off" };
  const height = vehicle?.height_m ?? null;
  // Its mode is bad when nothing was told for long: the height is as old.
  const stale = vehicle?.mode.level === "bad" ? "bad" : "plain";
  const counted = view.cameras.filter((row) => row.triggered || row.reported);
  const taken = counted.reduce((sum, row) => sum + Math.max(row.reported, row.triggered - row.missed), 0);
  const missed = counted.reduce((sum, row) => sum + row.missed, 0);
  const counts = missed ? say("n-missed", { taken, missed }) : `${taken}`;
  const level = worst(view.cameras.map((row) => row.state))?.level ?? "off";
  const shown = [
    [say("tile-height"), height === null ? unknown : { text: `${height.toFixed(0)} m`, level: stale }],
    [say("tile-speed"), moving(vehicle, stale) ?? unknown],
    [say(vehicle?.armed ? "tile-mode-armed" : "tile-mode"), vehicle?.mode ?? unknown],
    [say("tile-battery"), worst(view.batteries.map((row) => row.state)) ?? unknown],
    [say("tile-fix"), worst(view.receivers.map((row) => row.fix)) ?? unknown],
    [say("tile-pictures"), counted.length ? { text: counts, level: level === "good" ? "plain" : level } : unknown],
    [say("tile-disk"), { text: view.disk.state.text.split(",")[0], level: view.disk.state.level }],
  ];
  return shown.map(([label, state]) => {
    const tile = make("div");
    const value = make("dd");
    value.append(word(state));
    tile.append(make("dt", "", label), value);
    return tile;
  });
}

function alarmLine(alarm) {
  const item = make("li");
  // Its colour goes with what it told of; its sign and words stay.
  item.append(make("time", "", clock(alarm.time_ns)), worded(sentence(alarm), alarm.ended ? "off" : alarm.level));
  if (alarm.ended) item.append(make("span", "ended", `\u2713 ${say(alarm.ended)} ${clock(alarm.ended_ns)}`));
  item.dataset.ended = alarm.ended;
  return item;
}

function sentence(alarm) {
  return alarm.link ? `${alarm.link}: ${told(alarm.text)}` : told(alarm.text);
}

function fill(id, elements, otherwise) {
  $(id).replaceChildren(...(elements.length ? elements : [make("p", "empty", otherwise)]));
}

function show(view) {
  const overall = $("overall");
  overall.textContent = told(view.overall.text);
  overall.dataset.level = view.overall.level;
  $("tiles").replaceChildren(...tiles(view));
  $("file").textContent = view.file;
  $("duration").textContent = duration(view.duration_s);
  fill("receivers", view.receivers.map(receiver), say("no-receiver"));
  fill("cameras", view.cameras.map(camera), say("no-picture"));
  fill("links", view.links.map(link), say("no-link"));
  $("rest").replaceChildren(...rest(view));
  const lines = view.alarms.slice().reverse().map(alarmLine);
  $("alarms").replaceChildren(...lines.slice(0, SHOWN_ALARMS));
  if (!lines.length) $("alarms").append(make("li", "empty", say("none")));
  const before = $("before");
  before.hidden = lines.length <= SHOWN_ALARMS;
  before.firstElementChild.textContent = say("before", { n: lines.length - SHOWN_ALARMS });
  before.lastElementChild.replaceChildren(...lines.slice(SHOWN_ALARMS));
}
