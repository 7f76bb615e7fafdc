// What is chosen: a finding, a point, an image or one observation, and what belongs to it. All views listen.

/** A selection over a block; listeners are told of each change. */
export function makeSelection(block) {
  const listeners = new Set();
  const images = new Map(block.images.names.map((name, k) => [name, k]));
  const points = new Map(block.points.names.map((name, k) => [name, k]));
  const nothing = { kind: "", name: "", images: [], points: [], observations: [], parameters: [] };
  let now = nothing;

  function set(next) {
    now = { ...nothing, ...next };
    for (const listener of listeners) listener(now);
  }

  function from(point) {
    const finding = now.kind === "finding" ? now.name : now.from;
    return block.findings.lines[finding]?.concerns.points.includes(point) ? finding : undefined;
  }

  return {
    images,
    points,
    get now() {
      return now;
    },
    listen(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
    clear: () => set(nothing),
    finding(k) {
      const line = block.findings.lines[k];
      if (line) set({ kind: "finding", name: k, ...line.concerns, line });
    },
    point: (name) => set({ kind: "point", name, from: from(name), points: [name] }),
    image: (name) => set({ kind: "image", name, images: [name] }),
    /** One observation; it stays part of the finding through which it was reached. */
    observation: (image, point) => set({ kind: "observation", name: `${point} / ${image}`, from: from(point), images: [image], points: [point], observations: [[image, point]] }),
    /** Pictures that show the chosen point, and its place: known once the server has told. */
    seen(names, at) {
      Object.assign(now, { seen: names, at });
      for (const listener of listeners) listener(now);
    },
    /** What would be left out: an observation, a point or an image. */
    current() {
      if (now.observations.length === 1) return { image: now.observations[0][0], point: now.observations[0][1] };
      if (now.points.length === 1 && now.kind !== "image") return { point: now.points[0] };
      return now.images.length === 1 ? { image: now.images[0] } : null;
    },
    hash() {
      if (!now.kind) return "#/look";
      if (now.kind === "observation") return `#/look/point/${encodeURIComponent(now.points[0])}`;
      return `#/look/${now.kind}/${encodeURIComponent(now.name)}`;
    },
    /** The selection in words, for readers of the screen. */
    said(say) {
      if (!now.kind) return "";
      return now.kind === "finding" ? now.line.text : say(`look.chosen.${now.kind}`, { name: now.name });
    },
  };
}
