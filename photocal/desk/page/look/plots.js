// Plots, by uPlot: residuals and radius, their histogram, rays per point, positions along the flight, the lens.

import uPlot from "../vendor/uplot.js";
import { fill, h } from "../dom.js";
import { CHOSEN, INK, number, quantile, round } from "./colours.js";

const BLUE = "#0072b2";
const ORANGE = "#e69f00";
const GREEN = "#009e73";
const FONT = "12px system-ui, sans-serif";

export async function plotsPane(target, shared) {
  const { say, block, language, selection } = shared;
  const data = await shared.get("/api/look/plots");
  const names = Object.keys(data.cameras);
  let camera = names[0];
  const drawn = [];
  const cards = h("div.cards", {});
  const chooser = names.length > 1 && h("label.camera", {}, say("look.camera"), " ", h("select", { onchange: (event) => ((camera = event.target.value), draw()) }, names.map((name) => h("option", { value: name }, name))));
  fill(target, chooser || null, cards);
  draw();
  const resized = new ResizeObserver(() => drawn.forEach(({ plot, holder }) => plot.setSize(size(holder))));
  resized.observe(cards);
  const unlisten = selection.listen(light);
  return {
    leave() {
      resized.disconnect();
      unlisten();
      drawn.forEach(({ plot }) => plot.destroy());
    },
  };

  function draw() {
    drawn.splice(0).forEach(({ plot }) => plot.destroy());
    const of = data.cameras[camera];
    const made = [
      card("radius", { max: fmt(of.rays) }, (holder) => radius(holder, of.radius)),
      card("histogram", { rms: number(of.standardised.rms, language), beyond: of.standardised.beyond }, (holder) => histogram(holder, of.standardised)),
      card("vectors", {}, (holder) => vectors(holder, of.vectors, of.size_px, of.distortion.principal_px)),
      block.images.position_m.some((d) => d[0] !== null) && card("positions", {}, positions),
      card("distortion", {}, (holder) => vectors(holder, of.distortion.grid, of.size_px, of.distortion.principal_px)),
      card("radial", {}, (holder) => radial(holder, of.distortion)),
      card("rays", {}, (holder) => rays(holder, data.rays_per_point)),
      of.correlation.names.length > 1 && h("figure.card.correlation", {}, h("figcaption", {}, say("look.plot.correlation")), matrix(of.correlation)),
    ];
    fill(cards, made.filter(Boolean));
    for (const holder of cards.querySelectorAll(".plot")) {
      const plot = holder.make(holder);
      drawn.push({ plot, holder });
    }
    light(selection.now);
  }

  function card(name, values, make) {
    const holder = h("div.plot", { "data-tall": name === "vectors" || name === "distortion", role: "img", "aria-label": say(`look.plot.${name}`, values) });
    holder.make = make;
    holder.dataset.plot = name;
    return h("figure.card", {}, h("figcaption", {}, say(`look.plot.${name}`, values)), holder);
  }

  function size(holder) {
    return { width: Math.max(holder.clientWidth, 200), height: holder.dataset.tall ? 265 : 210 };
  }

  function fmt(n) {
    return new Intl.NumberFormat(language).format(n);
  }

  function axis(label, more = {}) {
    return { label, font: FONT, labelFont: FONT, stroke: INK, labelSize: 18, size: 46, grid: { stroke: "#e4e7ea", width: 1 }, ticks: { stroke: "#c9d1d7", width: 1 }, values: (_, ticks) => ticks.map((value) => (value === null ? "" : number(value, language, 4))), ...more };
  }

  function plot(holder, options, values) {
    return new uPlot({ ...size(holder), legend: { show: false }, cursor: { drag: { x: true, y: false } }, ...options }, values, holder);
  }

  function points(stroke, space = 3) {
    return { stroke, fill: stroke, paths: () => null, points: { show: true, size: space, width: 0, fill: stroke, space: 0 } };
  }

  function radius(holder, { middle_px, rms_px, radial_px, cloud }) {
    const [x, columns] = uPlotJoin([[cloud.radius_px, cloud.length_px], [middle_px, rms_px, radial_px]]);
    return plot(holder, { scales: { x: { time: false } }, axes: [axis(say("look.axis.radius"), { size: 34 }), axis(say("look.axis.residual"))], series: [{}, points("#5b7f9999", 3), { stroke: BLUE, width: 2, spanGaps: true }, { stroke: CHOSEN, width: 2, dash: [6, 3], spanGaps: true }], plugins: [key([["#5b7f99", say("look.key.rays")], [BLUE, say("look.key.rms")], [CHOSEN, say("look.key.radial")]])] }, [x, ...columns]);
  }

  function histogram(holder, { edges, count, expected }) {
    const middle = count.map((_, k) => (edges[k] + edges[k + 1]) / 2);
    return plot(holder, { scales: { x: { time: false, range: [edges[0], edges.at(-1)] } }, axes: [axis(say("look.axis.sigmas"), { size: 34 }), axis(say("look.axis.count"))], series: [{}, { stroke: "#7f9fb5", fill: "#c9d9e5", paths: uPlot.paths.bars({ size: [1, 100] }), points: { show: false } }, { stroke: CHOSEN, width: 2, paths: uPlot.paths.spline(), points: { show: false } }], plugins: [key([["#7f9fb5", say("look.key.found")], [CHOSEN, say("look.key.normal")]])] }, [middle, count, expected]);
  }

  function rays(holder, { rays: many, points: count }) {
    return plot(holder, { scales: { x: { time: false, range: [0.5, many.length] } }, axes: [axis(say("look.axis.rays"), { size: 34 }), axis(say("look.axis.points"))], series: [{}, { stroke: "#7f9fb5", fill: "#c9d9e5", paths: uPlot.paths.bars({ size: [0.85, 60] }), points: { show: false } }] }, [many.slice(1), count.slice(1)]);
  }

  function radial(holder, { radius_px, radial_px, sigma_px, decentring_px }) {
    const high = radial_px.map((value, k) => value + sigma_px[k]);
    const low = radial_px.map((value, k) => value - sigma_px[k]);
    return plot(holder, { scales: { x: { time: false } }, axes: [axis(say("look.axis.radius"), { size: 34 }), axis(say("look.axis.radial"))], bands: [{ series: [2, 3], fill: "#0072b233" }], series: [{}, { stroke: BLUE, width: 2 }, { stroke: "#0072b200" }, { stroke: "#0072b200" }, { stroke: ORANGE, width: 1.5, dash: [6, 3] }], plugins: [key([[BLUE, say("look.key.radial-lens")], [ORANGE, say("look.key.decentring")]])] }, [radius_px, radial_px, high, low, decentring_px]);
  }

  /** Residuals of the positions along the flight; a click chooses the picture. */
  function positions(holder) {
    const order = block.images.names.map((_, k) => k);
    const of = (n) => order.map((k) => (block.images.position_m[k][n] === null ? null : 100 * block.images.position_m[k][n]));
    const made = plot(holder, { scales: { x: { time: false } }, axes: [axis(say("look.axis.picture"), { size: 34 }), axis(say("look.axis.position"))], series: [{}, ...[[BLUE, "E"], [ORANGE, "N"], [GREEN, "h"]].map(([stroke]) => ({ stroke, width: 1.25, points: { show: order.length < 120, size: 4, fill: stroke } }))], plugins: [key([[BLUE, "ΔE"], [ORANGE, "ΔN"], [GREEN, "Δh"]]), chosenLine(() => selection.now.images.map((name) => selection.images.get(name)))] }, [order.map((k) => k + 1), of(0), of(1), of(2)]);
    made.over.addEventListener("click", () => made.cursor.idx !== null && selection.image(block.images.names[made.cursor.idx]));
    return made;
  }

  /** Vectors over the format, enlarged, with their scale. */
  function vectors(holder, rows, [width, height], principal) {
    const usual = quantile(rows.map(([, , u, v]) => Math.hypot(u, v)), 0.8) || 1;
    const scale = (0.05 * width) / usual;
    const length = round(usual);
    const paint = (u) => {
      const pen = u.ctx;
      const to = (x, y) => [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
      pen.save();
      pen.lineWidth = 1.2 * devicePixelRatio;
      pen.strokeStyle = pen.fillStyle = INK;
      for (const [x, y, du, dv] of rows) arrow(pen, to(x, y), to(x + du * scale, y + dv * scale));
      const [px, py] = to(...principal);
      pen.strokeStyle = CHOSEN;
      pen.lineWidth = 2 * devicePixelRatio;
      for (const [dx, dy] of [[6, 0], [0, 6]]) line(pen, [px - dx, py - dy], [px + dx, py + dy]);
      pen.strokeStyle = pen.fillStyle = INK;
      const long = to(length * scale, 0)[0] - to(0, 0)[0];
      const [right, top] = [u.bbox.left + u.bbox.width, u.bbox.top - 9 * devicePixelRatio];
      arrow(pen, [right - long, top], [right, top]);
      pen.font = `600 ${11 * devicePixelRatio}px system-ui, sans-serif`;
      pen.textAlign = "right";
      pen.fillText(`${number(length, language)} px`, right - long - 8, top + 4);
      pen.restore();
    };
    // Directions are true where both axes have one scale: the narrower one leaves room at its sides.
    const wide = () => {
      const here = size(holder);
      const room = Math.max(0, height * ((here.width - 62) / (here.height - 78)) - width) / 2;
      return [-room, width + room];
    };
    return plot(holder, { padding: [24, 16, 0, 0], cursor: { show: false }, scales: { x: { time: false, range: wide }, y: { range: [0, height], dir: -1 } }, axes: [axis(say("look.axis.column"), { size: 34, values: (_, ticks) => ticks.map((value) => (value < 0 || value > width ? "" : number(value, language, 4))) }), axis(say("look.axis.row"))], series: [{}, { paths: () => null, points: { show: false } }], hooks: { draw: [paint] } }, [[0, width], [0, height]]);
  }

  function matrix({ names: parameters, matrix: values }) {
    const cell = (r, i, j) => {
      const disc = h(r < 0 ? "i.disc.negative" : "i.disc", { "aria-hidden": "true" });
      disc.style.width = disc.style.height = `${1.45 * Math.sqrt(Math.abs(r))}rem`;
      return h("td", { title: `${parameters[i]}, ${parameters[j]}: ${number(r, language)}`, class: Math.abs(r) > 0.9 && "strong" }, disc, h("span.unseen", {}, number(r, language, 2)));
    };
    return h(
      "table",
      {},
      h("thead", {}, h("tr", {}, h("td", {}), parameters.slice(0, -1).map((name) => h("th", { scope: "col", "data-parameter": name }, name)))),
      h("tbody", {}, parameters.slice(1).map((name, i) => h("tr", {}, h("th", { scope: "row", "data-parameter": name }, name), parameters.slice(0, i + 1).map((_, j) => cell(values[i + 1][j], i + 1, j))))),
    );
  }

  /** What is chosen: parameters in the matrix, pictures along the flight. */
  function light(now) {
    const chosen = new Set(now.parameters.filter(([of]) => of === camera).map(([, name]) => name));
    for (const head of cards.querySelectorAll("[data-parameter]")) head.classList.toggle("chosen", chosen.has(head.dataset.parameter));
    drawn.find(({ holder }) => holder.dataset.plot === "positions")?.plot.redraw(false);
  }
}

function line(pen, from, to) {
  pen.beginPath();
  pen.moveTo(...from);
  pen.lineTo(...to);
  pen.stroke();
}

function arrow(pen, from, to) {
  line(pen, from, to);
  const [u, v] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(u, v);
  if (length < 3) return;
  const head = Math.min(6 * devicePixelRatio, 0.5 * length);
  const [c, s] = [(u / length) * head, (v / length) * head];
  pen.beginPath();
  pen.moveTo(...to);
  pen.lineTo(to[0] - c - 0.4 * s, to[1] - s + 0.4 * c);
  pen.lineTo(to[0] - c + 0.4 * s, to[1] - s - 0.4 * c);
  pen.fill();
}

/** A line of samples above a plot: what each colour is. */
function key(entries) {
  return {
    hooks: {
      ready: [(u) => u.root.append(h("div.key-line", {}, entries.map(([colour, text]) => {
        const sample = h("i", { "aria-hidden": "true" });
        sample.style.background = colour;
        return h("span", {}, sample, text);
      })))],
    },
  };
}

/** Upright lines where the chosen pictures are. */
function chosenLine(rows) {
  return {
    hooks: {
      draw: [(u) => {
        u.ctx.save();
        u.ctx.strokeStyle = CHOSEN;
        u.ctx.lineWidth = 1.5;
        for (const k of rows()) {
          if (k === undefined) continue;
          const x = u.valToPos(k + 1, "x", true);
          line(u.ctx, [x, u.bbox.top], [x, u.bbox.top + u.bbox.height]);
        }
        u.ctx.restore();
      }],
    },
  };
}

/** Tables of several columns over their first one, on one common first column. */
function uPlotJoin(tables) {
  const [x, ...columns] = uPlot.join(tables.map((table) => sorted(table)));
  return [x, columns];
}

function sorted([x, ...columns]) {
  const kept = [];
  let last = null;
  // The common column has each value once.
  x.forEach((value, k) => {
    if (value !== last) kept.push(k);
    last = value;
  });
  return [x, ...columns].map((column) => kept.map((k) => column[k]));
}
