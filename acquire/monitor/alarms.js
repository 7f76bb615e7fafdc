"use strict";

// Alarms that are seen and heard until a person confirms them.

const BEEP_EVERY_MS = 2500;

const alarms = {
  flight: null,
  last: 0, // number of the last alarm that was told
  heard: 0, // number of the last one that a person has confirmed, here or elsewhere
  open: [],
  lost: "", // since when the connection is lost
  lastBeep: 0,

  take(view) {
    const fresh = view.alarms.filter((a) => a.number > this.last && a.number > view.heard && a.level !== "note");
    if (this.flight !== view.flight) this.flight = view.flight;
    else if (fresh.length) sound.beep(fresh.some((a) => a.level === "bad") ? "bad" : "warn");
    this.heard = view.heard;
    this.last = view.alarms.at(-1)?.number ?? 0;
    // What is cured, or ended by the landing, is a line of the list: nobody need confirm it.
    this.open = view.alarms.filter((a) => a.number > this.heard && a.level !== "note" && !a.ended);
    this.draw();
  },

  // The server keeps it, beside the log: whoever opens the page later sees what nobody has confirmed yet.
  confirm() {
    fetch("heard", { method: "POST", body: String(this.last) });
    this.open = [];
    this.draw();
  },

  draw() {
    const banner = $("banner");
    const lines = this.lost ? [this.lost] : this.open.slice(-1).map(sentence);
    banner.hidden = !lines.length;
    banner.dataset.level = this.lost || this.open.some((a) => a.level === "bad") ? "bad" : "warn";
    banner.dataset.lost = String(Boolean(this.lost));
    const more = this.lost ? 0 : this.open.length - lines.length;
    const shown = $("banner-list");
    const texts = more > 0 ? [say("and-more", { said: lines[0], n: more })] : lines;
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
    document.title = flash ? `\u26a0 ${title}` : `${$("overall").textContent} \u2013 ${say("title")}`;
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
    button.textContent = say(this.on ? "sound-on" : "sound-off");
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
