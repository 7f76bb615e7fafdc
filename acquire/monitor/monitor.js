"use strict";

// The page shows what the feed says and nothing that it has made up itself, apart from being cut off.

const SILENCE_MS = 3000; // the feed speaks twice a second
const RETRY_MS = 1000;

const feed = {
  source: null,
  view: null,
  written: {}, // the debrief
  last: Date.now(), // when it spoke last
  tried: 0,

  connect() {
    this.tried = Date.now();
    this.source?.close();
    this.source = new EventSource("feed");
    this.source.addEventListener("view", (event) => this.take(() => {
      this.view = JSON.parse(event.data);
      show(this.view);
      alarms.take(this.view);
    }));
    this.source.addEventListener("debrief", (event) => this.take(() => debrief(JSON.parse(event.data))));
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
      alarms.lost = say("lost", { time: clock(this.last * 1e6) });
      document.body.dataset.connection = "lost";
      alarms.draw();
    }
    if ((closed || now - this.last > SILENCE_MS) && now - this.tried > RETRY_MS) this.connect();
    alarms.remind(now);
  },
};

// What a debrief of the pictures has written, in the page's language; older ones have written English alone.
function debrief(written) {
  feed.written = written;
  const own = written[speech.language] ?? written.en ?? {};
  const box = $("debrief");
  box.hidden = !own.verdict;
  box.querySelector("p").textContent = own.verdict ?? "";
  const lines = (texts) => (texts ?? []).map((text) => make("li", "", text));
  const calibration = (own.calibration ?? []).map(([text, good]) => make("li", good ? "good" : "waiting", text));
  box.querySelector(".calibration").replaceChildren(...calibration);
  box.querySelector(".findings").replaceChildren(...lines(own.findings));
  box.querySelector(".summary").replaceChildren(...lines(own.summary?.map(told)));
}

$("sound").addEventListener("click", () => sound.toggle());
$("heard").addEventListener("click", () => alarms.confirm());
$("language").addEventListener("click", () => {
  speech.other();
  sound.draw();
  alarms.draw();
  if (feed.view) show(feed.view);
  debrief(feed.written);
  map.tell();
});
handleMap();
speech.begin().then(() => {
  feed.connect();
  setInterval(() => feed.watch(), 250);
});
