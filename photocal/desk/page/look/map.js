// The map, by OpenLayers in the metres of the block: overlap, footprints, strips, stations, ellipses, vectors.

import { fill, h, script } from "../dom.js";
import { amount, CHOSEN, css, FIX, INK, KINDS, metres, number, quantile, round, usualSpacing } from "./colours.js";

const LAYERS = ["ground", "overlap", "footprints", "strips", "ties", "ellipses", "vectors", "stations", "points"];
const FIRST = new Set(["overlap", "strips", "ellipses", "vectors", "points", "stations"]);
const NEAR_PX = 14;
const MOST_OVERLAP = 10;
// Ellipses and vectors are enlarged so that usual ones are so long, in distances between stations.
const ELLIPSE_SHARE = 0.35;
const VECTOR_SHARE = 0.8;

export async function blockMap(target, shared) {
  const { say, block, selection, language } = shared;
  await script("/vendor/ol.js");
  const { ol } = window;
  const { images, points } = block;
  const at = images.names.map((_, k) => [images.x[k], images.y[k]]);
  const marked = points.names.map((_, k) => [points.x[k], points.y[k]]);
  const spacing = usualSpacing(at);
  const enlarged = { ellipses: enlargement(images.ellipse.concat(points.ellipse).map((e) => e[0]), ELLIPSE_SHARE * spacing, 0.5), vectors: enlargement(lengths(), VECTOR_SHARE * spacing, 0.95) };
  let colouring = images.fix ? "fix" : "rms_px";
  const usable = LAYERS.filter((name) => name !== "ground" || block.ground);
  const holder = h("div.plane", { tabindex: 0, role: "application", "aria-label": say("look.map.label") });
  const layers = makeLayers();
  const legend = h("div.legend", {});
  const tip = h("div.tip", { hidden: true });
  fill(target, holder, h("div.north", { role: "img", "aria-label": say("look.map.north"), title: say("look.map.north") }, h("span", {}, "▲"), "N"), legend, tip);
  const extent = ol.extent.boundingExtent([...at, ...marked, ...images.footprint.flat()].filter(([x, y]) => Number.isFinite(x) && Number.isFinite(y) && x !== null));
  const projection = new ol.proj.Projection({ code: "block", units: "m", getPointResolution: (resolution) => resolution });
  const view = new ol.View({ projection, center: ol.extent.getCenter(extent), constrainResolution: false, showFullExtent: true });
  const map = new ol.Map({
    target: holder,
    layers: [...usable.map((name) => layers[name]), layers.chosen],
    view,
    // A map that may have the focus would else be dragged and zoomed only once it has it.
    interactions: ol.interaction.defaults.defaults({ onFocusOnly: false }),
    keyboardEventTarget: holder,
    controls: ol.control.defaults.defaults({ attribution: false, rotate: false, zoomOptions: { zoomInTipLabel: say("look.zoom-in"), zoomOutTipLabel: say("look.zoom-out") } }).extend([new ol.control.ScaleLine({ minWidth: 70 })]),
  });
  const whole = () => view.fit(extent, { padding: [24, 24 + legend.offsetWidth, 24, 48] });
  let fitted = false;
  drawLegend();
  show(selection.now);
  const unlisten = selection.listen(show);
  map.on("click", (event) => choose(event.pixel));
  map.on("pointermove", (event) => (event.dragging ? (tip.hidden = true) : hint(event.pixel)));
  holder.addEventListener("pointerleave", () => (tip.hidden = true));
  target.blockMap = map;
  return {
    shown() {
      map.updateSize();
      if (!fitted) whole();
      fitted = true;
    },
    leave() {
      unlisten();
      map.setTarget(null);
    },
  };

  function lengths() {
    const plane = (d) => (d[0] === null ? NaN : Math.hypot(d[0], d[1]));
    return [...points.difference_m.map(plane), ...images.position_m.map(plane)];
  }

  function makeLayers() {
    const made = {
      ground: block.ground && new ol.layer.Tile({ source: groundSource(block.ground) }),
      overlap: new ol.layer.Image({ opacity: 0.75 }),
      footprints: drawn(images.footprint.map((ring, k) => (ring[0][0] === null ? null : feature(new ol.geom.Polygon([[...ring, ring[0]]]), images.names[k]))), line("#33424d99", 1)),
      strips: drawn(strips(), line("#33424d", 1.5, [6, 4])),
      ties: new ol.layer.Image({}),
      ellipses: drawn([...images.ellipse.map((e, k) => ellipse(at[k], e)), ...points.ellipse.map((e, k) => ellipse(marked[k], e))], ellipseStyle()),
      vectors: drawn([...arrows(at, images.position_m, "tie"), ...arrows(marked, points.difference_m, (k) => points.role[k])], arrowStyle),
      points: drawn([...marked.map((place, k) => feature(new ol.geom.Point(place), points.names[k], { role: points.role[k] })), ...points.unseen.place.map((place, k) => feature(new ol.geom.Point(place.slice(0, 2)), points.unseen.names[k], { role: "unseen" }))], pointStyle(), true),
      stations: drawn(at.map((place, k) => feature(new ol.geom.Point(place), images.names[k], { k })), stationStyle()),
      chosen: new ol.layer.Vector({ source: new ol.source.Vector(), style: chosenStyle, updateWhileInteracting: true }),
    };
    for (const name of usable) made[name].setVisible(FIRST.has(name));
    shared.get("/api/look/overlap").then(async (place) => {
      const cells = new Uint8Array(await shared.bytes("/api/look/overlap.bin"));
      made.overlap.setSource(overlapSource(place, cells));
    });
    return made;
  }

  /** A layer that moves as a picture while it is dragged, and is drawn anew when it comes to rest. */
  function drawn(features, style, declutter = false) {
    return new ol.layer.VectorImage({ source: new ol.source.Vector({ features: features.filter(Boolean) }), style, imageRatio: 1.6, declutter });
  }

  function feature(geometry, name, more = {}) {
    const made = new ol.Feature(geometry);
    made.setProperties({ name, ...more });
    return made;
  }

  function line(color, width, lineDash) {
    return new ol.style.Style({ stroke: new ol.style.Stroke({ color, width, lineDash }) });
  }

  /** Thin where they are small. */
  function ellipseStyle() {
    const [thin, usual] = [line("#009e73", 0.9), line("#009e73", 1.75)];
    return (one, resolution) => (ol.extent.getWidth(one.getGeometry().getExtent()) / resolution < 14 ? thin : usual);
  }

  function strips() {
    const found = [];
    let begin = 0;
    for (let k = 1; k <= at.length; k++) {
      if (k < at.length && images.strip[k] === images.strip[begin]) continue;
      if (k - begin > 1) found.push(feature(new ol.geom.LineString(at.slice(begin, k)), say("look.map.strip", { n: images.strip[begin] + 1 })));
      begin = k;
    }
    return found;
  }

  /** An error ellipse at its stated enlargement; the azimuth counts from north to east. */
  function ellipse(place, [a, b, azimuth]) {
    if (!a) return null;
    const ring = Array.from({ length: 33 }, (_, k) => {
      const [u, v] = [a * Math.cos((k * Math.PI) / 16), b * Math.sin((k * Math.PI) / 16)];
      const [s, c] = [Math.sin(azimuth), Math.cos(azimuth)];
      return [place[0] + enlarged.ellipses * (u * s + v * c), place[1] + enlarged.ellipses * (u * c - v * s)];
    });
    return feature(new ol.geom.LineString(ring));
  }

  function arrows(places, differences, role) {
    return differences.map((d, k) => {
      if (d[0] === null) return null;
      const tip = [places[k][0] + enlarged.vectors * d[0], places[k][1] + enlarged.vectors * d[1]];
      return feature(new ol.geom.LineString([places[k], tip]), "", { role: typeof role === "string" ? role : role(k), turn: Math.atan2(d[0], d[1]), tip });
    });
  }

  function arrowStyle(one, resolution) {
    const color = one.get("role") === "tie" ? INK : KINDS[one.get("role")];
    const long = one.getGeometry().getLength() / resolution;
    const head = resolution * Math.min(5, Math.max(1, long / 4));
    const [x, y] = one.get("tip");
    // Shapes, not symbols: a symbol would be a picture of its own for each direction.
    const corners = [0, 1, 2, 0].map((k) => one.get("turn") + (k * 2 * Math.PI) / 3).map((turn) => [x + head * Math.sin(turn), y + head * Math.cos(turn)]);
    return [
      line("#ffffffb0", long < 12 ? 2 : 4),
      line(color, long < 12 ? 1 : 1.75),
      new ol.style.Style({ geometry: new ol.geom.Polygon([corners]), fill: new ol.style.Fill({ color }) }),
    ];
  }

  function pointStyle() {
    const shape = (role) => {
      const fill = new ol.style.Fill({ color: role === "unseen" ? "#fff" : KINDS[role] });
      const stroke = new ol.style.Stroke({ color: role === "unseen" ? KINDS.unseen : "#fff", width: 1.75 });
      return role === "check" ? new ol.style.RegularShape({ points: 4, radius: 8, angle: Math.PI / 4, fill, stroke }) : new ol.style.RegularShape({ points: 3, radius: 8.5, fill, stroke });
    };
    const shapes = { control: shape("control"), check: shape("check"), unseen: shape("unseen") };
    return (one) => new ol.style.Style({ image: shapes[one.get("role")], text: label(one.get("name")) });
  }

  function label(text, color = INK) {
    return new ol.style.Text({ text, offsetY: -15, font: "600 12px system-ui, sans-serif", fill: new ol.style.Fill({ color }), stroke: new ol.style.Stroke({ color: "#fff", width: 3.5 }) });
  }

  function stationStyle() {
    const cache = {};
    // Dense blocks seen from afar have small dots.
    const radius = (resolution) => Math.min(4, Math.max(1.5, Math.round((2 * 0.28 * spacing) / resolution) / 2));
    const dot = (color, resolution) => {
      const size = radius(resolution);
      return (cache[`${color} ${size}`] ??= new ol.style.Style({ image: new ol.style.Circle({ radius: size, fill: new ol.style.Fill({ color }), stroke: size > 2.5 ? new ol.style.Stroke({ color: "#fff", width: 1.25 }) : undefined }) }));
    };
    if (colouring === "fix") return (one, resolution) => dot(FIX[images.fix[one.get("k")]] ?? FIX[""], resolution);
    const values = stationValues();
    const [low, high] = [quantile(values, 0.02), quantile(values, 0.98)];
    return (one, resolution) => {
      const value = values[one.get("k")];
      return dot(Number.isFinite(value) ? css(amount(Math.round(8 * ((value - low) / (high - low || 1))) / 8)) : KINDS.tie, resolution);
    };
  }

  function stationValues() {
    if (colouring === "position") return images.position_m.map((d) => (d[0] === null ? NaN : Math.hypot(...d)));
    if (colouring === "sigma") return images.ellipse.map((e) => e[0] ?? NaN);
    return images[colouring].map((value) => value ?? NaN);
  }

  /** The orthophoto in tiles, coarse ones first. */
  function groundSource({ corner, cell_m, size, levels, tile_px }) {
    const resolutions = Array.from({ length: levels + 1 }, (_, k) => cell_m * 2 ** (levels - k));
    const box = [corner[0], corner[1] - size[1] * cell_m, corner[0] + size[0] * cell_m, corner[1]];
    const tileGrid = new ol.tilegrid.TileGrid({ origin: corner, extent: box, resolutions, tileSize: tile_px });
    return new ol.source.TileImage({ projection: null, tileGrid, tileUrlFunction: ([z, x, y]) => `/api/look/ground/${levels - z}/${x}/${y}` });
  }

  function overlapSource({ columns, rows, first, column, row }, cells) {
    const picture = new OffscreenCanvas(columns, rows);
    const pixels = new ImageData(columns, rows);
    cells.forEach((count, k) => {
      if (count) pixels.data.set([...amount(Math.min(count, MOST_OVERLAP) / MOST_OVERLAP), 170], 4 * k);
    });
    picture.getContext("2d").putImageData(pixels, 0, 0);
    return canvasSource((pen, toCanvas) => {
      const [x, y] = toCanvas(first[0] - (column[0] + row[0]) / 2, first[1] - (column[1] + row[1]) / 2);
      const [cx, cy] = toCanvas(first[0] + (column[0] - row[0]) / 2, first[1] + (column[1] - row[1]) / 2);
      const [rx, ry] = toCanvas(first[0] + (row[0] - column[0]) / 2, first[1] + (row[1] - column[1]) / 2);
      pen.imageSmoothingEnabled = false;
      pen.setTransform(cx - x, cy - y, rx - x, ry - y, x, y);
      pen.drawImage(picture, 0, 0);
    });
  }

  async function tieSource() {
    const values = new Float32Array(await shared.bytes("/api/look/ties.bin"));
    const sigmas = [];
    for (let k = 3; k < values.length; k += 5) sigmas.push(values[k]);
    const high = quantile(sigmas, 0.95) || 1;
    return canvasSource((pen, toCanvas) => {
      for (let k = 0; k < values.length; k += 5) {
        const [x, y] = toCanvas(values[k] + block.origin[0], values[k + 1] + block.origin[1]);
        pen.fillStyle = css(amount(values[k + 3] / high));
        pen.fillRect(x - 1, y - 1, 2.5, 2.5);
      }
    });
  }

  /** A layer's source that a function draws, in pixels of a canvas. */
  function canvasSource(draw) {
    return new ol.source.ImageCanvas({
      ratio: 1.6,
      canvasFunction(extent, resolution, ratio, size) {
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = size.map(Math.round);
        draw(canvas.getContext("2d"), (x, y) => [((x - extent[0]) / resolution) * ratio, ((extent[3] - y) / resolution) * ratio]);
        return canvas;
      },
    });
  }

  function show(now) {
    const source = layers.chosen.getSource();
    source.clear();
    const single = now.kind === "image";
    for (const name of now.images.concat(now.seen ?? [])) {
      const k = selection.images.get(name);
      if (k === undefined) continue;
      if ((single || now.images.length <= 8) && images.footprint[k][0][0] !== null && !now.seen?.includes(name)) source.addFeature(feature(new ol.geom.Polygon([[...images.footprint[k], images.footprint[k][0]]]), "", { kind: "footprint" }));
      source.addFeature(feature(new ol.geom.Point(at[k]), single ? name : "", { kind: "image" }));
    }
    for (const name of now.points) {
      const k = selection.points.get(name);
      const unseen = points.unseen.names.indexOf(name);
      const place = k !== undefined ? marked[k] : unseen >= 0 ? points.unseen.place[unseen].slice(0, 2) : now.at?.slice(0, 2);
      if (place) source.addFeature(feature(new ol.geom.Point(place), name, { kind: "point" }));
    }
  }

  function chosenStyle(one) {
    const stroke = new ol.style.Stroke({ color: CHOSEN, width: 3 });
    if (one.get("kind") === "footprint") return new ol.style.Style({ stroke: new ol.style.Stroke({ color: CHOSEN, width: 2 }), fill: new ol.style.Fill({ color: "#d55e0014" }) });
    return new ol.style.Style({ image: new ol.style.Circle({ radius: one.get("kind") === "point" ? 13 : 7.5, stroke }), text: label(one.get("name"), CHOSEN), zIndex: 9 });
  }

  function nearest(pixel) {
    let found = null;
    let best = NEAR_PX;
    const look = (kind, names, places) =>
      places.forEach((place, k) => {
        if (place[0] === null) return;
        const there = map.getPixelFromCoordinate(place);
        const away = Math.hypot(there[0] - pixel[0], there[1] - pixel[1]) - (kind === "point" ? 2 : 0);
        if (away < best) [found, best] = [{ kind, name: names[k], k }, away];
      });
    look("image", images.names, at);
    look("point", points.names, marked);
    look("unseen", points.unseen.names, points.unseen.place);
    return found;
  }

  function choose(pixel) {
    const found = nearest(pixel);
    if (!found) selection.clear();
    else if (found.kind === "image") selection.image(found.name);
    else selection.point(found.name);
  }

  function hint(pixel) {
    const found = nearest(pixel);
    holder.classList.toggle("over", Boolean(found));
    tip.hidden = !found;
    if (!found) return;
    fill(tip, h("b", {}, found.name), h("span", {}, found.kind === "image" ? imageFacts(found.k) : found.kind === "point" ? pointFacts(found.k) : say("look.unseen")));
    tip.style.left = `${Math.min(pixel[0] + 14, holder.clientWidth - 230)}px`;
    tip.style.top = `${Math.max(pixel[1] - 40, 4)}px`;
  }

  function imageFacts(k) {
    const parts = [say("look.n-rays", { n: images.rays[k] }), `rms ${number(images.rms_px[k], language)} px`];
    if (images.position_m[k][0] !== null) parts.push(`ΔE ΔN Δh ${images.position_m[k].map((d) => metres(d, language)).join(", ")}`);
    if (images.fix?.[k]) parts.push(say(`look.fix.${images.fix[k]}`));
    return parts.join(" · ");
  }

  function pointFacts(k) {
    const parts = [say(`look.role.${points.role[k]}`), say("look.n-rays", { n: points.rays[k] })];
    const d = points.difference_m[k];
    if (d[0] !== null) parts.push(`ΔE ΔN Δh ${d.map((value) => metres(value, language)).join(", ")}`);
    return parts.join(" · ");
  }

  function drawLegend() {
    const tick = (name) => {
      const box = h("input", { type: "checkbox", id: `layer-${name}`, checked: layers[name].getVisible(), onchange: () => toggle(name, box.checked) });
      return h("div.row", {}, box, h("label", { for: `layer-${name}` }, h(`span.key.${name}`, { "aria-hidden": "true" }), say(`look.layer.${name}`), note(name)));
    };
    const colours = ["rms_px", "rays", "sigma", ...(images.position_m.some((d) => d[0] !== null) ? ["position"] : []), ...(images.fix ? ["fix"] : [])];
    const chooser = h("select", { id: "station-colour", onchange: () => recolour(chooser.value) }, colours.map((name) => h("option", { value: name, selected: name === colouring }, say(`look.colour.${name}`))));
    fill(
      legend,
      h("details", { open: innerWidth > 1200 }, h("summary", {}, say("look.legend")), usable.toReversed().map(tick), h("div.row.select", {}, h("label", { for: "station-colour" }, say("look.colour")), chooser), ramp(), h("button.small", { type: "button", onclick: whole }, say("look.whole"))),
    );
  }

  function note(name) {
    if (name === "ellipses") return h("small", {}, ` × ${number(enlarged.ellipses, language)} (${number(100 * block.probability, language)} %)`);
    if (name === "vectors") return h("small", {}, ` × ${number(enlarged.vectors, language)}`);
    return null;
  }

  /** What the colours of the stations and of the overlap mean. */
  function ramp() {
    const bar = (low, high) => h("div.ramp", {}, h("span", {}, low), h("i", { "aria-hidden": "true" }), h("span", {}, high));
    const overlap = h("div.scale", {}, h("small", {}, say("look.scale.overlap")), bar("1", `${MOST_OVERLAP}+`));
    if (colouring === "fix") return [h("div.scale.fixes", {}, Object.keys(FIX).filter(Boolean).map((name) => h("span", {}, h(`i.fix.${name}`, { "aria-hidden": "true" }), say(`look.fix.${name}`)))), overlap];
    const values = stationValues();
    const [low, high] = [quantile(values, 0.02), quantile(values, 0.98)];
    const text = colouring === "rms_px" ? (v) => `${number(v, language)} px` : colouring === "rays" ? (v) => `${v}` : (v) => metres(v, language);
    return [h("div.scale", {}, h("small", {}, say(`look.colour.${colouring}`)), bar(text(low), text(high))), overlap];
  }

  async function toggle(name, visible) {
    if (name === "ties" && visible && !layers.ties.getSource()) layers.ties.setSource(await tieSource());
    layers[name].setVisible(visible);
  }

  function recolour(name) {
    colouring = name;
    layers.stations.setStyle(stationStyle());
    drawLegend();
    document.getElementById("station-colour").focus();
  }
}

/** By how much lengths are drawn enlarged, so that a usual one becomes as long as wanted: a round number. */
function enlargement(lengths, wanted, share) {
  const usual = quantile(lengths.map((value) => value ?? NaN), share);
  return usual > 0 ? Math.max(1, round(wanted / usual)) : 1;
}
