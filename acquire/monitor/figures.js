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

function rest(view) {
  const rows = [["disk", word(view.disk.state)]];
  rows.push(["log", make("span", "", bytes(view.bytes))]);
  for (const row of view.clocks) rows.push([`clock, ${row.link}`, word(row.state)]);
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
  return { text: `${speed.toFixed(1)} m/s${heading}`, level };
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
  const lost = missed ? `, ${missed} missed` : "";
  const level = worst(view.cameras.map((row) => row.state))?.level ?? "off";
  const shown = [
    ["above take-off", height === null ? unknown : { text: `${height.toFixed(0)} m`, level: stale }],
    ["speed, heading", moving(vehicle, stale) ?? unknown],
    [vehicle?.armed ? "mode, armed" : "mode", vehicle?.mode ?? unknown],
    ["battery", worst(view.batteries.map((row) => row.state)) ?? unknown],
    ["fix", worst(view.receivers.map((row) => row.fix)) ?? unknown],
    ["pictures", counted.length ? { text: `${taken}${lost}`, level: level === "good" ? "plain" : level } : unknown],
    ["disk", { text: view.disk.state.text.split(",")[0], level: view.disk.state.level }],
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
  item.append(make("time", "", clock(alarm.time_ns)), word({ text: sentence(alarm), level: alarm.ended ? "off" : alarm.level }));
  if (alarm.ended) item.append(make("span", "ended", `\u2713 ${alarm.ended} ${clock(alarm.ended_ns)}`));
  item.dataset.ended = alarm.ended;
  return item;
}

function sentence(alarm) {
  return alarm.link ? `${alarm.link}: ${alarm.text}` : alarm.text;
}

function fill(id, elements, otherwise) {
  $(id).replaceChildren(...(elements.length ? elements : [make("p", "empty", otherwise)]));
}

function show(view) {
  const overall = $("overall");
  overall.textContent = view.overall.text;
  overall.dataset.level = view.overall.level;
  $("tiles").replaceChildren(...tiles(view));
  $("file").textContent = view.file;
  $("duration").textContent = duration(view.duration_s);
  fill("receivers", view.receivers.map(receiver), "no receiver has spoken yet");
  fill("cameras", view.cameras.map(camera), "no picture yet");
  fill("links", view.links.map(link), "no link has spoken yet");
  $("rest").replaceChildren(...rest(view));
  const lines = view.alarms.slice().reverse().map(alarmLine);
  $("alarms").replaceChildren(...lines.slice(0, SHOWN_ALARMS));
  if (!lines.length) $("alarms").append(make("li", "empty", "none"));
  const before = $("before");
  before.hidden = lines.length <= SHOWN_ALARMS;
  before.firstElementChild.textContent = `${lines.length - SHOWN_ALARMS} before`;
  before.lastElementChild.replaceChildren(...lines.slice(SHOWN_ALARMS));
}
